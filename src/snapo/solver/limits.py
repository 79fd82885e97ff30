"""Limits on fresh paths: their excess, and the shadow prices of their levels.

At the best policy within its limits the derivative of the objective with respect to the policy is
the sum of those of the limits' measures times their shadow prices. So the prices are a
least-squares fit of that derivative to the others, on independent blocks of fresh paths, with a
standard error that does not depend on training.

During training the prices are those of an augmented Lagrangian.

After every step each limit is measured on the exact simulator and on that step's paths. Its
multiplier moves by a share of the excess, never below zero, and the price in the next step is the
multiplier plus a term in proportion to the excess, which damps the overshoot of a multiplier
without it (Hestenes 1969; Stooke, Achiam and Abbeel 2020).

The unit of an excess is the deviation of a path's measure, or the excess itself if that is
larger: under a rule that decides nearly the same on all paths the measure hardly varies. The unit
of a price is the ratio of the norms of the derivatives of objective and limit with respect to the
policy, at which both have equal weight. Totals do not determine this unit: the noise in an
objective may be far larger than the effect of all decisions, and a price that is far too large
drives decisions to a bound of their set, where derivatives vanish.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import jax
import numpy as np

from snapo.engine import BoundEngine, Engine
from snapo.problem.noise import Draws
from snapo.problem.objective import Limit, Objective, Totals
from snapo.problem.policy import Policy, trainable
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Scenarios
from snapo.problem.smooth import Smooth

from .adjoint import weighted_adjoint
from .evaluate import value_of, value_of_groups
from .statistics import Sampled, of_shares, plus_minus


def slope_of(
    bound_engine: BoundEngine, policy: Policy, draws: Draws, smooth, objective: Objective
) -> np.ndarray:
    """The values in one row, in float64."""
    result = weighted_adjoint(bound_engine, policy, draws, smooth, objective, wrt=("policy",))[1]
    leaves = jax.tree.leaves(trainable(result.policy)[0])
    return np.concatenate([np.ravel(np.asarray(leaf, np.float64)) for leaf in leaves])


MOVE, DAMP = 0.1, 3.0  # of a multiplier and of a price, for an excess of one deviation
EVERY, KEPT = 5, 0.5  # steps between two measurements of a unit, and the share of those before
MINIMUM = 1e-12


class Dual(NamedTuple):
    """For every limit its multiplier, its price and the present unit of its price; empty before the
    first step."""

    multipliers: tuple[float, ...] = ()
    prices: tuple[float, ...] = ()
    units: tuple[float, ...] = ()

    @classmethod
    def read(cls, plain) -> "Dual":
        """The record, from its fields as lists."""
        return cls(*(tuple(item) for item in plain))

    def due(self, step: int) -> bool:
        """Whether units are to be measured again: their derivatives cost as much as a step."""
        return not self.units or step % EVERY == 0

    def measured(
        self,
        bound_engine: BoundEngine,
        policy: Policy,
        draws: Draws,
        smooth,
        objective: Objective,
        limits: Sequence[Limit],
    ) -> "Dual":
        """The same, with the units of prices measured on these paths and averaged with earlier
        units."""
        lengths = np.array([
            np.linalg.norm(slope_of(bound_engine, policy, draws, smooth, item))
            for item in (objective, *(limit.measure for limit in limits))
        ])  # fmt: skip
        with np.errstate(divide="ignore", invalid="ignore"):
            length = lengths[0] / lengths[1:]
        available = np.isfinite(length) & (length > 0)
        before = np.array(self.units) if self.units else np.where(available, length, np.nan)
        known_before = np.where(np.isnan(before), length, before)
        smoothed = known_before**KEPT * np.where(available, length, known_before) ** (1 - KEPT)
        return self._replace(units=tuple(np.where(available, smoothed, before).tolist()))


def updated_prices(
    dual: Dual, objective: Objective, limits: Sequence[Limit], totals: Totals, slower: float
) -> Dual:
    """The prices after a step with these exact totals; `slower`, 1 to 0, slows multipliers down
    towards the end."""
    old = np.array(dual.multipliers or (0.0,) * len(limits))
    excess = np.array([limit.excess(totals) for limit in limits])
    if not np.all(np.isfinite(excess)):
        return dual
    local = np.array([_deviation(item.measure, totals) for item in limits])
    # Where no derivative determines a unit, deviations do.
    units = np.array(dual.units) if dual.units else np.full(len(limits), np.nan)
    units = np.where(np.isnan(units), _deviation(objective, totals) / local, units)
    far = units * excess / np.maximum(local, np.abs(excess))
    # Far from the level the damping term dominates: a multiplier that accumulated all the way would
    # overshoot far. With much slack it falls by a tenth at least, whatever the unit is by then.
    move = far * local / np.maximum(local, np.abs(excess))
    move = np.where(excess < -local, np.minimum(far, -old), move)
    multipliers = np.maximum(old + slower * MOVE * move, 0.0)
    prices = np.maximum(multipliers + DAMP * far, 0.0)
    return dual._replace(multipliers=tuple(multipliers.tolist()), prices=tuple(prices.tolist()))


def _deviation(objective: Objective, totals: Totals) -> float:
    """The deviation of one path's share in an objective; at least a tenth of the largest share,
    since all paths may be equal."""
    shares = objective.influence(totals)
    return max(float(shares.std()), 0.1 * float(np.abs(shares).max()), MINIMUM)


BLOCKS, PATHS = 16, 4096  # of the shadow prices
NEARLY = 1e-3  # of a path's deviation in the measure
ROOM = 0.1  # of it: training's paths place a measure no better than that
NOT_MET = "not met"
ALIKE = 1e-5  # of the level: round-off of a policy in float32, where all paths are the same


class LimitFound(NamedTuple):
    """A limit on fresh paths of the exact simulator.

    - `name`, `level`: those of the limit; `value`, `standard_error`, `low`, `high`: those of the
      measure.
    - `price`, `price_error`: the shadow price, the change of the objective per unit of the level
      (negative for a lower limit); zero if the limit does not bind, that is, if its multiplier in
      training is zero or the measure is far enough from the level. `multiplier`: the last
      multiplier in training.
    - `met`: "met", "not met", or "met nearly": violated by less than the half width of the
      interval, a thousandth of one path's deviation, or round-off.
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

    @property
    def binds(self) -> bool:
        """Whether the limit has a price."""
        return bool(self.price_error > 0 or self.price != 0)

    @property
    def at_level(self) -> bool:
        """Whether the measure is at the level, up to sampling noise and round-off."""
        return bool(abs(self.value - self.level) <= _alike(self.high - self.value, self.level))

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        price = f"{self.price:,.5g} {plus_minus(self.price_error, 3)}"
        value = f"one unit more of the level changes the objective by {price}"
        return (
            f"{self.name}: {self.value:,.6g} {plus_minus(self.standard_error, 3)} (95 %: "
            f"{self.low:,.6g} to {self.high:,.6g}), {self.met}; "
            f"{value if self.binds else 'it has no price'}"
        )


