"""The value of a store whose prices are known in advance, path by path: an upper bound.

On any contract intrinsic <= exact (`lattice`) <= mean of `perfect_foresight`, and a policy's value
is at most the exact one. All are present values on the valuation date, before fixed costs, from
the prepared schedule with NumPy leaves.
"""

import numpy as np

from .day_terms import Interpolation, end_value, rates, unit_prices, volume_scale
from .lattice_day import decide, free_volumes, inventory_nodes
from .piecewise import visited


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
