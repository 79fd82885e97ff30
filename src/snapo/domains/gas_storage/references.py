"""Exact and classical answers for a storage contract, in plain NumPy and SciPy (float64).

Every function reads the prepared schedule with NumPy leaves and returns present values on the
valuation date, before fixed costs. On any contract

    intrinsic <= exact (`lattice`) <= mean of `perfect_foresight`,

and a policy's value is at most the exact one.
"""

from typing import NamedTuple

import jax
import numpy as np
from scipy.special import ndtr

from .day_terms import Interpolation, end_value, rates, unit_prices, volume_scale
from .intrinsic import Plan as Plan
from .intrinsic import intrinsic as intrinsic
from .lattice import LatticeResult as LatticeResult
from .lattice import lattice as lattice
from .lattice import relevant_factors as relevant_factors
from .lattice_day import decide, free_volumes, inventory_nodes
from .linear_program import intrinsic_by_linear_program as intrinsic_by_linear_program
from .marginal import MarginalValues as MarginalValues
from .marginal import marginal_values as marginal_values
from .piecewise import visited


def numpy_schedule(schedule):
    """The prepared schedule with float64 NumPy leaves, as every reference reads it."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), schedule)


def perfect_foresight(
    schedule,
    interpolation: Interpolation,
    spots: np.ndarray,
    *,
    inventories: int = 201,
    block: int = 512,
) -> np.ndarray:
    """What each path would earn if it were known in advance: [paths].

    `spots`: [paths, T] spot prices, or [paths, T + 1] where the gas left has a price. Values are
    linear between grid points of the inventory, so on a concave contract a little low.
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


class Call(NamedTuple):
    """A European call on a forward: its present value, and that value's derivative by it."""

    value: np.ndarray
    delta: np.ndarray


def black_call(forward, strike, deviation, discount=1.0) -> Call:
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
    return Call(discount * (forward * delta - strike * exercised), discount * delta)
