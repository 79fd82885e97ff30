"""The verb: train a policy, measure it on the exact simulator, differentiate its value.

A run is three plain stages on one problem: `train`, `path_totals`, `sensitivities`.
"""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from snapo.checker.first import first_mistakes
from snapo.engine import Choice, Engine, Engines, Xla, choose
from snapo.engine.transpose import compiled_meanwhile
from snapo.problem.actions.base import count
from snapo.problem.limits import Limit
from snapo.problem.objective import Mean, Objective, Totals
from snapo.problem.policies.plain import as_policy
from snapo.problem.policy import MLP, Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo, Scenarios, Sobol, Sources
from snapo.problem.simulator import Simulator
from snapo.problem.smooth import Exact, Smooth

from .evaluate import Value, estimate, path_totals, ruined, worth
from .judge import judge
from .learning.convergence import ending
from .learning.features import scale_of, undrawn
from .learning.following import fitted
from .learning.starts import others, race
from .learning.told import chosen, recorded
from .limits.found import limits_found, notes_of
from .provenance.broken import why_broken
from .provenance.clock import Clock
from .provenance.versions import versions
from .sensitivity import Sensitivities, sensitivities
from .solution import Solution
from .train import Callback, Progress, Training, begin, train

Given = TypeVar("Given")  # settings of one kind

SCENARIOS = ("pseudo-random", "sobol")
GAP_PATHS = 16384  # at most: paths are paired, so the gap is known far better than the value


@dataclass(frozen=True)
class Evaluation:
    """How a policy is measured.

    - `paths`: fresh scenarios for the value; `sensitivity_paths` for held derivatives,
      `smooth_paths` for those through the policy, `judge_paths` for the moves of every input that
      judge between the two (0: none, of any).
    - `scenarios`: "pseudo-random" (antithetic) or "sobol".
    """

    paths: int = 65536
    sensitivity_paths: int = 16384
    smooth_paths: int = 4096
    judge_paths: int = 2048
    scenarios: str = "pseudo-random"

    def __post_init__(self):
        if self.scenarios not in SCENARIOS:
            allowed = " or ".join(map(repr, SCENARIOS))
            raise ValueError(f"Evaluation: scenarios is {self.scenarios!r}; allowed is {allowed}.")
        least = {"paths": 2, "sensitivity_paths": 0, "smooth_paths": 0, "judge_paths": 0}
        for name, number in least.items():
            count(f"Evaluation: {name}", getattr(self, name), number)

    def sources(self, seed: int) -> Sources:
        """Fresh scenarios for every role, those of the evaluation as they are asked for here."""
        found = Sources.of(None, seed)
        return replace(found, evaluation=Sobol(seed)) if self.scenarios == "sobol" else found


def solve(
    problem: Problem | Simulator,
    inputs: PyTree = None,
    policy: Policy | eqx.Module | Solution | None = None,
    *,
    objective: Objective | None = None,
    scenarios: Scenarios | Sources | None = None,
    limits: Sequence[Limit] | Limit = (),
    training: Training | None = None,
    evaluation: Evaluation | None = None,
    engine: Choice = "auto",
    callbacks: Sequence[Callback] = (),
    progress: Progress | None = None,
    check: bool = True,
) -> Solution:
    """Trains a policy and returns its value, with the derivative by every input.

    **Arguments:**

    - `problem`: a `Problem`; or a simulator, with `inputs`, `objective` and `scenarios` beside it.
    - `policy`: the one to train, such as `MLP(hidden=(64, 64))`, which finds features and actions
      itself; by default an `MLP` with two hidden layers of 32, and of more where more than eight
      numbers are decided. A policy that is trained already, or an earlier `Solution`, is trained
      on from where it stands. Any other `eqx.Module` is taken as `policy(observation, smooth)`, or
      as `network(observation)`, whose numbers are squashed into the action set.
    - `objective`: made as large as possible; by default the mean of the only output there is.
    - `scenarios`: `Sources`, one for each role; or scenarios for the evaluation, by default fresh
      ones of `training.seed`. `Supplied` ones alone serve all roles, each with paths of its own.
    - `limits`: one or several, of means, probabilities or other numbers of all paths, such as
      `(AtMost("unserved", 0.05),)`: an augmented Lagrangian finds their prices in training, and the
      derivatives by inputs are those of the best value within the limits.
    - `engine`: "auto", "xla" or "native", or an engine.
    - `callbacks`: told the `Progress` at every validation, the last line of whose history is
      `progress.record`; one that returns True stops the training. `progress`: one to go on from.
    - `check`: looks for mistakes that tracing shows, in tenths of a second.

    **Raises:** `ValueError` with the first mistakes that `check` finds, before anything compiles.
    """
    training = _settings("training", training, Training)
    evaluation = _settings("evaluation", evaluation, Evaluation)
    with Clock() as clock:
        given = (inputs, objective, scenarios, limits)
        problem = problem_of(problem, *given, evaluation, training.seed)
        recipe = _recipe(policy)
        policy = recipe.for_problem(problem.interface, jax.random.key(training.seed))
        if check:
            _refuse_mistakes(problem, policy)
        engines = choose(engine, problem, policy)
        training = fitted(training, problem, policy)
        with _meanwhile(problem, evaluation):
            if progress is None:
                progress = _begun(problem, policy, training, engines.train, undrawn(recipe))
            clock.stage("evaluate")
            progress = train(problem, progress, training, engines.train, callbacks)
            progress = recorded(problem, progress, training)
            clock.stage("train")
        found = measure(problem, policy, progress, training, evaluation, engines)
        clock.stage("evaluate")
    return Solution(
        **found,
        policy=progress.best,
        halfway=progress.halfway,
        history=progress.history,
        seconds=clock.total(),
        engine=engines.name,
        reason=engines.reason,
        seed=training.seed,
        versions=versions(),
        problem=problem,
    )


