"""Independent references: a linear program, perfect foresight path by path, and Black's formula.

On any contract intrinsic <= exact (`lattice`) <= mean of `perfect_foresight`, and a policy's value
is at most the exact one. All are present values on the valuation date, before fixed costs, from
the prepared schedule with NumPy leaves. A right to withdraw on one day is a call on its forward.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse as sparse
from scipy.optimize import linprog
from scipy.special import ndtr

from snapo.domains.gas_storage.references.day_terms import (
    Interpolation,
    end_value,
    rates,
    unit_prices,
    volume_scale,
)
from snapo.domains.gas_storage.references.intrinsic import IntrinsicPlan, forward_prices, plan
from snapo.domains.gas_storage.references.lattice_day import decide, free_volumes, inventory_nodes
from snapo.domains.gas_storage.references.piecewise import visited


def intrinsic_by_linear_program(schedule, interpolation: Interpolation) -> IntrinsicPlan | None:
    """The intrinsic value by HiGHS, or None if a linear program would overstate it.

    Variables: each day's injection, withdrawal and inventory at its end, and the end value. Every
    linear piece of a concave rate limit is a tangent cut, and so is every piece of a concave end
    value. Injecting and withdrawing on one day must not pay.
    """
    horizon = len(schedule.steps.forward)
    if horizon == 0 or not _concave(schedule, interpolation):
        return None
    cuts, limits = _cuts(schedule, interpolation)
    balance, selected = _balance(schedule)
    answer = linprog(
        -_earned(schedule), cuts, limits, balance, selected, _bounds(schedule), method="highs"
    )
    if answer.status != 0:
        raise RuntimeError(f"The linear program of the intrinsic value failed: {answer.message}")
    inventory = np.append(schedule.constants.inventory, answer.x[2 * horizon : 3 * horizon])
    return plan(schedule, inventory)


def _concave(schedule, interpolation: Interpolation) -> bool:
    steps = schedule.steps
    low = np.append(steps.low, steps.next_low[-1])
    high = np.append(steps.high, steps.next_high[-1])
    for t in range(len(steps.forward)):
        prices, day = forward_prices(schedule, t), rates(schedule, interpolation, t)
        if prices.pay < prices.earn:
            return False
        for rate in (day.injection, day.withdrawal):
            if not _falls(_pieces(day.levels, rate, low[t], high[t])):
                return False
    return _falls(_end_pieces(schedule))


def _pieces(levels, values, low, high) -> list[tuple[float, float]]:
    """(slope, value at inventory 0) of every linear piece of a function within [low, high]."""
    inside = levels[(levels > low) & (levels < high)]
    endpoints = np.concatenate([[low], inside, [max(high, low + 1.0)]])
    at = np.interp(endpoints, levels, values)
    slopes = np.diff(at) / np.diff(endpoints)
    return list(zip(slopes, at[:-1] - slopes * endpoints[:-1], strict=True))


def _end_pieces(schedule) -> list[tuple[float, float]]:
    constants, steps = schedule.constants, schedule.steps
    levels, first = np.unique(constants.end_levels, return_index=True)
    at = constants.end_values[first]
    price = constants.end_fraction * constants.end_forward
    segments = _pieces(levels, at, steps.next_low[-1], steps.next_high[-1])
    discount = constants.end_discount
    return [((slope + price) * discount, level * discount) for slope, level in segments]


def _falls(segments) -> bool:
    slopes = np.array([slope for slope, _ in segments])
    return bool(np.all(np.diff(slopes) <= 1e-12 * max(1.0, np.abs(slopes).max())))


def _cuts(schedule, interpolation: Interpolation) -> tuple[sparse.csr_array, np.ndarray]:
    """A and b of A x <= b: rate limits that depend on the inventory, and the end value."""
    steps, horizon = schedule.steps, len(schedule.steps.forward)
    row, column, entry, limit = [], [], [], []

    def cut(variable: int, stock: int | None, slope: float, level: float):
        row.append(len(limit))
        column.append(variable)
        entry.append(1.0)
        if stock is not None:
            row.append(len(limit))
            column.append(stock)
            entry.append(-slope)
        limit.append(level)

    for t in range(horizon):
        day = rates(schedule, interpolation, t)
        stock = None if t == 0 else 2 * horizon + t - 1
        for variable, rate in ((t, day.injection), (horizon + t, day.withdrawal)):
            for slope, level in _pieces(day.levels, rate, steps.low[t], steps.high[t]):
                available = slope * schedule.constants.inventory if t == 0 else 0.0
                cut(variable, stock, slope, level + available)
    for slope, level in _end_pieces(schedule):
        cut(3 * horizon, 3 * horizon - 1, slope, level)
    shape = (len(limit), 3 * horizon + 1)
    result = np.array(entry), (np.array(row, np.int64), np.array(column, np.int64))
    return sparse.csr_array(result, shape), np.array(limit)


def _balance(schedule) -> tuple[sparse.csr_array, np.ndarray]:
    """End of day - in + out - (1 - loss) x start of day = 0."""
    horizon = len(schedule.steps.forward)
    keep = 1 - schedule.steps.inventory_loss
    one = sparse.eye_array(horizon)
    stock = one - sparse.diags_array(keep[1:], offsets=-1, shape=(horizon, horizon))
    blocks = [-one, one, stock, sparse.csr_array((horizon, 1))]
    selected = np.append(keep[0] * schedule.constants.inventory, np.zeros(horizon - 1))
    return sparse.hstack(blocks, format="csr"), selected  # pyright: ignore[reportReturnType]


def _earned(schedule) -> np.ndarray:
    """Present value of one unit of each variable (the cost of day 0's inventory is not one)."""
    steps = schedule.steps
    prices = [forward_prices(schedule, t) for t in range(len(steps.forward))]
    holding = steps.inventory_cost * steps.flow_discount
    return np.concatenate(
        [
            [-price.pay for price in prices],
            [price.earn for price in prices],
            -np.append(holding[1:], 0.0),
            [1.0],
        ]
    )


def _bounds(schedule) -> list[tuple[float | None, float | None]]:
    """Forced flows from below, and nothing the other way on their days; inventory limits."""
    steps = schedule.steps
    maximum = volume_scale(schedule)

    def flow(forced, other):
        return [
            (low, max(low, 0.0 if against > 0 else maximum))
            for low, against in zip(forced, other, strict=True)
        ]

    return [
        *flow(steps.min_injection, steps.min_withdrawal),
        *flow(steps.min_withdrawal, steps.min_injection),
        *zip(steps.next_low, steps.next_high, strict=True),
        (None, None),
    ]


def perfect_foresight(
    schedule,
    interpolation: Interpolation,
    spots: np.ndarray,
    *,
    inventories: int = 201,
    block: int = 512,
) -> np.ndarray:
    """The earnings of each path if it were known in advance: [paths].

    `spots`: [paths, T] spot prices, or [paths, T + 1] where the gas left has a price. Values are
    linear between grid points of the inventory, so on a concave contract slightly low.
    """
    spots = np.asarray(spots, np.float64)
    chunks = (spots[first : first + block] for first in range(0, len(spots), block))
    solved = [_known_prices(schedule, interpolation, part.T, inventories) for part in chunks]
    return np.concatenate(solved) if solved else np.zeros(0)


def _known_prices(schedule, interpolation: Interpolation, spots, inventories: int) -> np.ndarray:
    horizon = len(schedule.steps.forward)
    low, high = visited(schedule, interpolation)
    volumes = free_volumes(schedule, interpolation)
    spacing = volume_scale(schedule) / (inventories - 1)
    nodes = inventory_nodes(low[horizon], high[horizon], spacing, schedule.constants.end_levels)
    last = spots[horizon] if len(spots) > horizon else np.zeros(spots.shape[1])
    value = end_value(schedule, nodes[:, None], last)
    for t in reversed(range(horizon)):
        day_rates, prices = rates(schedule, interpolation, t), unit_prices(schedule, t, spots[t])
        inventory = inventory_nodes(low[t], high[t], spacing, day_rates.levels)
        _, value = decide(schedule, day_rates, t, prices, inventory, nodes, value, volumes)
        nodes = inventory
    return value[0]


class BlackCall(NamedTuple):
    """A European call on a forward: its present value, and its derivative with respect to the
    forward."""

    value: np.ndarray
    delta: np.ndarray


def black_call(forward, strike, deviation, discount=1.0) -> BlackCall:
    """Black (1976): discount x E[(F exp(deviation Z - deviation^2 / 2) - strike)+], Z normal.

    `deviation` is the standard deviation of ln S at expiry (0: the intrinsic value); all
    arguments broadcast. Prices in currency per unit. A withdrawal right on one day is such a call.
    """
    forward, strike, deviation, discount = np.broadcast_arrays(
        *(np.asarray(x, np.float64) for x in (forward, strike, deviation, discount))
    )
    live = (deviation > 0) & (strike > 0)
    width = np.where(live, deviation, 1.0)
    ratio = np.log(forward / np.where(live, strike, forward))
    upper = np.where(live, ratio / width + width / 2, np.where(forward > strike, np.inf, -np.inf))
    delta = ndtr(upper)
    exercised = ndtr(np.where(live, upper - width, upper))
    return BlackCall(discount * (forward * delta - strike * exercised), discount * delta)
