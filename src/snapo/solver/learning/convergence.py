"""How a training ended, in one word, and what speaks against its result.

"trained" only says that all steps were taken. Here the policy is compared with the untrained one
and with a constant decision on the same paths, in kernels that are there already.
"""

from typing import NamedTuple

import numpy as np

from snapo.engine import Engine
from snapo.problem.objective import Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact

from .. import statistics
from ..adjoint import float64
from ..evaluate import chunks, worth
from ..finite_paths import finite
from ..train import Progress

CONVERGED, IMPROVING = "converged", "still improving"
SATURATED, UNMOVED = "saturated", "barely moved"
SURE = 2.0  # standard errors of a gain
LATE = 0.01  # of all that was gained, in the last quarter of the steps: more is still improving
SAME = 1e-3  # of the width of its set, or of its size: a decision that varies less never changes
ENOUGH = 2048  # paths on which two rules are compared


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
    """How training ended, by the exact simulator on paths of the evaluation.

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
    stays = None
    if held_paths:
        actions, over_constant = _over_constant(problem, progress.best, exact, held_paths, engine)
        stays = _stays(problem, actions)
        if stays:
            notes.append(
                f"The decision never changes{stays}: if that is not meant, try scaled features, a "
                "higher temperature_start, or another start of the policy."
            )
        elif not over_constant.sure:
            notes.append(
                f"A constant decision does as well (the trained rule gains {over_constant}): what "
                "the policy observes does not help it."
            )
    late = _late(progress, over_start.value, exact[problem.objective.outputs[0]])
    if late:
        notes.append(
            f"Still improving: the last quarter of the {progress.step} steps gained {late:,.3g}; "
            f"try steps={2 * progress.step}."
        )
    word = IMPROVING if late else CONVERGED
    word = SATURATED if stays and "limit" in stays else word
    return Ending(UNMOVED if not over_start.sure else word, tuple(notes))


def _over_untrained(problem: Problem, untrained: Policy, exact: Totals, engine: Engine) -> Gain:
    """On the first chunks of the evaluation, whose kernels are there."""
    source, bound = problem.sources.evaluation, engine.bind(problem)
    blocks = _first(chunks(source, len(exact[problem.objective.outputs[0]])))
    found = [
        bound.values(untrained, source.draws(block, problem.simulator), Exact()).totals
        for block in blocks
    ]
    return _gain(problem, exact, [float64(each) for each in found], np.concatenate(blocks))


def _over_constant(
    problem: Problem, policy: Policy, exact: Totals, held_paths: int, engine: Engine
) -> tuple[np.ndarray, Gain]:
    """The decisions [T, paths, size], and the gain over the mean of them all, taken everywhere."""
    bound, source = engine.bind(problem, controls=False), problem.sources.evaluation
    blocks = _first(source.blocks(source.available(held_paths)))
    drawn = [source.draws(block, problem.simulator) for block in blocks]
    taken = [
        np.asarray(bound.values(policy, draws, Exact(), record=("action",)).record["action"])
        for draws in drawn
    ]
    actions = np.concatenate(taken, axis=1)
    constant = problem.action.settle(actions.mean((0, 1)), Exact())
    parts: list[Totals] = []
    for draws, like in zip(drawn, taken):
        each = np.full(like.shape[1], 1 / like.shape[1])
        weights = dict.fromkeys(problem.objective.outputs, each)
        same = np.broadcast_to(np.asarray(constant), like.shape)
        found = bound.adjoint(None, draws, Exact(), weights, actions=same, wrt=("schedule",))
        parts.append(float64(found.totals))
    return actions, _gain(problem, exact, parts, np.concatenate(blocks))


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
    if not np.isfinite(value):  # the other one is ruined
        return Gain(np.inf, 0.0)
    groups = np.unique(problem.sources.evaluation.groups(paths), return_inverse=True)[1]
    return Gain(float(value), float(statistics.mean(spread, groups).standard_error))


def _stays(problem: Problem, actions: np.ndarray) -> str:
    """Where the decision stays: " (at its limit)", " (0.3)"; empty where it changes."""
    flat = actions.reshape(-1, actions.shape[-1])
    low, high = problem.action.bounds()
    width = np.where(np.isfinite(high - low), high - low, np.maximum(np.abs(flat).max(0), 1e-12))
    if np.any(np.ptp(flat, axis=0) > SAME * width):
        return ""
    value = flat[0]
    near = np.minimum(np.abs(value - low), np.abs(value - high)) <= SAME * width
    where = np.array2string(value, precision=4, separator=", ")
    return f" ({where}, at its limit)" if near.all() else f" ({where})"


def _late(progress: Progress, gained: float, totals: np.ndarray) -> float:
    """The gain of the last quarter of the steps, if it is a large part of all; else 0."""
    history = progress.history
    before = [record.best for record in history if record.step <= 0.75 * progress.step]
    if not before or not np.isfinite(before[-1]):
        return 0.0
    late = progress.best_value - before[-1]
    size = min(abs(gained), max(abs(progress.best_value), float(np.std(totals))))
    return late if late > LATE * size else 0.0
