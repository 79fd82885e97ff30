"""Rolling intrinsic: on each trading day the best plan in traded products.

On every path the best plan for the store (or swing) is computed at the forward curve of the day, in
the products that can be traded on that day, and the difference from the positions is traded at
once. Each unit traded costs half the spread between bid and offer, including trades that close a
position. The flow of the day is delivered, and on the next day the plan is made again. Source: J.
Gray, P. Khandelwal, "Towards a realistic gas storage model", Commodities Now 7 (2004).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from .flat import (
    FlatPeriod,
    Limits,
    Peaks,
    Side,
    Slopes,
    best,
    bought,
    limits_at,
    limits_on,
    peaks,
    slopes,
)

NODES = 81  # of the level before each period
PLAN_NODES = 801  # the same of one plan
SEARCHED = 129  # levels among which those are sought from which a contract can be met
FINER, TIMES = 33, 6  # levels between the last of them and the next one, again and again
MAX_UNITS = 130  # of the measure of the volumes between the lowest and the highest node
NEAR = 1e-9


class TradeBlock(NamedTuple):
    """The days from `first` up to the day before `after`, which are traded as one product or are
    not traded yet.

    - `spread`: half the bid-offer of a unit; `lot`: volumes per day are multiples of it; 0 for any
      volume.
    """

    first: int
    after: int
    spread: float = 0.0
    lot: float = 0.0
    trades: bool = True


class FlatContract(Protocol):
    """A contract of one level, on steps 0 to `horizon`.

    - `every`: see `flat.best`; `measure`: a volume of which all others are multiples, or None.
    """

    horizon: int
    start: float
    every: bool
    measure: float | None

    def levels(self, t: int) -> tuple[float, float]:
        """The lowest and the highest level at the start of a step from which the contract can be
        met."""
        ...

    def reached(self, t: int) -> tuple[float, float]:
        """The lowest and the highest level after a step, before settling."""
        ...

    def limits(
        self, first: int, after: int, levels: np.ndarray, low: float, high: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The smallest and the largest flat q, at each level, with which a period ends between low
        and high."""
        ...

    def growth(self, first: int, after: int) -> tuple[float, float]:
        """The level after a period for each unit of the level before it, and for each unit of q."""
        ...

    def sides(self, first: int, after: int) -> tuple[Side, Side]:
        """The sides of q above and below zero."""
        ...

    def level_cost(self, first: int, after: int, levels: np.ndarray) -> np.ndarray:
        """The discounted cost of levels at the start of a period."""
        ...

    def end_cost(self, first: int, after: int, levels: np.ndarray) -> np.ndarray | None:
        """The money of levels at the end of a step, before settling; None if there is none."""
        ...

    def discount(self, first: int, after: int) -> np.ndarray:
        """The discount factors of payments for the commodity, by day."""
        ...

    def settled(self, t: int, levels: np.ndarray) -> np.ndarray | None:
        """The cost of settling after a step, if the level is then set to zero; otherwise None."""
        ...

    def final(self, levels: np.ndarray, price: np.ndarray) -> np.ndarray:
        """The value of levels [m, 1 or N] after the last step, at the price [N] of the end date."""
        ...


class Link(NamedTuple):
    """A period of a plan. `nodes`: the nodes after it; `lost`: the cost of settling at its end;
    `held`: the cost of the levels at its end."""

    block: TradeBlock
    period: FlatPeriod
    nodes: np.ndarray
    lost: np.ndarray | None
    held: np.ndarray | None = None

    def later(self, value: np.ndarray) -> np.ndarray:
        """The value at the nodes after the period, from the value at the start of the next
        period."""
        value = value if self.lost is None else value[:1] - self.lost[:, None]
        return value if self.held is None else value - self.held[:, None]


class Infeasible(ValueError):
    """No volumes that are equal on all days of each product satisfy the contract."""