def _alike(half: float, level: float) -> float:
    """The largest distance from the level at which a measure is taken for it, by half width."""
    return max(half, ALIKE * abs(level))


def _met(limit: Limit, totals: Totals, result: Sampled) -> str:
    """How a limit is met, from the result of its measure on these totals."""
    excess, half = limit.sign * (result.value - limit.level), result.value - result.interval()[0]
    nearly = NEARLY * float(limit.measure.influence(totals).std())
    outside = excess > max(_alike(half, limit.level), nearly)
    return "met" if excess <= 0 else NOT_MET if outside else "met nearly"


def limits_found(
    problem: Problem, policy: Policy, totals: Totals, dual: Dual, smooth: Smooth, engine: Engine
) -> tuple[LimitFound, ...]:
    """Every limit of the problem, on exact `totals` of its evaluation scenarios; prices by smooth
    derivatives on the first of these paths."""
    limits, source = problem.constraints, problem.sources.evaluation
    if not limits:
        return ()
    measured = [of_shares(value_of_groups(item.measure, totals, source)) for item in limits]
    multipliers = dual.multipliers or (0.0,) * len(limits)
    binds = np.zeros(len(limits), bool)
    met = []
    for i, (limit, result) in enumerate(zip(limits, measured)):
        excess, half = (
            limit.sign * (result.value - limit.level),
            result.value - result.interval()[0],
        )
        deviation = float(limit.measure.influence(totals).std())
        binds[i] = multipliers[i] > 0 and -excess <= max(
            _alike(half, limit.level), ROOM * deviation
        )
        met.append(_met(limit, totals, result))
    prices, errors = _prices(problem, policy, binds, smooth, engine)
    return tuple(
        LimitFound(
            entry.name, entry.level, results.value, results.standard_error, *results.interval(),
            entry.sign * prices[i], errors[i], entry.sign * multipliers[i], met[i],
        )
        for i, (entry, results) in enumerate(zip(limits, measured))
    )  # fmt: skip


