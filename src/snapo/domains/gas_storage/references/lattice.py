"""Dynamic programming in time, inventory and one or two price factors.

Each day has a grid of inventories: the multiples of one spacing that can be reached from the
initial inventory, with both ends of the interval and the ratchet levels. Values are linear in the
inventory between nodes, and decisions are feasible up to rounding. For a concave contract the grid
can therefore only lower the result. `marginal` describes how the factors are integrated.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..prices.process import GaussianFactors
from .breakpoints import breakpoints
from .day_terms import Interpolation, end_value, rates, unit_prices, volume_scale
from .lattice_day import DayDecisions, Volumes, decide, follow, free_volumes, inventory_nodes
from .marginal import FactorGrid, common_volume, factor_grid
from .piecewise import visited


class ExpectedPath(NamedTuple):
    """The expected path under the decisions of a lattice; see `LatticeResult`."""

    deltas: np.ndarray
    end_delta: float
    net: np.ndarray
    inventory: np.ndarray


@dataclass(frozen=True, eq=False)
class LatticeResult:
    """The result of the dynamic program. Money is a present value on the valuation date.

    - `value`: the value of the contract, before fixed costs.
    - `selected`: indices of the price factors on the grid, the fast factor first; `dropped`: the
      indices of the others.
    - `follow`: the forward sweep; it runs once, when one of the following attributes is first read.
    - `deltas`: [T] the derivative of the value with respect to the forward price of each day, as a
      discounted volume (positive for gas sold), by the envelope theorem; `end_delta`: the
      derivative with respect to the price of the end date.
    - `net`: [T] expected net injection; `inventory`: [T + 1] expected inventory.
    """

    value: float
    selected: tuple[int, ...]
    dropped: tuple[int, ...]
    follow: Callable[[], ExpectedPath]

    @cached_property
    def _expected(self) -> ExpectedPath:
        return self.follow()

    @property
    def deltas(self) -> np.ndarray:
        return self._expected.deltas

    @property
    def end_delta(self) -> float:
        return self._expected.end_delta

    @property
    def net(self) -> np.ndarray:
        return self._expected.net

    @property
    def inventory(self) -> np.ndarray:
        return self._expected.inventory


def lattice(
    schedule,
    factors: GaussianFactors,
    interpolation: Interpolation,
    keep: tuple[int, ...] | None = None,
    *,
    inventories: int = 201,
    step: float | None = None,
    nodes: list[np.ndarray] | None = None,
    spacing: float | None = None,
    slow_nodes: int = 17,
    volumes: Volumes = "free",
) -> LatticeResult:
    """The value of the contract by dynamic programming, with deltas from one forward sweep.

    **Arguments:**

    - `factors`: the factors of the price process, which must be Gaussian for the value to be exact.
    - `keep`: indices of the one or two factors that are used; by default `relevant_factors`.
    - `inventories`: the number of grid points from 0 to the largest inventory; or `step`, the
      volume between them; or `nodes`, [T + 1] the inventories of each day and of the end date, see
      `breakpoints`.
    - `spacing`: the spacing of the nodes of the fast factor, in standard deviations of its daily
      shock; by default 0.15 for one factor and 0.3 for two. The error falls with its square; deltas
      need a finer grid than values.
    - `slow_nodes`: the number of nodes of the second factor.
    - `volumes`: "extremes" allows the largest injection, the largest withdrawal and the flow
      nearest to zero of each day. "free" also allows flows up to the inventory at which the value
      of more gas falls below its price. "every" allows flows to every grid point, as does "free"
      with step ratchets.
    """
    every = range(factors.loading.shape[1])
    selected = relevant_factors(schedule, factors) if keep is None else tuple(keep)
    if not 1 <= len(selected) <= 2:
        message = f"a lattice supports one or two price factors, but {selected} are relevant"
        raise ValueError(f"lattice: {message}; name one or two factors in `keep`.")
    dropped = tuple(i for i in every if i not in selected)
    if len(schedule.steps.forward) == 0:
        return _at_the_end(schedule, selected, dropped)
    if volumes == "free":
        volumes = free_volumes(schedule, interpolation)
    spacing = spacing or SPACINGS[coordinates(factors, selected)]
    grid = factor_grid(factors, selected, spacing, slow_nodes)
    if nodes is None:
        step = step or volume_scale(schedule) / (inventories - 1)
        nodes = _regular(schedule, interpolation, step)
    days, value = _backward(schedule, interpolation, grid, nodes, volumes)
    return LatticeResult(value, selected, dropped, lambda: _forward(schedule, grid, days))


def _at_the_end(schedule, selected, dropped) -> LatticeResult:
    """The result if no decision is left: the value of the gas in store."""
    constants = schedule.constants
    stock = np.array([constants.inventory])
    value = float(end_value(schedule, stock, constants.end_forward)[0])
    delta = float(constants.end_fraction * constants.end_discount * constants.inventory)
    expected = ExpectedPath(np.zeros(0), delta, np.zeros(0), stock)
    return LatticeResult(value, selected, dropped, lambda: expected)


def relevant_factors(schedule, factors: GaussianFactors) -> tuple[int, ...]:
    """The factors that move the value, the fastest first.

    If prices are proportional to the curve, a factor without mean reversion that has the same
    loading on all days, and is independent of the others, scales all prices in proportion. Without
    fixed or proportional costs such a factor does not change the value (a change of numeraire), and
    with small costs it hardly does; a fixed payment for the gas left counts as a cost. The factor
    is dropped unless it is the only one.
    """
    if len(schedule.steps.forward) == 0:
        return (0,)
    # The end date counts where the gas left has a price.
    loading = factors.loading if schedule.constants.end_fraction != 0 else factors.loading[:-1]
    decay, shock = factors.decay, factors.shock
    increments = np.max(np.abs(shock @ np.swapaxes(shock, 1, 2)), axis=0)
    alone = np.count_nonzero(increments > 1e-12 * increments.max(), axis=1) <= 1
    common = np.ptp(loading, axis=0) <= 1e-12 * np.abs(loading).max()
    neutral = alone & common & np.all(decay == 1, axis=0) & factors.proportional
    # A factor that never moves any price is dropped as well.
    defaulted = (np.abs(loading).max(axis=0) == 0) | (np.diagonal(increments) == 0)
    speed = np.argsort(decay.mean(axis=0), kind="stable")
    selected = tuple(int(i) for i in speed if not neutral[i] and not defaulted[i])
    return selected or (int(speed[0]),)


def coordinates(factors: GaussianFactors, selected: tuple[int, ...]) -> int:
    """The number of coordinates of a grid of prices: the selected factors, and the spikes."""
    return len(selected) + (factors.spikes is not None)


def _regular(schedule, interpolation, spacing: float) -> list[np.ndarray]:
    """[T + 1] the grids: evenly spaced inventories, the ratchet levels and the ends of the interval
    of each day."""
    horizon = len(schedule.steps.forward)
    low, high = visited(schedule, interpolation)
    levels = [rates(schedule, interpolation, t).levels for t in range(horizon)]
    levels.append(schedule.constants.end_levels)
    return [inventory_nodes(*item[:2], spacing, item[2]) for item in zip(low, high, levels)]


def _backward(schedule, interpolation, grid: FactorGrid, nodes: list[np.ndarray], volumes):
    """The decisions of all days, and the value today."""
    steps, constants = schedule.steps, schedule.constants
    horizon = len(steps.forward)
    spots = grid.spot(horizon, constants.end_forward)
    value = end_value(schedule, nodes[horizon][:, None], spots)
    days: list[DayDecisions] = []
    for t in reversed(range(horizon)):
        after = grid.after(t).expect(value)
        day_rates = rates(schedule, interpolation, t)
        prices = unit_prices(schedule, t, grid.spot(t, steps.forward[t]))
        held = nodes[t], nodes[t + 1]
        day, value = decide(schedule, day_rates, t, prices, *held, after, volumes)
        days.append(day)
    return days[::-1], float(grid.start().expect(value)[0, 0])


def _forward(schedule, grid: FactorGrid, days: list[DayDecisions]) -> ExpectedPath:
    """Follows the decisions from today."""
    steps, constants = schedule.steps, schedule.constants
    horizon = len(days)
    deltas, net, stock = np.zeros(horizon), np.zeros(horizon), np.zeros(horizon + 1)
    weight, nodes = grid.start().spread(np.ones((1, 1))), np.array([constants.inventory])
    for t, day in enumerate(days):
        flow = follow(day, weight)
        stock[t] = weight.sum(axis=1) @ day.inventory
        net[t] = flow.injected.sum() - flow.withdrawn.sum()
        sold = (1 - steps.withdrawal_fuel[t]) * flow.withdrawn
        sold -= (1 + steps.injection_fuel[t]) * flow.injected
        deltas[t] = steps.gas_discount[t] * (grid.by_forward(t) @ sold)
        weight, nodes = grid.after(t).spread(flow.weight), day.nodes
    left = nodes @ weight
    stock[horizon] = left.sum()
    end_delta = constants.end_fraction * constants.end_discount * (grid.by_forward(horizon) @ left)
    return ExpectedPath(deltas, float(end_delta), net, stock)


MOVED = 1e-4  # of the value: a grid is fine enough when half its spacing moves the value by less
HALVED = 3  # times at most
SPACINGS = {1: 0.15, 2: 0.3}  # of the fast factor's nodes, by the number of factors
NODES = (200, 30)  # spacings of the first grid of inventories, without spikes and with them
MAX_NODES = 800  # and of one of daily flows
SLOW = 17


class Refined(NamedTuple):
    """A present value before fixed costs, and its error: the sum of the last changes on finer
    grids."""

    value: float
    error: float


def refined(schedule, factors: GaussianFactors, interpolation: Interpolation) -> Refined:
    """The value of the lattice; the grids of volumes and of prices are refined until it is stable.

    With constant rates the inventories are the breakpoints of the value, which are exact. Otherwise
    the first grid of volumes contains every daily flow, if the flows have a common measure. Any
    other grid would lower the value of a store with round volumes.
    """
    if len(schedule.steps.forward) == 0:
        return Refined(lattice(schedule, factors, interpolation).value, 0.0)
    selected = relevant_factors(schedule, factors)
    count = coordinates(factors, selected)
    step = _first_step(schedule, NODES[factors.spikes is not None])
    nodes = breakpoints(schedule, interpolation, *visited(schedule, interpolation), MAX_NODES)
    spacing = SPACINGS[min(count, 2)]

    def value(parts: int = 1, finer: int = 1, slow: int = SLOW) -> float:
        grids = {"step": step / parts, "spacing": spacing / finer, "slow_nodes": slow}
        return lattice(schedule, factors, interpolation, selected, nodes=nodes, **grids).value

    first = value()
    results = [on_finer_grids(first, lambda n: value(finer=n))]
    if nodes is None:
        results.append(on_finer_grids(first, value))
    if count > 1:
        results.append(on_finer_grids(first, lambda n: value(slow=(SLOW - 1) * n + 1)))
    total = first + sum(item.value - first for item in results)
    return Refined(total, sum(entry.error for entry in results))


def on_finer_grids(first: float, value: Callable[[int], float], enough: float = MOVED) -> Refined:
    """The value on a grid whose spacing is halved until the value changes by less than the share
    `enough`; and the last change."""
    before, moved = first, 0.0
    for times in range(1, HALVED + 1):
        after = value(2**times)
        before, moved = after, abs(after - before)
        if moved <= enough * abs(after):
            break
    return Refined(before, moved)


def _first_step(schedule, nodes: int) -> float:
    """The spacing of inventories: a fraction of the common measure of the daily flows, if
    possible."""
    room = volume_scale(schedule)
    volume = common_volume(schedule.steps)
    if volume is None or volume < room / MAX_NODES:
        return room / nodes
    return volume / max(1, round(volume * nodes / room))
