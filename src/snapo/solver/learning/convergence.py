"""How a training ended, in one word, and what speaks against its result.

"trained" only says that all steps were taken. Here the policy is compared with the untrained one
and with constant decisions on the same paths, in kernels that are there already.
"""

from typing import NamedTuple

import numpy as np

from snapo.engine import Engine
from snapo.problem.noise import Draws
from snapo.problem.objective import Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact

from .. import statistics
from ..adjoint import float64
from ..evaluate import chunks, worth
from ..finite_paths import finite
from ..limits.found import NEARLY
from ..train import Progress
from .constant import at_limit, constant_decisions, never_taken, rivals, told, words

CONVERGED, IMPROVING = "converged", "still improving"
SATURATED, UNMOVED, CONSTANT = "saturated", "barely moved", "constant"
SURE = 2.0  # standard errors of a gain
LATE = 0.01  # of all that was gained, in the last quarter of the steps: more is still improving
ENOUGH = 2048  # paths on which two rules are compared
TRY_OTHERS = (
    "try starts=4, features of mean 0 and deviation 1, wider starting states, or a higher "
    "temperature_start"
)
TRY = f"write a decision of when to stop with snapo.Stop, or {TRY_OTHERS}"


class Ending(NamedTuple):
    """The word, and sentences that say what a reader of the value must know, and what to try."""

    word: str
    notes: tuple[str, ...] = ()


class Gain(NamedTuple):
    """By how much the objective is above that of another rule on the same paths."""

    value: float
    error: float

    @property
    def sure(self) -> bool:
        # One randomised net has no error that could be known.
        return self.value > (SURE * self.error if np.isfinite(self.error) else 0.0)

    def __str__(self) -> str:
        return f"{self.value:,.3g} ± {self.error:,.2g}"


def ending(
    problem: Problem,
    untrained: Policy,
    progress: Progress,
    exact: Totals,
    held_paths: int,
    engine: Engine,
) -> Ending:
    """How training ended, by the exact simulator on paths of the evaluation; a training that
    broke off has notes and no word.

    A rule that breaks a limit of the problem, and more than the trained one does, is no rival.

    - `exact`: {output: [paths]} of the best policy on the evaluation's paths.
    - `held_paths`: of the held derivatives, which record decisions; 0 leaves out what needs them.
    """
    if not np.isfinite(worth(problem.objective, exact)):
        return Ending("")
    notes = []
    over_start = _over_untrained(problem, untrained, exact, engine)
    if not over_start.sure:
        notes.append(
            f"Training gained nothing over the rule that it began with ({over_start}). Unless that "
            "is a good rule already, try more steps, another learning_rate, wider starting states "
            "or features that tell states apart."
        )
    still, of, over_constant = [], len(problem.action.together()), None
    if held_paths:
        taken = _decisions(problem, progress.best, held_paths, engine)
        actions = np.concatenate([each[2] for each in taken], axis=1)
        still = constant_decisions(problem.action, actions)
        constant, over_constant = _over_constants(problem, exact, taken, engine)
        if still:
            notes.append(f"{words(still, of)}: if that is not meant, {TRY}.")
        if len(still) < of and not over_constant.sure:
            notes.append(_as_well(constant, over_constant))
        if unused := never_taken(problem.action, actions):
            notes.append(f"{unused}. If one of them should be, {TRY_OTHERS}.")
    late = _late(progress, over_start.value, exact[problem.objective.outputs[0]])
    if late:
        notes.append(
            f"Still improving: the last quarter of the {progress.step} steps gained {late:,.3g}; "
            f"try steps={2 * progress.step}."
        )
    if progress.status == "diverged":
        word = ""
    elif not over_start.sure:
        word = UNMOVED
    elif len(still) == of and at_limit(still):
        word = SATURATED
    elif late:
        word = IMPROVING
    else:
        same = over_constant is not None and not over_constant.sure
        word = CONSTANT if same or len(still) == of else CONVERGED
    return Ending(word, tuple(notes))


def _as_well(constant: np.ndarray, gain: Gain) -> str:
    """The sentence on a constant decision that is as good as the trained rule, or better."""
    if Gain(-gain.value, gain.error).sure:
        return (
            f"A constant decision ({told(constant)}) does better, by {-gain.value:,.3g} ± "
            f"{gain.error:,.2g}: {TRY}."
        )
    return (
        f"A constant decision ({told(constant)}) does as well (the trained rule gains {gain}): "
        f"what the policy observes does not help it. If it should, {TRY}."
    )