def _settings(name: str, given: Given | None, kind: type[Given]) -> Given:
    """The settings given, or the usual ones.

    **Raises:** `ValueError` where they are of another kind, such as a dictionary.
    """
    found = kind() if given is None else given
    if not isinstance(found, kind):
        raise ValueError(f"solve: {name} is {given!r}; give snapo.{kind.__name__}(…).")
    return found


def problem_of(
    problem: Problem | Simulator,
    inputs: PyTree,
    objective: Objective | None,
    scenarios: Scenarios | Sources | None,
    limits: Sequence[Limit] | Limit,
    evaluation: Evaluation,
    seed: int,
) -> Problem:
    """The problem that a caller means: the one given, or that of a simulator with all beside it.

    **Raises:** `ValueError` where a `Problem` has any of it beside it, or for what is neither.
    """
    if isinstance(problem, type):
        name = problem.__name__
        raise ValueError(f"solve: {name} is a class; give its object, {name}().")
    if isinstance(problem, Simulator):
        given = evaluation.sources(seed) if scenarios is None else scenarios
        objective = objective or _only_output(problem, inputs)
        limits = (limits,) if isinstance(limits, Limit) else tuple(limits)
        return Problem(problem, inputs, objective, Sources.of(given, seed), limits)
    if not isinstance(problem, Problem):
        kind = type(problem).__name__
        raise ValueError(f"solve: a {kind} is neither a simulator nor a Problem.")
    if limits or any(each is not None for each in (inputs, objective, scenarios)):
        what = "inputs, objective, scenarios and limits"
        raise ValueError(f"solve: a Problem has its own {what}.")
    return problem


def _recipe(policy: Policy | eqx.Module | Solution | None) -> Policy:
    """The policy to train: the one given, or that of an earlier solution."""
    if isinstance(policy, Solution):
        policy = policy.policy
        if policy is None:
            raise ValueError("solve: this solution was loaded without its policy.")
    return MLP() if policy is None else as_policy(policy)


def _begun(
    problem: Problem, policy: Policy, training: Training, engine: Engine, fresh: bool
) -> Progress:
    """The start, or the best of several after the rounds in which the others fell out.

    Networks that are `fresh`, made here from a recipe, are drawn for the features as they are.
    """
    starts = others(policy, training.starts, training.seed)
    scale = scale_of(policy, problem) if fresh else None
    if scale is not None:
        starts = [scale.plain(each) for each in starts]
    begun = [replace(begin(each, training, problem), scale=scale) for each in starts]

    def run(progress: Progress, until: int) -> Progress:
        return train(problem, progress, training, engine, until=until)

    left, rounds = race(begun, training.steps, run)
    return replace(left, raced=rounds)


def _meanwhile(problem: Problem, evaluation: Evaluation) -> AbstractContextManager[None]:
    """The transpose for the sensitivities, compiled beside the program of the training."""
    if not min(evaluation.sensitivity_paths, evaluation.paths):
        return nullcontext()
    return compiled_meanwhile(problem.simulator, problem.inputs, problem.schedule)


def _refuse_mistakes(problem: Problem, policy: Policy) -> None:
    """Raises where the cheap part of the checker finds errors."""
    if errors := first_mistakes(problem, policy).errors:
        lines = "\n".join(map(str, errors))
        raise ValueError(f"solve: nothing was compiled (check=False leaves this out).\n{lines}")