class Contender(NamedTuple):
    """A policy among several that are compared under the same limits.

    - `value`: the objective; `within`: whether all limits are met, or nearly met.
    - `excess`, `prices`: for every limit the measure minus the level, and the price of a unit of it
      in training; negative for a lower limit.
    """

    value: float
    within: bool = True
    excess: tuple[float, ...] = ()
    prices: tuple[float, ...] = ()

    @classmethod
    def of(cls, value: float, limits: Iterable[LimitFound]) -> "Contender":
        """The contender of a measured policy."""
        limits = tuple(limits)
        within = all(item.met != NOT_MET for item in limits)
        excess = tuple(item.value - item.level for item in limits)
        return cls(value, within, excess, tuple(item.multiplier for item in limits))

    @classmethod
    def on(cls, problem: Problem, totals: Totals, source: Scenarios, dual: Dual) -> "Contender":
        """The contender with these exact totals on paths of a source."""
        limits = problem.constraints
        results = [of_shares(value_of_groups(item.measure, totals, source)) for item in limits]
        within = all(_met(limit, totals, x) != NOT_MET for limit, x in zip(limits, results))
        excess = tuple(x.value - limit.level for limit, x in zip(limits, results))
        prices = tuple(limit.sign * price for limit, price in zip(limits, dual.prices))
        return cls(value_of(problem.objective, totals), within, excess, prices)


def best_first(contenders: Sequence[Contender]) -> list[int]:
    """The positions of policies, the best one first.

    Policies within the limits come first, by their values. The others follow, by their values minus
    the excess over each limit times its price, which is the largest one that any of the policies
    has. A policy without a finite value is last.
    """
    columns = zip(*(item.prices for item in contenders if item.prices))
    prices = [max(filter(np.isfinite, column), key=abs, default=0.0) for column in columns]

    def key(position: int) -> tuple[int, float]:
        value, within, excess, _ = contenders[position]
        cost = 0.0 if within else sum(a * b for a, b in zip(prices, excess))
        return (1 - within, cost - value) if np.isfinite(value - cost) else (2, 0.0)

    return sorted(range(len(contenders)), key=key)


def notes_of(limits: tuple[LimitFound, ...]) -> tuple[str, ...]:
    """Sentences on the limits that are not met, and on those with slack."""
    return tuple(sentence for item in limits if (sentence := _note(item)))


def _note(limit: LimitFound) -> str:
    if limit.met == NOT_MET:
        return (
            f"Limit not met on fresh paths: {limit}. Try more steps; the limit may also be "
            "infeasible."
        )
    if limit.binds:
        return ""
    if limit.multiplier and limit.at_level:
        return (
            f"Limit without a price, although it is met exactly: {limit.name}. All decisions are "
            "at bounds of their set, where they have no derivative. Training ended at a price "
            f"of {limit.multiplier:,.4g} for it."
        )
    slack = (
        f"Limit with slack, and so without a price: {limit.name}; the value is {limit.value:,.6g}."
    )
    if limit.multiplier:
        slack += (
            f" Training ended at a price of {limit.multiplier:,.4g} for it: its decisions "
            "may be stuck at a bound of their set. Try more steps or a lower learning_rate."
        )
    return slack


def _prices(problem: Problem, policy: Policy, binds: np.ndarray, smooth: Smooth, engine: Engine):
    """[limits] shadow prices and their standard errors by a jackknife; zeros where none binds."""
    prices, errors = np.zeros(len(binds)), np.zeros(len(binds))
    if not binds.any():
        return prices, errors
    bind = [constraint for constraint, on in zip(problem.constraints, binds) if on]
    requested = [problem.objective, *(item.measure for item in bind)]
    signs = np.array([1.0, *(entry.sign for entry in bind)])[:, None]
    bound, source = engine.bind(problem), problem.sources.evaluation
    blocks = source.blocks(source.available(PATHS), BLOCKS)
    draws = [source.draws(block, problem.simulator) for block in blocks]
    slopes = np.array([
        [slope_of(bound, policy, block, smooth, value) for value in requested] for block in draws
    ]) * signs  # [blocks, 1 + limits, numbers of the policy]  # fmt: skip
    complete = _least_squares(slopes.mean(0))
    without = (slopes.sum(0) - slopes) / (len(slopes) - 1)
    left = np.array([_least_squares(each) for each in without])
    spread = (len(left) - 1) / len(left) * np.sum((left - left.mean(0)) ** 2, axis=0)
    prices[binds], errors[binds] = complete, np.sqrt(spread)
    return prices, errors


def _least_squares(slopes: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(slopes[1:].T, slopes[0], rcond=None)[0]
