"""The days of a store on regular nodes alone: its contract decides about them, and no price."""

import numpy as np

from ..references.day_terms import Interpolation, rates
from ..references.lattice_day import inventory_nodes
from ..references.piecewise import visited
from .day_grid import DayGrid, one_day, spacing_of
from .recent import Recent

# All that the grids follow from. A name that is missing here would leave old grids in use.
STEPS = (
    "levels", "injection_rate", "withdrawal_rate", "min_injection", "min_withdrawal",
    "inventory_loss", "high", "next_low", "next_high", "inventory_cost", "flow_discount",
)  # fmt: skip
CONSTANTS = ("inventory", "end_levels")

_last: Recent[list[DayGrid]] = Recent(2)  # those of the case, and of another input


def regular_grids(schedule, interpolation: Interpolation, inventories: int) -> list[DayGrid]:
    """All T days; `inventories` points from 0 to the largest inventory, and the ratchet rows.

    Only inventories that the one in store can become.
    """
    key = interpolation, inventories, *_numbers(schedule)
    return _last.of(key, lambda: _made(schedule, interpolation, inventories))


def _made(schedule, interpolation: Interpolation, inventories: int) -> list[DayGrid]:
    horizon = len(schedule.steps.forward)
    low, high = visited(schedule, interpolation)
    spacing = spacing_of(schedule, inventories)
    day_rates = [rates(schedule, interpolation, t) for t in range(horizon)]
    levels = [day.levels for day in day_rates] + [schedule.constants.end_levels]
    nodes = [inventory_nodes(*each[:2], spacing, each[2]) for each in zip(low, high, levels)]
    return [
        one_day(schedule, day_rates[t], t, nodes[t], nodes[t + 1], bends=False)
        for t in range(horizon)
    ]


def _numbers(schedule) -> list[bytes]:
    parts = (schedule.steps, STEPS), (schedule.constants, CONSTANTS)
    return [np.asarray(getattr(part, name)).tobytes() for part, names in parts for name in names]
