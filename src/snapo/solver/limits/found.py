"""Limits on fresh paths: how far each is met, and what a unit more of its level is worth.

At the best policy within its limits the derivative of the objective by the policy is that of the
limits' measures times their shadow prices. So the prices are the least squares of one on the
others, on independent blocks of fresh paths: with a standard error that knows nothing of training.
"""

from typing import Any, NamedTuple

import jax
import numpy as np

from snapo.engine import Engine
from snapo.problem.objective import Totals
from snapo.problem.policy import Policy, trainable
from snapo.problem.problem import Problem

from ..adjoint import weighted_adjoint
from ..evaluate import worth_of_groups
from ..statistics import of_shares
from .dual import Dual

BLOCKS, PATHS = 16, 4096  # of the shadow prices
NEARLY = 1e-3  # of a path's deviation in the measure


class LimitFound(NamedTuple):
    """A limit on fresh paths of the exact simulator.

    - `name`, `level`: it; `value`, `standard_error`, `low`, `high`: the measure, 95 % interval.
    - `price`, `price_error`: what one unit more of the level is worth to the objective (negative
      for a lower limit); zero where the limit does not bind. `multiplier`: the one in training.
    - `met`: "met", "not met", or "met nearly": missed by less than the interval's half width, or
      by less than a thousandth of one path's deviation.
    """

    name: str
    level: float
    value: float
    standard_error: float
    low: float
    high: float
    price: float
    price_error: float
    multiplier: float
    met: str

    def __str__(self) -> str:
        return (
            f"{self.name}: {self.value:,.6g} ± {self.standard_error:,.3g} (95 %: {self.low:,.6g} "
            f"to {self.high:,.6g}), {self.met}; one more of it is worth {self.price:,.5g} ± "
            f"{self.price_error:,.3g}"
        )


def limits_found(
    problem: Problem, policy: Policy, totals: Totals, dual: Dual, smooth: Any, engine: Engine
) -> tuple[LimitFound, ...]:
    """Every limit of the problem, on exact `totals` of its evaluation scenarios; prices by smooth
    derivatives on the first of these paths."""
    limits, source = problem.limits, problem.sources.evaluation
    if not limits:
        return ()
    binds = np.array([each > 0 for each in dual.multipliers], bool)
    binds = binds if binds.size else np.zeros(len(limits), bool)
    prices, errors = _prices(problem, policy, binds, smooth, engine)
    found = []
    for i, each in enumerate(limits):
        measured = of_shares(worth_of_groups(each.measure, totals, source))
        low, high = measured.interval()
        excess = each.sign * (measured.value - each.level)
        near = NEARLY * float(each.measure.influence(totals).std())
        beyond = excess > max(measured.value - low, near)
        met = "met" if excess <= 0 else "not met" if beyond else "met nearly"
        found.append(
            LimitFound(
                each.name, each.level, measured.value, measured.standard_error, low, high,
                each.sign * prices[i], errors[i],
                each.sign * (dual.multipliers[i] if dual.multipliers else 0.0), met,
            )
        )  # fmt: skip
    return tuple(found)


def notes_of(found: tuple[LimitFound, ...]) -> tuple[str, ...]:
    """The limits that are not met, in sentences."""
    return tuple(
        f"Limit not met on fresh paths: {each}. Try more steps; or no policy may meet it."
        for each in found
        if each.met == "not met"
    )


def _prices(problem: Problem, policy: Policy, binds: np.ndarray, smooth: Any, engine: Engine):
    """[limits] shadow prices and their standard errors by a jackknife; zeros where none binds."""
    prices, errors = np.zeros(len(binds)), np.zeros(len(binds))
    if not binds.any():
        return prices, errors
    wanted = [problem.objective] + [
        each.sign * each.measure for each, on in zip(problem.limits, binds) if on
    ]
    bound, source = engine.bind(problem), problem.sources.evaluation
    blocks = source.blocks(source.available(PATHS), BLOCKS)
    slopes = np.array([
        [_slope(bound, policy, source.draws(b, problem.simulator), smooth, each) for each in wanted]
        for b in blocks
    ])  # [blocks, 1 + limits, numbers of the policy]  # fmt: skip
    whole = _least_squares(slopes.mean(0))
    without = (slopes.sum(0) - slopes) / (len(slopes) - 1)
    left = np.array([_least_squares(each) for each in without])
    spread = (len(left) - 1) / len(left) * np.sum((left - left.mean(0)) ** 2, axis=0)
    prices[binds], errors[binds] = whole, np.sqrt(spread)
    return prices, errors


def _slope(bound, policy, draws, smooth, objective) -> np.ndarray:
    """The derivative of an objective by all numbers of the policy, in one row."""
    result = weighted_adjoint(bound, policy, draws, smooth, objective, wrt=("policy",))[1]
    leaves = jax.tree.leaves(trainable(result.policy)[0])
    return np.concatenate([np.ravel(np.asarray(leaf, np.float64)) for leaf in leaves])


def _least_squares(slopes: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(slopes[1:].T, slopes[0], rcond=None)[0]