@dataclass(eq=False)
class Chains:
    """The periods of a contract for any blocks; periods with the same blocks after them are made
    once."""

    contract: FlatContract
    count: int = NODES
    _made: dict[tuple[TradeBlock, ...], tuple[Link, ...]] = field(default_factory=dict)

    def of(self, blocks: tuple[TradeBlock, ...]) -> tuple[Link, ...]:
        """The periods of blocks that follow one another up to the end of the contract."""
        position = next((i for i in range(len(blocks)) if blocks[i:] in self._made), len(blocks))
        links = self._made.get(blocks[position:], ())
        for i in reversed(range(position)):
            links = (self._link(blocks[i], links), *links)
            if i:  # the first block differs every day
                self._made[blocks[i:]] = links
        return links

    def _link(self, block: TradeBlock, later: tuple[Link, ...]) -> Link:
        contract, first, after = self.contract, block.first, block.after
        low, high = contract.reached(after - 1)
        lost = contract.settled(after - 1, np.zeros(1))
        if later and lost is None:
            nodes = later[0].period.nodes
            low, high = nodes[0], nodes[-1]
        else:
            nodes = self._nodes(low, high)
        inside = range(first, after - 1)
        if any(contract.settled(t, np.zeros(1)) is not None for t in inside):
            raise Infeasible("a product must not extend beyond the end of a contract year")
        before = self._nodes(*_possible(contract, first, after, low, high))
        minimum, maximum = contract.limits(first, after, before, low, high)
        keep, span = contract.growth(first, after)
        period = FlatPeriod(
            first,
            after,
            before,
            keep * before,
            span,
            minimum,
            np.maximum(minimum, maximum),
            *contract.sides(first, after),
            contract.level_cost(first, after, before),
            block.spread * float(np.sum(contract.discount(first, after))),
        )
        held = contract.end_cost(first, after, nodes)
        return Link(block, period, nodes, contract.settled(after - 1, nodes), held)

    def _nodes(self, low: float, high: float) -> np.ndarray:
        """Evenly spaced levels; multiples of the measure of the volumes if there are few enough of
        these."""
        if high - low <= NEAR:
            return np.array([low])
        parts, measure = self.count - 1, self.contract.measure or math.inf
        units = round((high - low) / measure)
        common = units and abs(units * measure - (high - low)) < 1e-6 * measure
        if common and units <= max(MAX_UNITS, 2 * parts):
            parts = units * max(parts // units, 1)
        return np.linspace(low, high, parts + 1)


def _possible(contract: FlatContract, first: int, after: int, low, high) -> tuple[float, float]:
    """The lowest and the highest level before a period from which it can end between low and
    high."""

    def possible(levels: np.ndarray) -> np.ndarray:
        least, most = contract.limits(first, after, levels, low, high)
        return least <= most + NEAR * max(1.0, abs(high))

    bottom, top = contract.levels(first)
    levels = np.unique(np.append(np.linspace(bottom, top, SEARCHED), contract.start))
    levels = levels[(levels >= bottom) & (levels <= top)]
    inside = np.flatnonzero(possible(levels))
    if not len(inside):
        raise Infeasible(
            "no volumes that are equal on all days of each product satisfy the contract"
        )
    found = []
    for position, beyond in ((inside[0], inside[0] - 1), (inside[-1], inside[-1] + 1)):
        good = levels[position]
        if 0 <= beyond < len(levels):
            bad = levels[beyond]
            for _ in range(TIMES):
                between = np.linspace(good, bad, FINER)
                last = int(np.argmin(np.append(possible(between[1:]), False)))
                good, bad = between[last], between[min(last + 1, FINER - 1)]
        found.append(float(good))
    return found[0], found[1]


class ForwardPosition(NamedTuple):
    """The state of paths: `level` [N], the volumes `held` [T, N] that are bought forward for each
    day, and the money so far."""

    level: np.ndarray
    held: np.ndarray
    money: np.ndarray
    traded: np.ndarray

    @classmethod
    def initial(cls, contract: FlatContract, paths: int) -> "ForwardPosition":
        zero = np.zeros(paths)
        level, held = np.full(paths, contract.start), np.zeros((contract.horizon, paths))
        return cls(level, held, zero, zero)


class RollingPlan(NamedTuple):
    """The prices of each period, its target level at the end, and the value today [N]."""

    prices: list[tuple[Slopes, Peaks]]
    value: np.ndarray


def planned(
    contract: FlatContract, links: Sequence[Link], curve: np.ndarray, position: ForwardPosition
) -> RollingPlan:
    """The best plan at the forward prices [steps from the first one on, and the end date, N]."""
    start = links[0].block.first
    value = contract.final(links[-1].nodes[:, None], curve[-1])
    value, prices = np.broadcast_to(value, (len(links[-1].nodes), curve.shape[1])), []
    for number, link in reversed(list(enumerate(links))):
        block, period, nodes, later = link.block, link.period, link.nodes, link.later(value)
        forward = curve[block.first - start : block.after - start]
        slope = slopes(period, forward, position.held[block.first])
        peak = peaks(period, slope, later, nodes)
        prices.append((slope, peak))
        limits = limits_on(period) if number else exactly(contract, links[0], position.level)
        value, _ = best(period, limits, slope, peak, contract.every)
    return RollingPlan(prices[::-1], value[0])


def exactly(contract: FlatContract, link: Link, levels: np.ndarray) -> Limits:
    """The limits of the first period, exactly at the levels of the paths, without interpolation
    between nodes."""
    period, nodes = link.period, link.nodes
    least, most = contract.limits(period.first, period.after, levels, nodes[0], nodes[-1])
    keep, _ = contract.growth(period.first, period.after)
    cost = contract.level_cost(period.first, period.after, levels)
    rows = keep * levels, least, np.maximum(least, most), cost
    return Limits(*(row[None] for row in rows))


def traded(
    contract: FlatContract,
    links: Sequence[Link],
    curve: np.ndarray,
    position: ForwardPosition,
    delivers: bool,
) -> ForwardPosition:
    """The positions after the trades of a day and, if `delivers`, after the flow of its first
    step."""
    level, held, money, volume = position
    start, level_after = links[0].block.first, level
    money, volume = money.copy(), volume.copy()
    for number, (link, (slope, peak)) in enumerate(
        zip(links, planned(contract, links, curve, position).prices)
    ):
        block, period = link.block, link.period
        limits = limits_at(period, level) if number else exactly(contract, link, level)
        q = best(period, limits, slope, peak, contract.every)[1][0]
        flow, delivered = bought(period, q), delivers and not number
        if block.lot and not delivered:
            flow = np.round(flow / block.lot) * block.lot
        if not block.trades:
            flow = held[block.first]
        discount, days = contract.discount(block.first, block.after), slice(*block[:2])
        change = flow - held[block.first]
        forward = curve[block.first - start : block.after - start]
        money -= change * (discount @ forward) + period.spread * np.abs(change)
        volume += np.abs(change) * (block.after - block.first)
        held[days] = flow
        level = limits.keep[0] + period.span * q
        if delivered:
            cost = np.where(q > 0, period.into.money, -period.out.money) * q
            money -= cost + limits.cost[0]
            at_end = contract.end_cost(period.first, period.after, level)
            money -= 0.0 if at_end is None else at_end
        if link.lost is not None:
            lost = contract.settled(block.after - 1, level)
            assert lost is not None
            money -= lost if delivered else 0.0
            level = np.zeros_like(level)
        level_after = level if delivered else level_after
    return ForwardPosition(level_after, held, money, volume)


class Rolled(NamedTuple):
    """[N] the discounted money of each path, and the volume traded, summed over the days of
    delivery."""

    money: np.ndarray
    traded: np.ndarray


def rolling(
    chains: Chains,
    blocks: Callable[[int], tuple[TradeBlock, ...]],
    curves: Callable[[int], np.ndarray],
    paths: int,
    before: bool = False,
) -> Rolled:
    """Rolling intrinsic on some paths.

    - `blocks`: returns the blocks that are traded on a step, with the step itself first.
    - `curves`: returns the forward prices [T + 1 - t, N] on step t, for this step, all later steps
      and the end date.
    - `before`: whether the valuation date is before the first step; `blocks` and `curves` of step
      -1 are then those of the valuation date.
    """
    contract = chains.contract
    position = ForwardPosition.initial(contract, paths)
    if before:
        links = chains.of(blocks(-1))
        position = traded(contract, links, curves(-1), position, delivers=False)
    for t in range(contract.horizon):
        links = chains.of(blocks(t))
        position = traded(contract, links, curves(t), position, delivers=True)
    final = contract.final(position.level, curves(contract.horizon)[-1])
    return Rolled(position.money + final, position.traded)


def intrinsic_in(
    contract: FlatContract, blocks: tuple[TradeBlock, ...], curve: np.ndarray
) -> float:
    """The value of the best plan in products at the forward prices [T + 1] of today."""
    links = Chains(contract, PLAN_NODES).of(blocks)
    return float(
        planned(contract, links, curve[:, None], ForwardPosition.initial(contract, 1)).value[0]
    )
