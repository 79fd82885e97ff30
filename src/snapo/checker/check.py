"""`snapo.check`: names the mistakes in a simulator before it is trained.

From the outside in: declarations, the schedule, the shapes and types of one step, slices, purity,
indices, NumPy tables, a few rollouts, indices and jumps on their paths, both precisions, actions
and normals without effect, and every input's adjoint against central bumps, decisions held.
"""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Xla
from snapo.problem.code.version import read_context
from snapo.problem.noise import Stored
from snapo.problem.objective import Limit, Mean, Objective, Weighted, as_objective
from snapo.problem.problem import Problem, all_versions
from snapo.problem.scenarios import Pseudo, Scenarios, Sources
from snapo.problem.simulator import Simulator
from snapo.problem.smooth import Smooth
from snapo.problem.unseen import note

from .arrays.indices import within
from .arrays.moving import moving_indices
from .arrays.slices import short_slices
from .arrays.tables import TABLE, tables
from .bumps import bumped
from .effects import reached, stopped_once, used
from .findings import Findings, Notes, StopCheck
from .jumps import jumps
from .loops import loops
from .lost import lost_derivatives
from .program.points import moments
from .repeatable import repeatable
from .rollout import CheckedRollout, observed, rollouts
from .shapes import declared, one_step, prepared
from .wanted import require


def both_precisions(notes: Notes, simulator: Simulator, run: CheckedRollout) -> None:
    """Rolls two of the paths in float32, then in float64, as training and evaluation do."""
    draws = Stored(run.draws.initial_noise[:2], run.draws.step_noise[:, :2])  # pyright: ignore
    weights = {name: np.full(2, 0.5) for name in run.totals}
    values = (simulator, run.policy, run.schedule, draws, run.smooth, weights)
    for precision in ("float32", "float64"):
        engine = Xla(precision=precision)
        try:
            jax.block_until_ready(engine.adjoint(*values).totals)
        except Exception as error:
            where, message, _ = notes.explained(error, "step")
            notes.error(
                where, f"It fails in {precision} after the other precision. {message}", TABLE
            )
            return


def check(
    problem: Problem | Simulator,
    inputs: PyTree = None,
    *,
    objective: Objective | str | None = None,
    scenarios: Scenarios | Sources | None = None,
    constraints: Sequence[Limit] | Limit = (),
    paths: int = 32,
    temperature: float = 0.05,
    seed: int = 0,
) -> Findings:
    """Examines a simulator and its inputs; returns the list of mistakes and never raises.

    **Arguments:**

    - `problem`: a `Problem`; or a simulator, with its `inputs` after it, and `objective`,
      `scenarios` and `constraints` by name.
    - `scenarios`: standard normals when not given; `Supplied` where noise is something else.
    - `paths`, `temperature`: of the rollouts, whose limits are smooth.
    """
    simulator: Any = problem
    if isinstance(problem, Problem):
        simulator, inputs, objective = problem.simulator, problem.inputs, problem.objective
        scenarios, constraints = problem.sources, problem.constraints
    if isinstance(scenarios, Sources):
        scenarios = None if isinstance(scenarios.evaluation, Pseudo) else scenarios.evaluation
    with read_context(all_versions(simulator, inputs)):
        aim = None if objective is None else as_objective(objective)
        return _checked(simulator, inputs, aim, scenarios, constraints, paths, temperature, seed)


def _checked(
    simulator: Simulator,
    inputs: PyTree,
    objective: Objective | None,
    scenarios: Scenarios | None,
    constraints: Sequence[Limit] | Limit,
    paths: int,
    temperature: float,
    seed: int,
) -> Findings:
    notes = Notes(simulator)
    try:
        declared(notes, simulator, inputs)
        schedule = prepared(notes, simulator, inputs)
        shapes = one_step(notes, simulator, schedule)
        observation = shapes.observation
        require(notes, objective, constraints, shapes.outputs)
        short_slices(notes, simulator, inputs, schedule)
        repeatable(notes, simulator, inputs, schedule)
        loops(notes, simulator, inputs, schedule)
        lost_derivatives(notes, simulator, inputs)
        within(notes, simulator, inputs, schedule)
        tables(notes, simulator, schedule)
        runs = rollouts(
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
        aim = objective or Weighted(*((1.0, Mean(name)) for name in shapes.outputs))
        result = Problem(simulator, inputs, aim).prepared(schedule).partly_observed
        looked = " ".join(filter(None, [looked, note(result)]))
    except StopCheck:
        looked = "Stopped at the first error that hides the rest."
    except Exception as error:
        notes.exception(error, "check")
        looked = "Stopped at an exception."
    return notes.finished(looked)
