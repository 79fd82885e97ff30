"""The reported derivative: a value, and an interval that contains the true one.

The true derivative is that of the best policy's value. An estimate of it has two errors: the
sampling error of a finite number of paths, and the error of the policy, which is close to the best
one. A policy whose value is short of the best by a gap g has a derivative that is off by at most
sqrt(2 g kappa), where kappa measures how fast the derivative changes with the policy, relative to
the loss (see `margin`). The error of the value is of second order in that of the policy, the error
of a derivative of first order: it grows with the root of the gap.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snapo.problem.record import Input

from ..statistics import LEVEL, SHOWN, Estimate, critical

HELD, THROUGH, RANGE, UNKNOWN = "held", "through the policy", "range", "not known"


def source_text(source: str | None) -> str:
    """The source of a derivative as text in the table of a report."""
    return "decisions held fixed" if source == HELD else source or ""


MOVE = 0.01  # of every number of an input
AGREE = 3.0  # standard errors between the smooth derivative and the bump
SHARE_UNSEEN = 0.5  # of the standard error of a reaction that the estimate leaves out


class Interval(NamedTuple):
    """A derivative along a direction of an input: the value and the limits of its 95 % interval.

    - `sampling`, `policy`: the half-width due to the sampling error, and its increase due to the
      error of the policy. At a kink `low` to `high` also contains both one-sided derivatives.
    """

    value: float
    low: float
    high: float
    sampling: float
    policy: float

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        return f"{self.value:,.5g} (95 %: {self.low:,.5g} to {self.high:,.5g})"

    def contains(self, truth: float) -> bool:
        """Whether a number lies within the interval."""
        return self.low <= truth <= self.high


class Curvature(NamedTuple):
    """A quadratic surface in n coordinates that approximates the value around the policy, at its
    maximum.

    - `inverse`: [n, n] the inverse of minus the second derivatives; `covariance`: [n, n] the
      covariance of the position of the maximum; `gap`: by how much the best policy may be above
      this one.
    """

    inverse: np.ndarray
    covariance: np.ndarray
    gap: float

    @classmethod
    def nothing(cls) -> "Curvature":
        """No coordinates, and no gap: the interval is only that of the sampling error."""
        return cls(np.zeros((0, 0)), np.zeros((0, 0)), 0.0)


class Reported(NamedTuple):
    """The reported derivative with respect to one input, an array like the input.

    - `source`: "held" (decisions replayed), "through the policy" (a move of the exact simulator
      with the policy reacting), "range" (at a kink: between both one-sided derivatives) or "not
      known".
    - `estimate`: the derivative of each block; NaN for numbers of which only the sum is known.
    - `by`: a move of the input; `whole` [B]: the derivative along it by block.
    - `unseen`: standard error of the policy's reaction that is not in `estimate`, an array like the
      input.
    - `slopes`: [n, *shape] derivatives of the estimate with respect to the coordinates of
      `curvature`; `others`: [K, *shape] changes of the estimate in random directions of all
      weights, divided by sqrt(2 loss).
    - `sides`: the one-sided derivatives along `by` at a kink, for a decrease and an increase; else
      None.
    """

    source: str
    estimate: Estimate
    by: np.ndarray
    total: np.ndarray
    unseen: np.ndarray
    slopes: np.ndarray
    others: np.ndarray
    curvature: Curvature
    sides: tuple[float, float] | None = None

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        """ "1,234 (95 %: 1,200 to 1,260), held"; of an array the first three."""
        numbers = self.numbers()
        more = f", … ({len(numbers)} numbers)" if len(numbers) > SHOWN else ""
        return f"{', '.join(map(str, numbers[:SHOWN]))}{more}, {self.source}"

    @property
    def value(self) -> np.ndarray:
        """The numbers, shaped like the input."""
        return self.estimate.value

    def along(self, direction: np.ndarray) -> Interval:
        """The derivative along a direction, an array like the input."""
        direction = np.broadcast_to(np.asarray(direction, np.float64), self.by.shape)
        times = _multiple(direction, self.by)
        blocks = (self.estimate.blocks * direction).reshape(len(self.estimate.blocks), -1).sum(1)
        if times is not None:
            blocks = times * self.total
        unseen = float(np.sum(self.unseen * np.abs(direction)))
        slopes, others = (
            np.tensordot(change, direction, axes=direction.ndim)
            for change in (self.slopes, self.others)
        )
        interval = self._interval(Estimate(blocks), unseen, slopes, others)
        if self.sides is None or times is None:
            return interval
        less, more = sorted(times * side for side in self.sides)
        half = interval.sampling + interval.policy
        value = float(np.clip(interval.value, less, more))
        return interval._replace(value=value, low=less - half, high=more + half)

    def numbers(self) -> list[Interval]:
        """The interval of every number, in C order."""
        if self.by.size == 1:
            return [self.along(np.ones(self.by.shape))]
        count = self.by.size
        blocks = self.estimate.blocks.reshape(-1, count)
        unseen = self.unseen.reshape(1, count)
        slopes, others = (x.reshape(len(x), count) for x in (self.slopes, self.others))
        return [
            self._interval(
                Estimate(blocks[:, i]), float(unseen[0, i]), slopes[:, i], others[:, i]
            )
            for i in range(count)
        ]  # fmt: skip

    def capped(self, gap: float) -> "Reported":
        """The reported derivative with this bound on the policy's gap, if it is below the present
        gap."""
        minimum = min(gap, self.curvature.gap)
        return self._replace(curvature=self.curvature._replace(gap=minimum))

    def _interval(
        self, estimate: Estimate, unseen: float, slopes: np.ndarray, others: np.ndarray
    ) -> Interval:
        """The interval from the blocks of a derivative and its changes with the policy."""
        inverse, covariance, gap = self.curvature
        blocks, value = len(estimate.blocks), float(estimate.value)
        # Without noise there is one block, and no error.
        error = float(estimate.standard_error) if blocks > 1 else 0.0
        half = critical(blocks - 1 if blocks > 1 else np.inf, LEVEL)
        sampling = np.hypot(error, SHARE_UNSEEN * unseen)
        top = float(slopes @ covariance @ slopes)
        kappa = max(
            float(slopes @ inverse @ slopes), float(np.mean(others**2)) if len(others) else 0
        )
        complete = half * np.hypot(sampling, np.sqrt(max(top, 0.0))) + np.sqrt(
            2 * max(gap, 0.0) * max(kappa, 0.0)
        )
        width, complete = float(half * sampling), float(complete)
        return Interval(value, value - complete, value + complete, width, complete - width)


def _multiple(direction: np.ndarray, by: np.ndarray) -> float | None:
    """How many times `by` a direction is; None if it is not a multiple."""
    square = float(np.sum(by * by))
    if not square:
        return None
    times = float(np.sum(direction * by)) / square
    return times if np.allclose(direction, times * by, rtol=1e-9, atol=0) else None


def one_percent(values: Input) -> np.ndarray:
    """The bump: 1 % of every number, or that of the input; if all are zero, 1 % of its `move`."""
    if values.judge_bump is not None:
        return np.full(values.value.shape, values.judge_bump)
    if values.value.any():
        return MOVE * values.value
    return np.full(values.value.shape, MOVE * (values.move or 0.0))


def blocks_along(estimate: Estimate, direction: np.ndarray) -> np.ndarray:
    """[B]: a derivative along a direction of its input, by block."""
    return (estimate.blocks * direction).reshape(len(estimate.blocks), -1).sum(1)


def plain(held: Estimate, by: np.ndarray, source: str = HELD) -> Reported:
    """The held derivative with only its sampling error."""
    empty = np.zeros((0, *by.shape))
    complete = blocks_along(held, by)
    nothing = np.zeros(by.shape)
    return Reported(source, held, by, complete, nothing, empty, empty, Curvature.nothing())


class Verdict(NamedTuple):
    """One input bumped by one percent: the change of the value, and the derivatives along it.

    - `source`: the source of the reported derivative, see `Reported`.
    - `held`, `bump`, `reaction`: pairs (change, standard error); `reaction` is `bump` minus `held`,
      paired.
    - `up`, `down`: the change of the value for an increase and a decrease of the input;
      `side_error`: the standard error of their difference.
    - `probability`: the p-value of the reaction; `tested`: whether there is one.
    - `corner`: "kink", "jump" or "".
    """

    source: str
    held: tuple[float, float]
    bump: tuple[float, float]
    reaction: tuple[float, float]
    up: float
    down: float
    side_error: float
    probability: float
    tested: bool
    corner: str = ""

    @classmethod
    def of(cls, numbers: Sequence) -> "Verdict":
        """The verdict that was written as a list of its fields."""
        source, held, bump, reaction, *rest = numbers
        return cls(source, tuple(held), tuple(bump), tuple(reaction), *rest)

    @property
    def two_sided(self) -> bool:
        """Whether the one-sided derivatives differ, because of a corner or of curvature."""
        return abs(self.up - self.down) > AGREE * self.side_error

    def row(self, name: str) -> tuple:
        """The verdict as a line of verdicts.csv, see `COLUMNS`."""
        pairs = (*self.held, *self.bump, *self.reaction)
        return name, self.source, *pairs, self.up, self.down, self.probability
