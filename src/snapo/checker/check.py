"""`snapo.check`: names the mistakes in a simulator before it is trained.

From the outside in: declarations, the schedule, the shapes and types of one step, slices, purity,
indices, NumPy tables, a few rollouts, indices and jumps on their paths, both precisions, actions
and normals without effect, and every input's adjoint against central bumps, decisions held.
"""

import jax
from jaxtyping import PyTree

from snapo.problem.code.version import following
from snapo.problem.prepare import all_versions
from snapo.problem.scenarios import Scenarios
from snapo.problem.simulator import Simulator
from snapo.problem.smooth import Smooth

from .arrays.indices import within
from .arrays.moving import moving_indices
from .arrays.slices import short_slices
from .arrays.tables import tables
from .bumps import bumped
from .effects import reached, stopped_once, used
from .findings import Findings, Notes, Stop
from .jumps import jumps
from .loops import loops
from .lost import lost_derivatives
from .precision import both_precisions
from .program.points import moments
from .repeatable import repeatable
from .rollout import observed, rolled
from .shapes import declared, one_step, prepared


def check(
    simulator: Simulator,
    inputs: PyTree,
    *,
    scenarios: Scenarios | None = None,
    paths: int = 32,
    temperature: float = 0.05,
    seed: int = 0,
) -> Findings:
    """Examines a simulator and its inputs; returns the list of mistakes and never raises.

    **Arguments:**

    - `scenarios`: standard normals when not given; `Supplied` where noise is something else.
    - `paths`, `temperature`: of the rollouts, whose limits are smooth.
    """
    with following(all_versions(simulator, inputs)):
        return _checked(simulator, inputs, scenarios, paths, temperature, seed)


def _checked(
    simulator: Simulator,
    inputs: PyTree,
    scenarios: Scenarios | None,
    paths: int,
    temperature: float,
    seed: int,
) -> Findings:
    notes = Notes(simulator)
    try:
        declared(notes, simulator, inputs)
        schedule = prepared(notes, simulator, inputs)
        observation = one_step(notes, simulator, schedule).observation
        short_slices(notes, simulator, inputs, schedule)
        repeatable(notes, simulator, inputs, schedule)
        loops(notes, simulator, inputs, schedule)
        lost_derivatives(notes, simulator, inputs)
        within(notes, simulator, inputs, schedule)
        tables(notes, simulator, schedule)
        runs = rolled(
            notes, simulator, schedule, observation, scenarios, paths, Smooth(temperature), seed
        )
        observed(notes, simulator, runs[0])
        with jax.enable_x64(True):
            for points in moments(simulator, inputs, runs):
                moving_indices(notes, points)
                jumps(notes, points)
        both_precisions(notes, simulator, runs[0])
        moving = used(notes, simulator, runs, seed)
        reached(notes, simulator, runs, moving)
        stopped_once(notes, simulator, runs[0])
        bumped(notes, simulator, inputs, runs, seed)
        looked = f"Examined {paths} paths of {simulator.horizon} steps and bumped every input."
    except Stop:
        looked = "Stopped at the first error that hides the rest."
    except Exception as error:
        notes.exception(error, "check")
        looked = "Stopped at an exception."
    return notes.finished(looked)
