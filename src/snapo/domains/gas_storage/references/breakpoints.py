"""Inventories at which the value of a store with constant rates can bend: exact nodes.

The best flow of a day is the smallest flow, the largest flow or no flow, or it ends at an inventory
at which the value after the day bends. If rates do not depend on the inventory and there are no
losses, the value at the start of the day bends only at inventories from which one of these three
flows ends at such a bend. Backwards from the end date, every breakpoint is computed in this way.
Values that are linear between them remain linear for all prices.
"""

import numpy as np

from .day_terms import Interpolation, flow_ends, rates, volume_scale

MAXIMUM = 1000  # nodes of a day; a contract of more is left to a regular grid
SAME = 1e-9  # of the largest inventory: breakpoints nearer to one another are one


def breakpoints(
    schedule,
    interpolation: Interpolation,
    low: np.ndarray,
    high: np.ndarray,
    maximum: int = MAXIMUM,
) -> list[np.ndarray] | None:
    """[T + 1] the rising inventories of each day and of the end date, with both ends of the
    interval of each.

    `low`, `high`: [T + 1] the ends of these intervals, see `piecewise.visited`. None if rates
    depend on the inventory, if gas is lost, or if a day has more than `maximum` inventories.
    """
    steps = schedule.steps
    depends = [np.ptp(item, axis=1) > 0 for item in (steps.injection_rate, steps.withdrawal_rate)]
    if np.any(depends) or np.any(np.asarray(steps.inventory_loss) != 0):
        return None
    near = SAME * volume_scale(schedule)
    horizon, empty = len(steps.forward), np.zeros(1)
    nodes = [_within(schedule.constants.end_levels, low[horizon], high[horizon], near)]
    for t in reversed(range(horizon)):
        keep, down, up = flow_ends(schedule, rates(schedule, interpolation, t), t, empty)
        flows = [down, up, *([keep] if down <= keep <= up else [])]
        before = np.concatenate([nodes[-1] - flow for flow in flows])
        nodes.append(_within(before, low[t], high[t], near))
        if len(nodes[-1]) > maximum:
            return None
    return nodes[::-1]


def _within(points: np.ndarray, low: float, high: float, near: float) -> np.ndarray:
    """The ends of the interval and the points between them, without duplicates."""
    if high - low <= near:
        return np.array([low])
    inside = np.sort(points[(points > low + near) & (points < high - near)])
    inside = inside[np.append(True, np.diff(inside) > near)[: len(inside)]]
    return np.concatenate([[low], inside, [high]])
