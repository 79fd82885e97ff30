"""`snapo.solve`: trains a policy, measures it on the exact simulator, differentiates its value.

A run is two plain stages on one problem: `train`, `measure`.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any, TypeVar

import equinox as eqx
import jax
from jaxtyping import PyTree

from snapo.checker.check import problem_mistakes, simulator_mistakes
from snapo.checker.findings import Findings
from snapo.engine import Engine, EngineName, Engines, WorkerPool, Workers, choose
from snapo.engine.transpose import compiled_meanwhile
from snapo.problem.code.version import reading_once
from snapo.problem.meant import problem_of
from snapo.problem.objective import Limit, Objective
from snapo.problem.policies.composed import as_policy
from snapo.problem.policy import MLP, Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Scenarios, Sources
from snapo.problem.simulator import Simulator

from .adjoint import float64
from .evaluate import path_totals
from .learning.bar import ProgressLine, shown
from .learning.features import scale_of, to_be_drawn, undrawn
from .learning.log import recorded
from .learning.progress import INTERRUPTED, Interrupted
from .learning.settings import TrainingPlan, resolve_auto
from .learning.starts import by_value, others, race
from .limits import Contender
from .measure.measure import MeasuredRun, measure
from .measure.selection import Evaluation as Evaluation
from .provenance import Clock, versions
from .solution import Solution
from .train import Callback, Progress, Training, initial_progress, train

Settings = TypeVar("Settings")  # settings of one kind
MEASURING = "interrupted: measuring the best policy so far (press Ctrl-C again to skip this)"


@reading_once()
def solve(
    problem: Problem | Simulator,
    inputs: PyTree = None,
    policy: Policy | eqx.Module | Solution | None = None,
    *,
    objective: Objective | str | None = None,
    scenarios: Scenarios | Sources | None = None,
    constraints: Sequence[Limit] | Limit = (),
    training: Training | None = None,
    evaluation: Evaluation | None = None,
    engine: EngineName = "auto",
    callbacks: Sequence[Callback] = (),
    progress: Progress | None = None,
    check: bool = True,
    executor: Executor | Sequence[Executor] | None = None,
    bar: bool | None = None,
) -> Solution:
    """Trains a policy and returns its value, with the derivative with respect to every input.

    **Arguments:**

    - `problem`: a `Problem`, followed by the policy; or a simulator, with `inputs`, `objective` and
      `scenarios`.
    - `policy`: the policy to train, such as `MLP(hidden=(64, 64))`, which adapts to features and
      actions; by default an `MLP` with two hidden layers of 32, wider if more than eight numbers
      are decided. A trained policy, or an earlier `Solution`, is trained further. Any other
      `eqx.Module` is called as `policy(observation, smooth)`, or as `network(observation)`, whose
      outputs are squashed into the action set.
    - `objective`: the objective, which is maximised; the name of an output means its mean. The
      default is the mean of the only output, unless its name suggests a cost, such as "cost".
    - `scenarios`: `Sources`, one for each role; or scenarios for the evaluation, by default fresh
      scenarios from `training.seed`. `Supplied` scenarios are divided between all roles.
    - `constraints`: one or several limits on means, probabilities or other statistics of all paths,
      such as `[Mean("unserved") <= 0.05]`: an augmented Lagrangian determines their prices in
      training, and the derivatives with respect to inputs are those of the best value within them.
    - `engine`: "auto", "xla" or "native", or an engine.
    - `callbacks`: functions that are called with the `Progress` at every validation;
      `progress.record` is the last line of its history; a callback that returns True stops the
      training. `progress`: a state from which to continue.
    - `check`: whether to run the checks that need only tracing, in tenths of a second.
    - `executor`: a `concurrent.futures.Executor`, such as Dask's `client.get_executor(pure=False)`,
      or several. Its workers compute a part of the paths of every step that takes 50 ms or more
      here, with bit-identical results. `solve` does not close it.
    - `bar`: whether a line shows the progress and the time left; None: in a terminal or a notebook.

    Ctrl-C during training ends it: the best policy so far is measured, and the solution has the
    status "interrupted". A second Ctrl-C also ends the measurement, without a solution.

    **Raises:** `ValueError` with the first mistakes that `check` finds, before anything compiles.
    """
    training = _settings("training", training, Training)
    evaluation = _settings("evaluation", evaluation, Evaluation)
    with Clock() as timer:
        seed = training.seed
        inputs, policy = in_order(problem, inputs, policy)
        values, sources = (inputs, objective, scenarios, constraints), evaluation.sources(seed)
        notes = _refused(_of_simulator(problem, inputs)) if check else ()
        problem = problem_of("solve", problem, *values, sources=sources, seed=seed)
        recipe = _recipe(policy)
        policy = recipe.for_problem(problem.interface, jax.random.key(training.seed))
        if check:
            notes += _refused(problem_mistakes(problem, policy))
        engines = choose(engine, problem, policy)
        if executor is not None:
            engines = _over(engines, executor)
        drawn = to_be_drawn(recipe)
        plan = resolve_auto(training, problem, policy, fresh=drawn)
        with _meanwhile(problem, evaluation), shown(bar) as line:
            line.tell("training: compiling")
            try:
                if progress is None:
                    progress = _begun(problem, policy, plan, engines.train, undrawn(recipe), line)
                timer.stage("evaluate")
                fresh = _fresh_starts(policy, plan) if drawn else None
                options: dict[str, Any] = {"fresh": fresh, "bar": line}
                progress = train(problem, progress, plan, engines.train, callbacks, **options)
            except Interrupted as stop:
                stopped: Progress = stop.result
                progress = replace(stopped, status=INTERRUPTED)
                notes += (_interrupted(stopped.step, plan.steps), *stop.notes)
            progress = recorded(problem, progress, plan)
            timer.stage("train")
        start = policy if progress.scale is None else progress.scale.plain(policy)
        measured_on = evaluation.within(problem.simulator.horizon)
        run = MeasuredRun(problem, start, progress, plan, measured_on, engines, drawn)
        with shown(bar) as line:
            line.tell("measuring the policy" if progress.status != INTERRUPTED else MEASURING)
            measured = measure(run)
        measured["notes"] = (*notes, *engines.notes, *measured["notes"])
        timer.stage("evaluate")
    return Solution(
        **measured,
        halfway=progress.halfway,
        history=progress.history,
        seconds=timer.total(),
        engine=engines.name,
        reason=engines.reason,
        seed=training.seed,
        versions=versions(),
        problem=problem,
        maximised=str(problem.objective),
    )


def _over(engines: Engines, executor: Executor | Sequence[Executor]) -> Engines:
    executors = [executor] if isinstance(executor, Executor) else executor
    try:
        return engines.over(Workers(list(map(WorkerPool.of, executors))))
    except ValueError as error:
        raise ValueError(f"solve: executor: {error}.") from None


def _settings(name: str, values: Settings | None, kind: type[Settings]) -> Settings:
    """The supplied settings, or the default ones.

    **Raises:** `ValueError` if they are of another kind, such as a dictionary.
    """
    settings = kind() if values is None else values
    if not isinstance(settings, kind):
        raise ValueError(f"solve: {name} is {values!r}; it must be snapo.{kind.__name__}(…).")
    return settings


def in_order(problem: Any, inputs: PyTree, policy: Any) -> tuple[PyTree, Any]:
    """Inputs and policy: a `Problem`, which has its own inputs, is followed by the policy."""
    behind = isinstance(problem, Problem) and policy is None
    return (
        (None, inputs)
        if behind and (callable(inputs) or isinstance(inputs, Solution))
        else (inputs, policy)
    )


def _recipe(policy: Policy | eqx.Module | Solution | None) -> Policy:
    """The policy to train: the supplied policy, or that of an earlier solution."""
    if isinstance(policy, Solution):
        policy = policy.policy
        if policy is None:
            raise ValueError("solve: this solution was loaded without its policy.")
    return MLP() if policy is None else as_policy(policy)


def _begun(
    problem: Problem,
    policy: Policy,
    training: TrainingPlan,
    engine: Engine,
    fresh: bool,
    bar: ProgressLine,
) -> Progress:
    """The start, or the best of several after the rounds in which the others were dropped.

    Networks that are `fresh`, made here from a recipe, are drawn for the unscaled features.
    """
    starts = others(policy, training.starts, training.seed)
    scale = scale_of(policy, problem) if fresh else None
    if scale is not None:
        starts = [scale.plain(start) for start in starts]
    started = [replace(initial_progress(item, training, problem), scale=scale) for item in starts]

    def run(progress: Progress, until: int) -> Progress:
        return train(problem, progress, training, engine, until=until, bar=bar)

    def contender(progress: Progress) -> Contender:
        if not problem.constraints:
            return by_value(progress)
        source, paths = problem.sources.validation, training.validation_paths
        options: dict[str, Any] = {"engine": engine, "source": source, "controls": False}
        totals = float64(path_totals(problem, progress.best, paths, **options))
        return Contender.on(problem, totals, source, progress.dual)

    left, rounds = race(started, training.steps, run, contender)
    return replace(left, raced=rounds)


def _interrupted(step: int, steps: int) -> str:
    return (
        f"Training was interrupted after step {step} of {steps}: the policy is the best one so far."
    )


def _fresh_starts(policy: Policy, training: TrainingPlan) -> Callable[[int], Policy]:
    """Starts that were in no race, for a training that has to restart."""
    first = 1 + training.starts
    return lambda number: others(policy, first + number, training.seed)[-1]


def _meanwhile(problem: Problem, evaluation: Evaluation) -> AbstractContextManager[None]:
    """The transpose for the sensitivities, compiled while the training's program is compiled."""
    if not min(evaluation.sensitivity_paths, evaluation.paths):
        return nullcontext()
    return compiled_meanwhile(problem.simulator, problem.inputs, problem.schedule)


def _of_simulator(problem: Problem | Simulator, inputs: PyTree) -> Findings:
    """What the cheap part of the checker finds in a simulator, if there is one."""
    if isinstance(problem, Problem):
        return simulator_mistakes(problem.simulator, problem.inputs)
    if isinstance(problem, Simulator):
        return simulator_mistakes(problem, inputs)
    return Findings("", (), "")  # `problem_of` names the mistake


def _refused(findings: Findings) -> tuple[str, ...]:
    """Raises an error for errors; returns the warnings, as notes."""
    if findings.errors:
        lines = "\n".join(map(str, findings.errors))
        raise ValueError(f"solve: nothing was compiled (check=False skips this check).\n{lines}")
    return tuple(warning.sentence() for warning in findings.warnings)
