"""Which derivative to believe: each input is moved by a hundredth, on the same paths.

The held derivative is that of the value where decisions are optimal and see the whole state, and
where no path jumps; the smooth one follows a smooth simulator, whose bias may matter. Neither is
sure beforehand. The difference of the EXACT simulator's value between inputs moved up and down,
with the policy reacting and the noise common, needs none of this: it is noisy and has a step, but
it judges both.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from snapo.engine import Engine
from snapo.problem.inputs import Input
from snapo.problem.objective import Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem

from .by_block.passes import DECIDED
from .evaluate import path_totals
from .statistics import independent, mean

MOVE = 0.01  # of every number of an input
SURE = 3.0  # standard errors
LIKELIER = 4.0  # twice the logarithm of a ratio of likelihoods, e^2: about 7 to 1
# Of the gap between the sides, at half the move: a kink leaves 1/2, a bend 1/4, a jump all of it.
CORNER, JUMP = 0.375, 0.75
ROUND_OFF = 64 * np.finfo(np.float64).eps  # of a value
HELD, SMOOTH, UNKNOWN = "held", "smooth", "not known"
COLUMNS = (
    "input", "believed", "held", "held_error", "smooth", "smooth_error", "more", "less", "error",
)  # fmt: skip


class Slope(Protocol):
    """A derivative by one input, such as a `sensitivity.Estimate`."""

    def along(self, direction: np.ndarray) -> tuple[float, float]:
        """The derivative along a direction of the input, and its standard error."""
        ...


class Verdict(NamedTuple):
    """One input moved by a hundredth: the change of the value, and the derivatives along the move.

    - `up`, `down`: value after the move less that before, and that before less that after the
      opposite move; `change` is their mean, `error` its standard error (paths are paired).
    - `held`, `smooth`: (change by the derivative, its standard error); `smooth` may be missing.
    - `tie`: half the move shows the same corner: `up` and `down` differ by a kink, where any
      derivative between them is one, and not by curvature.
    - `supported`: "held", "smooth" or "not known". Only what agrees with `change`, at a tie with
      anything between `up` and `down`, within three standard errors of the difference is believed.
      The smooth one is believed before the held one where the move makes it far likelier; an error
      that is much wider makes it less likely.
    """

    up: float
    down: float
    error: float
    held: tuple[float, float]
    smooth: tuple[float, float] | None
    tie: bool = False

    @classmethod
    def of(cls, numbers: Sequence) -> "Verdict":
        """The verdict that was written as a list of its fields."""
        up, down, error, held, smooth, tie = numbers
        return cls(up, down, error, tuple(held), smooth and tuple(smooth), tie)

    @property
    def change(self) -> float:
        """The mean of the two sides."""
        return (self.up + self.down) / 2

    @property
    def two_sided(self) -> bool:
        """Whether more and less of the input differ: a tie, or a strong curvature."""
        return abs(self.up - self.down) > SURE * self.error

    def row(self, name: str) -> tuple:
        """The verdict as a line of verdicts.csv, see `COLUMNS`."""
        smooth = self.smooth or (np.nan, np.nan)
        return name, self.supported, *self.held, *smooth, self.up, self.down, self.error

    @property
    def supported(self) -> str:
        """The derivative that the move supports: held, unless the smooth one is likelier."""
        held = self._away(*self.held)
        smooth = np.inf if self.smooth is None else self._away(*self.smooth)
        if min(held, smooth) > SURE:
            return UNKNOWN
        if self.smooth is None or not np.isfinite(smooth):
            return HELD
        # One with a wide error is near to everything: its likelihood is low, and spread out.
        widths = [independent(self.error, error) for _, error in (self.held, self.smooth)]
        wider = 2 * np.log(widths[1] / widths[0]) if min(widths) > 0 else 0.0
        return SMOOTH if held**2 - smooth**2 - wider > LIKELIER else HELD

    def settled(self, up: float, down: float) -> "Verdict":
        """For values without noise: where half the move, with these sides, comes so much nearer to
        the held derivative that all between them is curvature, the error is that much."""
        gap, rest = (abs(each - self.held[0]) for each in (self.change, up + down))
        return self._replace(error=max(gap, self.error)) if rest <= CORNER * gap else self

    def distance(self) -> tuple[float, float]:
        """From the move to the derivative that is nearer in standard errors; the most of it that
        counts as support."""
        ways = [each for each in (self.held, self.smooth) if each is not None]
        value, error = min(ways, key=lambda way: self._away(*way))
        return self._outside(value), float(SURE * independent(self.error, error))

    def _outside(self, value: float) -> float:
        low, high = sorted((self.up, self.down)) if self.tie else (self.change, self.change)
        return max(low - value, value - high, 0.0)

    def _away(self, value: float, error: float) -> float:
        """How many standard errors of the difference lie between a derivative and the move."""
        if not np.isfinite(value):
            return np.inf
        outside = self._outside(value)
        return float(outside / independent(self.error, error)) if outside else 0.0


def judge(
    problem: Problem,
    policy: Policy,
    paths: int,
    held: Mapping[str, Slope],
    smooth: Mapping[str, Slope] | None = None,
    *,
    engine: Engine | None = None,
) -> dict[str, Verdict]:
    """{input: verdict}, from the first `paths` paths of the evaluation.

    An input whose numbers are all zero moves by its own `move`; without one it has no verdict. Nor
    has any where the value is no number, as after a ruin.
    """

    def totals(at: Problem) -> Totals:
        return path_totals(at, policy, paths, engine=engine, controls=False, record=DECIDED)

    centre = totals(problem)
    if not np.isfinite(problem.objective.value(centre)):
        return {}

    def sides(name: str, by: np.ndarray) -> tuple[float, float, float]:
        value = problem.named[name].value
        low, high = (totals(problem.at({name: value + move})) for move in (-by, by))
        return _differences(problem, low, centre, high)

    noiseless = not problem.is_random
    found = {}
    for name, given in problem.named.items():
        by = hundredth(given)
        if not by.any():
            continue
        reacting = None if smooth is None else smooth[name].along(by)
        verdict = Verdict(*sides(name, by), held[name].along(by), reacting)
        if verdict.supported != HELD and (noiseless or verdict.two_sided):
            up, down, _ = sides(name, by / 2)
            gap = abs(verdict.up - verdict.down)
            verdict = verdict._replace(tie=CORNER * gap < abs(up - down) < JUMP * gap)
            verdict = verdict.settled(up, down) if noiseless else verdict
        found[name] = verdict
    return found


def hundredth(given: Input) -> np.ndarray:
    """The judging move: a hundredth of every number; where all are zero, of the input's `move`."""
    if given.value.any():
        return MOVE * given.value
    return np.full(given.value.shape, MOVE * (given.move or 0.0))


def _differences(problem: Problem, low: Totals, centre: Totals, high: Totals):
    """(up, down, standard error of their mean): paths are paired, groups are independent.

    The error is at least the round-off of a difference of two values.
    """
    objective, source = problem.objective, problem.sources.evaluation
    below, middle, above = (objective.value(each) for each in (low, centre, high))
    spread = (objective.influence(high) - objective.influence(low)) / 2
    error = mean(spread, source.groups(np.arange(spread.size))).standard_error
    round_off = ROUND_OFF * (abs(above) + abs(middle) + abs(below))
    return above - middle, middle - below, float(independent(error, round_off))