def _over_untrained(problem: Problem, untrained: Policy, exact: Totals, engine: Engine) -> Gain:
    """On the first chunks of the evaluation, whose kernels are there."""
    source, bound = problem.sources.evaluation, engine.bind(_unpriced(problem))
    blocks = _first(chunks(source, len(exact[problem.objective.outputs[0]])))
    found = [
        bound.values(untrained, source.draws(block, problem.simulator), Exact()).totals
        for block in blocks
    ]
    return _gain(problem, exact, [float64(each) for each in found], np.concatenate(blocks))


def _decisions(
    problem: Problem, policy: Policy, held_paths: int, engine: Engine
) -> list[tuple[np.ndarray, Draws, np.ndarray]]:
    """The paths, their scenarios and the decisions [T, paths, size], by block."""
    bound, source = engine.bind(problem, controls=False), problem.sources.evaluation
    found = []
    for paths in _first(source.blocks(source.available(held_paths))):
        draws = source.draws(paths, problem.simulator)
        taken = bound.values(policy, draws, Exact(), record=("action",)).record["action"]
        found.append((paths, draws, np.asarray(taken)))
    return found


def _over_constants(
    problem: Problem,
    exact: Totals,
    taken: list[tuple[np.ndarray, Draws, np.ndarray]],
    engine: Engine,
) -> tuple[np.ndarray, Gain]:
    """The best constant decision [size] of some, and the gain over it: see `rivals`."""
    unpriced = _unpriced(problem)
    bound, outputs = engine.bind(unpriced, controls=False), unpriced.objective.outputs
    paths = np.concatenate([each[0] for each in taken])
    found = []
    for constant in rivals(problem.action, np.concatenate([each[2] for each in taken], axis=1)):
        parts: list[Totals] = []
        for _, draws, like in taken:
            each = np.full(like.shape[1], 1 / like.shape[1])
            weights = dict.fromkeys(outputs, each)
            same = np.broadcast_to(constant.astype(like.dtype), like.shape)
            # The held derivatives have this kernel compiled already.
            passed = bound.adjoint(None, draws, Exact(), weights, actions=same, wrt=("schedule",))
            parts.append(float64(passed.totals))
        found.append((constant, _gain(problem, exact, parts, paths)))
    return min(found, key=lambda each: each[1].value)


def _first(blocks: list[np.ndarray]) -> list[np.ndarray]:
    """The first blocks that have enough paths together, or all."""
    sizes = np.cumsum([len(block) for block in blocks])
    return blocks[: int(np.searchsorted(sizes, ENOUGH)) + 1]


def _gain(problem: Problem, exact: Totals, parts: list[Totals], paths: np.ndarray) -> Gain:
    """The difference of the objective, with the standard error of paired paths."""
    objective = problem.objective
    mine = {name: np.asarray(total)[paths] for name, total in exact.items()}
    other = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    good = finite(mine, objective.outputs) & finite(other, objective.outputs)
    if not good.any():
        return Gain(np.inf, 0.0)
    mine, other = ({n: total[good] for n, total in each.items()} for each in (mine, other))
    paths = paths[good]
    with np.errstate(invalid="ignore"):
        value = objective.value(mine) - objective.value(other)
        spread = objective.influence(mine) - objective.influence(other)
    groups = np.unique(problem.sources.evaluation.groups(paths), return_inverse=True)[1]
    if not np.isfinite(value) or _breaks_a_limit(problem, mine, other, groups):  # or is ruined
        return Gain(np.inf, 0.0)
    return Gain(float(value), float(statistics.mean(spread, groups).standard_error))


def _unpriced(problem: Problem) -> Problem:
    """With the outputs of its limits beside those of its objective, as kernels have them."""
    return problem.priced([0.0] * len(problem.limits))


def _breaks_a_limit(problem: Problem, mine: Totals, other: Totals, groups: np.ndarray) -> bool:
    """Whether the other rule is surely further beyond a limit than mine is."""
    for limit in problem.limits:
        influence = limit.measure.influence(other)
        error = statistics.mean(influence, groups).standard_error
        beyond = limit.excess(other) - max(limit.excess(mine), 0.0)
        if beyond > max(SURE * error if np.isfinite(error) else 0.0, NEARLY * influence.std()):
            return True
    return False


def _late(progress: Progress, gained: float, totals: np.ndarray) -> float:
    """The gain of the last quarter of the steps, if it is a large part of all; else 0."""
    history = progress.history
    before = [record.best for record in history if record.step <= 0.75 * progress.step]
    if not before or not np.isfinite(before[-1]):
        return 0.0
    late = progress.best_value - before[-1]
    size = min(abs(gained), max(abs(progress.best_value), float(np.std(totals))))
    return late if late > LATE * size else 0.0
