"""The value of the lattice on finer and finer grids, and by how much the last of them moved it."""

from collections.abc import Callable
from typing import NamedTuple

from ..prices.process import GaussianFactors
from .day_terms import Interpolation, volume_scale
from .lattice import lattice, relevant_factors
from .slope_table import common_volume

MOVED = 1e-4  # of the value: a grid is fine enough when half its spacing moves the value by less
HALVED = 3  # times at most
SPACINGS = {1: 0.15, 2: 0.3}  # of the fast factor's nodes, by the number of factors
NODES, MAX_NODES = 200, 800  # spacings of the first grid of inventories, and of one of daily flows
SLOW = 17


class Refined(NamedTuple):
    """A present value before fixed costs, and the sum of the last moves of its grids."""

    value: float
    error: float


def refined(schedule, factors: GaussianFactors, interpolation: Interpolation) -> Refined:
    """The lattice's value, the grids of volumes and of prices refined until they move it little.

    The first grid of volumes holds every daily flow where these have a common measure: a grid that
    does not makes a store of round volumes cheaper.
    """
    if len(schedule.steps.forward) == 0:
        return Refined(lattice(schedule, factors, interpolation).value, 0.0)
    selected = relevant_factors(schedule, factors)
    step, spacing = _first_step(schedule), SPACINGS[min(len(selected), 2)]

    def value(parts: int = 1, finer: int = 1, slow: int = SLOW) -> float:
        grids = {"step": step / parts, "spacing": spacing / finer, "slow_nodes": slow}
        return lattice(schedule, factors, interpolation, selected, **grids).value

    first = value()
    results = [_halved(first, value), _halved(first, lambda n: value(finer=n))]
    if len(selected) > 1:
        results.append(_halved(first, lambda n: value(slow=(SLOW - 1) * n + 1)))
    total = first + sum(item.value - first for item in results)
    return Refined(total, sum(entry.error for entry in results))


def _halved(first: float, value: Callable[[int], float]) -> Refined:
    """The value on a grid that is halved until that moves it little, and the last move."""
    before, moved = first, 0.0
    for times in range(1, HALVED + 1):
        after = value(2**times)
        before, moved = after, abs(after - before)
        if moved <= MOVED * abs(after):
            break
    return Refined(before, moved)


def _first_step(schedule) -> float:
    """The spacing of inventories: a part of the common measure of the daily flows, where it can."""
    room = volume_scale(schedule)
    volume = common_volume(schedule.steps)
    if volume is None or volume < room / MAX_NODES:
        return room / NODES
    return volume / max(1, round(volume * NODES / room))