def measure(
    problem: Problem,
    untrained: Policy,
    progress: Progress,
    training: Training,
    evaluation: Evaluation,
    engines: Engines,
) -> dict[str, Any]:
    """Value, smoothing gap, sensitivities of the best policy and how training ended, as fields of a
    `Solution`."""
    policy, engine, objective = progress.best, engines.evaluate, problem.objective
    source, controls = problem.sources.evaluation, problem.simulator.control_variates()
    smooth = Smooth(np.float64(training.temperature(training.steps)))
    exact = path_totals(problem, policy, evaluation.paths, engine=engine)
    value = estimate(objective, exact, source, controls)
    gap = _smoothing_gap(problem, policy, exact, smooth, engine)
    limits = limits_found(problem, policy, exact, progress.dual, smooth, engine)
    within = problem.priced([abs(each.price) for each in limits])
    table = _sensitivities(within, progress, evaluation, smooth, engine)
    held = min(evaluation.sensitivity_paths, evaluation.paths)
    ended = ending(problem, untrained, progress, exact, held, engine)
    norm, noise = (table and table.policy_gradient) or (float("nan"), float("nan"))
    dropped = {
        "train": sum(record.bad_paths for record in progress.history),
        "evaluate": value.dropped,
        "sensitivities": table.dropped if table else 0,
    }
    return {
        "value": value.value,
        "standard_error": value.standard_error,
        "control": value.control,
        "smooth_value": value.value - gap,
        "smoothing_gap": gap,
        "policy_gradient_norm": norm,
        "policy_gradient_noise": noise,
        "sensitivities": table,
        "totals": exact,
        "paths": {"train": training.paths, "evaluate": source.available(evaluation.paths)},
        "roles": problem.sources.roles(
            training.paths,
            training.validation_paths,
            evaluation.paths,
            min(evaluation.sensitivity_paths, evaluation.paths),
        ),
        "dropped": dropped,
        "notes": _notes(value, dropped, ruined(objective, exact))
        + tuple(filter(None, [why_broken(problem, progress, training, engines.train)]))
        + chosen(progress)
        + ended.notes
        + notes_of(limits),
        "limits": limits,
        "growth": progress.growth,
        "window": progress.window,
        "clip": progress.clip,
        "keep": progress.keep,
        "convergence": ended.word,
        "status": _status(value.value, progress.status),
    }


def _smoothing_gap(
    problem: Problem, policy: Policy, exact: Totals, smooth: Smooth, engine: Engine
) -> float:
    """Exact less smooth, on the first of the paths whose exact totals are known."""
    paths = min(GAP_PATHS, len(exact[problem.objective.outputs[0]]))
    soft = path_totals(problem, policy, paths, smooth=smooth, engine=engine, controls=False)
    same = {name: total[: len(soft[name])] for name, total in exact.items() if name in soft}
    with np.errstate(invalid="ignore"):
        return float(np.subtract(worth(problem.objective, same), worth(problem.objective, soft)))


def _status(value: float, status: str) -> str:
    """The status of a run: that of its training, unless its value is no number although all steps
    were taken."""
    if np.isfinite(value) or status == "diverged":
        return status
    return "ruined" if value < 0 else "not finite"


def _notes(value: Value, dropped: Mapping[str, int], ruin: int) -> tuple[str, ...]:
    """Sentences that a reader of the value must see."""
    notes = [
        f"The control variate {name!r} is not used: its mean is not zero." for name in value.refused
    ]
    if ruin:
        notes.append(f"{ruin} paths end in ruin, with a utility of minus infinity.")
    if any(dropped.values()):
        told = ", ".join(f"{count} in {WHERE[name]}" for name, count in dropped.items() if count)
        notes.append(f"Paths left out since they are not finite: {told}.")
    return tuple(notes)


WHERE = {"train": "training", "evaluate": "the value", "sensitivities": "the sensitivities"}


def _sensitivities(
    problem: Problem, progress: Progress, evaluation: Evaluation, smooth: Smooth, engine: Engine
) -> Sensitivities | None:
    """The table of the best policy, judged; None where no paths are given to it."""
    paths = min(evaluation.sensitivity_paths, evaluation.paths)
    if not paths:
        return None
    table = sensitivities(
        problem,
        progress.best,
        paths,
        smooth=smooth if evaluation.smooth_paths else None,
        smooth_paths=evaluation.smooth_paths,
        earlier=progress.halfway if progress.step > 1 else None,
        engine=engine,
    )
    if not evaluation.judge_paths:
        return table
    paths = min(evaluation.judge_paths, paths)
    verdicts = judge(problem, progress.best, paths, table.held, table.smooth, engine=engine)
    return table._replace(verdicts=verdicts)


def _only_output(simulator: Simulator, inputs: PyTree) -> Objective:
    """The mean of the only output, when there is but one."""
    bare = Problem(simulator, inputs, Mean(""))
    action = np.zeros((simulator.horizon, 2, simulator.action.size))
    draws = Pseudo().draws(np.arange(2), simulator)
    totals = Xla().bind(bare).values(None, draws, Exact(), actions=action).totals
    if len(totals) != 1:
        raise ValueError(
            f"solve: the simulator has the outputs {sorted(totals)}; say which one to make as "
            'large as possible, such as objective=Mean("profit") or -Mean("cost").'
        )
    return Mean(next(iter(totals)))
