"""`snapo.check`: names the mistakes in a simulator before it is trained.

In this order: declarations, the schedule, the shapes and types of one step, slices, purity,
indices, NumPy tables, a few rollouts, indices and jumps on their paths, both precisions, actions
and normals without effect, and every input's adjoint against central bumps, with decisions held
fixed.
"""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Xla
from snapo.problem.code.version import of_preparation, read_context
from snapo.problem.form import form_of
from snapo.problem.inputs import unnamed
from snapo.problem.noise import Stored
from snapo.problem.objective import Limit, Mean, Objective, Weighted, as_objective
from snapo.problem.policies.memory import remembered
from snapo.problem.policies.rules import Constant
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem, all_versions
from snapo.problem.scenarios import Pseudo, Scenarios, Sources
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact, Smooth
from snapo.problem.unseen import note

from .bumps import bumped
from .effects import reached, stopped_once, used
from .findings import Findings, Notes, StopCheck
from .indices import TABLE, moving_indices, short_slices, tables, within
from .jumps import jumps
from .rollout import ENGINE, CheckedRollout, observed, rollouts
from .shapes import Shapes, declared, one_step, prepared, require
from .traces import loops, lost_derivatives, repeatable
from .watch import moments

KEPT = 64
_faultless: OrderedDict[Hashable, Shapes] = OrderedDict()  # by form, of snapo's simulators


def simulator_mistakes(simulator: Simulator, inputs: PyTree) -> Findings:
    """Mistakes of a simulator and its inputs: declarations, shapes, slices, indices, tables, loops
    and numbers drawn in Python. It never raises an exception, and takes tenths of a second;
    `snapo.check` examines much more.
    """

    def look(notes: Notes) -> None:
        declared(notes, simulator, inputs)
        schedule = prepared(notes, simulator, inputs)
        form = _library_form(simulator, inputs, schedule)
        if form in _faultless:
            return
        shapes, library = one_step(notes, simulator, schedule), form is not None
        if not library:  # tests cover these for snapo's code
            short_slices(notes, simulator, inputs, schedule)
            repeatable(notes, simulator, inputs, schedule)
            loops(notes, simulator, inputs, schedule)
            lost_derivatives(notes, simulator, inputs)
            tables(notes, simulator, schedule)
        within(notes, simulator, inputs, schedule)
        if library and not notes.items:
            _faultless[form] = shapes
            while len(_faultless) > KEPT:
                _faultless.popitem(last=False)

    return _looked(simulator, inputs, look)


def problem_mistakes(problem: Problem, policy: Policy) -> Findings:
    """Mistakes in an objective, limits and the actions of a policy for a simulator that has none.
    It never raises an exception.
    """

    def look(notes: Notes) -> None:
        form = _library_form(problem.simulator, problem.inputs, problem.schedule)
        shapes = _faultless.get(form) or one_step(notes, problem.simulator, problem.schedule)
        require(notes, problem.objective, problem.constraints, shapes.outputs)
        _decides(notes, problem, policy, shapes.observation.shape[0])

    return _looked(problem.simulator, problem.inputs, look)


def _library_form(simulator: Simulator, inputs: PyTree, schedule: Schedule) -> Hashable:
    """The form of a simulator of snapo; None for any other, whose code may read all numbers."""
    if of_preparation(simulator, inputs) is not None:
        return None
    return form_of((simulator, unnamed(inputs), schedule))


def _looked(simulator: Simulator, inputs: PyTree, look: Callable[[Notes], None]) -> Findings:
    notes = Notes(simulator)
    try:
        with read_context(all_versions(simulator, inputs)):
            look(notes)
    except StopCheck:
        pass
    except Exception as error:
        notes.exception(error, "check")
    return notes.finished("Nothing was compiled.")


def _decides(notes: Notes, problem: Problem, policy: Policy, features: int) -> None:
    """Checks that the actions of a user's policy, at a few observations, lie in the set."""
    if type(policy).__module__.startswith("snapo.") and not isinstance(policy, Constant):
        return
    size, action = problem.action.size, problem.action
    where = f"policy {type(policy).__name__}"
    for observation in (jnp.zeros(features), jnp.ones(features), -jnp.ones(features)):
        with notes.during(where):
            nothing = jnp.zeros(remembered(policy))
            result = np.asarray(policy(jnp.concatenate([observation, nothing]), Exact()))
            result = result[: len(result) - nothing.size]
        if result.shape != (size,):
            notes.error(where, f"Its actions have shape {result.shape}.", f"Return ({size},).")
        elif fault := action.fault(result):
            notes.error(where, *fault)
        notes.stop_on_errors()


def both_precisions(notes: Notes, simulator: Simulator, run: CheckedRollout) -> None:
    """Simulates two paths in float32, as training does, then all in float64, as evaluation does;
    `reached` uses the latter program again."""
    two = Stored(run.draws.initial_noise[:2], run.draws.step_noise[:, :2])  # pyright: ignore
    halves = {name: np.full(2, 0.5) for name in run.totals}
    calls = (Xla(precision="float32"), two, halves), (ENGINE, run.draws, run.each_output())
    for engine, draws, weights in calls:
        values = (simulator, run.policy, run.schedule, draws, run.smooth, weights)
        try:
            jax.block_until_ready(engine.adjoint(*values).totals)
        except Exception as error:
            where, message, _ = notes.explained(error, "step")
            notes.error(
                where,
                f"It fails in {engine.precision}, although it works in the other "
                f"precision. {message}",
                TABLE,
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
    """Examines a simulator and its inputs; returns the list of mistakes and never raises an
    exception.

    **Arguments:**

    - `problem`: a `Problem`, or a simulator followed by its `inputs`, with `objective`, `scenarios`
      and `constraints` as keywords.
    - `scenarios`: by default standard normals; `Supplied` for any other noise.
    - `paths`, `temperature`: the number of simulated paths, and the temperature at which their
      limits are smoothed.
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
        looked = "Stopped at the first error, because the rest could not be examined."
    except Exception as error:
        notes.exception(error, "check")
        looked = "Stopped at an exception."
    return notes.finished(looked)
