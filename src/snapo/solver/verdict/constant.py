"""Constant decisions: those of a trained rule, and those that it should beat.

It also detects trainings that end at doing nothing: every path earns the same, whatever the noise.

A store that never buys has nothing to sell, and one that never sells has no use for buying: the
gradient there is zero, whichever of the two came first. Such a rule is detected by validations that
have the same value on every path. Training then restarts from other initial weights, with a part of
every decision drawn at random, so that it visits states that a rule that does nothing never
reaches.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from snapo.problem.actions import Actions, Choice, Product
from snapo.problem.actions.product import decision_names
from snapo.problem.objective import Totals
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact

from ..learning.progress import Progress, Record
from ..learning.settings import TrainingPlan

MAXIMUM = 3  # times that a training restarts
DRAWN = 0.3  # of every decision, at random, in one that restarted
LAST = 0.5  # of the steps: later on too few are left
NONE = 1e-9  # of a total: a difference that is round-off


def equal_on_all_paths(problem: Problem, totals: Totals) -> bool:
    """Whether every path has the same totals of the objective, although paths are random.

    An error of zero proves nothing: antithetic pairs have none if noise enters linearly.
    """
    results = [np.asarray(totals[name]) for name in problem.objective.outputs]
    return problem.is_random and all(
        np.isfinite(total).all() and np.ptp(total) <= NONE * np.max(np.abs(total))
        for total in results
    )


def caught(progress: Progress, training: TrainingPlan) -> bool:
    """Whether training should restart: in the last two validations the policy does nothing."""
    early = progress.step <= LAST * training.steps and progress.status == "training"
    return progress.unchanged >= 2 and early and len(progress.redrawn) < MAXIMUM


def exploring(training: TrainingPlan, action: Actions) -> TrainingPlan:
    """The training with a larger random share of every decision, if decisions have bounds."""
    bounded = all(np.isfinite(bound).all() for bound in action.bounds())
    if not (bounded and action.exploration_size and training.cools):
        return training
    return replace(training, exploration=max(training.exploration, DRAWN))


def describe_idle(steps: Sequence[int], history: Sequence[Record]) -> str:
    """One sentence on the steps at which training restarted."""
    *first, last = map(str, steps)
    where = f"steps {', '.join(first)} and {last}" if first else f"step {last}"
    value = history[steps[0] - 1].exact
    return (
        f"Training restarted from other initial weights at {where}, since every path earned the "
        f"same ({value:,.6g})."
    )


def idle_advice(value: float) -> str:
    """One sentence if the trained rule does nothing."""
    return (
        f"Every path earns the same ({value:,.6g}): the decisions make no use of the randomness. "
        "If that is not intended, try another seed, a wider exploration (exploration=0.4), or a "
        "rule to begin from (snapo.Residual)."
    )


SAME = 1e-3  # of the width of its set, or of its size: a decision that varies less never changes
CORNERS = 4  # constant decisions at the limits that are tried at most
TOLD = 3  # decisions that are named at most
LONG = 6  # numbers that are listed at most


class ConstantDecision(NamedTuple):
    """One of the decisions of a step that is the same on all paths at all times.

    - `number`: its number from 1, as `Actions.together` counts; `name`: its name in a `Product`,
      else empty.
    - `value`: its numbers; `limit`: whether each number is at a limit.
    """

    number: int
    name: str
    value: np.ndarray
    limit: bool

    @property
    def suffix(self) -> str:
        """Its name after a space, if it has one."""
        return f" ({self.name})" if self.name else ""

    @property
    def where(self) -> str:
        """The value as text: "0.9, at its limit"."""
        return numbers_text(self.value) + (", at its limit" if self.limit else "")


def constant_decisions(action: Actions, actions: np.ndarray) -> list[ConstantDecision]:
    """The entries of the recorded decisions [T, paths, size] that never change."""
    flat = actions.reshape(-1, actions.shape[-1])
    low, high = action.bounds()
    width = np.where(np.isfinite(high - low), high - low, np.maximum(np.abs(flat).max(0), 1e-12))
    still = np.ptp(flat, axis=0) <= SAME * width
    near = np.minimum(np.abs(flat[0] - low), np.abs(flat[0] - high)) <= SAME * width
    groups = zip(action.together(), decision_names(action))
    return [
        ConstantDecision(number + 1, name, flat[0][group], bool(near[group].all()))
        for number, (group, name) in enumerate(groups)
        if still[group].all()
    ]


def describe(constants: list[ConstantDecision], of: int) -> str:
    """A sentence on the decisions that never change."""
    if len(constants) == of:
        limit = ", at its limit" if at_limit(constants) else ""
        where = numbers_text(np.concatenate([item.value for item in constants]))
        return f"The decision never changes ({where}{limit})"
    if len(constants) == 1:
        one = constants[0]
        return f"Decision {one.number} of {of}{one.suffix} never changes ({one.where})"
    more = f" and {len(constants) - TOLD} more" if len(constants) > TOLD else ""
    listed = ", ".join(
        f"{entry.number}{entry.suffix} ({entry.where})" for entry in constants[:TOLD]
    )
    return f"{len(constants)} of {of} decisions never change: {listed}{more}"


def never_taken(action: Actions, actions: np.ndarray) -> str:
    """A sentence on the options of every `Choice` that the recorded decisions [T, paths, size]
    never take. Empty if all options are taken, or only one, which is a constant decision."""
    messages = []
    for name, first, size in _choices(action):
        idle = np.flatnonzero(actions[..., first : first + size].max((0, 1)) < 0.5)
        if 0 < len(idle) < size - 1:
            of = f" of {name}" if name else ""
            messages.append(f"{', '.join(map(str, idle[:LONG]))} of 0 to {size - 1}{of}")
    return f"Options that are never taken: {'; '.join(messages)}" if messages else ""


def _choices(action: Actions, name: str = "", first: int = 0) -> Iterator[tuple[str, int, int]]:
    """The name, the first number and the size of every `Choice` in a set."""
    if isinstance(action, Choice):
        yield name, first, action.size
    elif isinstance(action, Product):
        for local, item in zip(action.names, action.sets):
            yield from _choices(item, f"{name}.{local}" if name else local, first)
            first += item.size


def at_limit(constants: list[ConstantDecision]) -> bool:
    """Whether all of these decisions lie at limits."""
    return all(item.limit for item in constants)


def constant_baselines(action: Actions, actions: np.ndarray) -> list[np.ndarray]:
    """Constant decisions [size] that a rule should beat: the mean of the decisions [T, paths, size]
    that it takes, and, if limits are finite, the few decisions at all limits."""
    mean = actions.mean((0, 1))
    endpoints = [_ends(action, group, mean) for group in action.together()]
    if math.prod(map(len, endpoints)) > CORNERS:
        corners = [[entry[0] for entry in endpoints], [value[-1] for value in endpoints]]
    else:
        corners = list(itertools.product(*endpoints))
    results = [mean]
    for corner in corners:
        item = mean.copy()
        for group, numbers in zip(action.together(), corner):
            item[group] = numbers
        results.append(item)
    with jax.enable_x64(True):
        settled = [np.asarray(action.settle(result, Exact())) for result in results]
    return [np.asarray(each) for each in dict.fromkeys(tuple(each.tolist()) for each in settled)]


def _ends(action: Actions, group: list[int], mean: np.ndarray) -> list[np.ndarray]:
    """The extreme values of one decision; its mean where they are non-finite or not known."""
    low, high = (bound[group] for bound in action.bounds())
    if len(group) == 1:
        return [low, high] if np.isfinite(high - low).all() else [mean[group]]
    # Shares and weights: all on one of them.
    shares = (low == 0).all() and (high == 1).all()
    return list(np.eye(len(group))) if shares else [mean[group]]


def numbers_text(numbers: np.ndarray) -> str:
    """The numbers of a decision as text."""
    if numbers.size > LONG:
        return f"{numbers.size} numbers"
    return ", ".join(f"{number:.4g}" for number in numbers)
