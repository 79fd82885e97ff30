"""The boundary of the design space, with an interval, along the lines of its map.

Every point of the map uses the same draws. Between two points the distance of each draw from each
limit is interpolated linearly, so that the share of the draws that meet all limits is known at any
position on a line, to second order in the map's spacing. The boundary is where that share falls
below the required probability. A position belongs to the boundary's 95 % interval if Wilson's
interval of the share there contains the required probability; this inverts a test of the share
(Casella and Berger, Statistical Inference, section 9.2).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from snapo.study.chapter import Number

from ..flowsheet.case import PharmaCase
from .batches import AttributeLimits

LEVEL = 0.95


def interval(share, of: int, level: float = LEVEL) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest probability supported by the `share` of a number of draws (Wilson 1927).

    It is also valid near 0 and 1: if all of 128 draws meet the limits, its lower limit is 0.971.
    """
    z = ndtri((1 + level) / 2)
    p = np.asarray(share, np.float64)
    middle = (p + z**2 / (2 * of)) / (1 + z**2 / of)
    half = z / (1 + z**2 / of) * np.sqrt(p * (1 - p) / of + z**2 / (4 * of**2))
    # Round-off must not make a share of 0 or 1 lie outside its own interval.
    return np.clip(middle - half, 0.0, p), np.clip(middle + half, p, 1.0)


def draws_for(probability: float, level: float = LEVEL) -> int:
    """The number of draws for which the interval is above a probability if all draws are
    successful."""
    z = ndtri((1 + level) / 2)
    return int(np.ceil(z**2 * probability / (1 - probability)))


PARTS = 16  # of a cell of the map, between which the share is straight
FAR = 1e6  # margins: of a draw without a finite result, and of an attribute without limits


@dataclass(frozen=True)
class Boundary:
    """One position at which the design space ends.

    - `axis`: number of the axis along which the line runs; `at`: number of the grid point on every
      axis, -1 on the axis of the line; `side`: -1 if the space ends towards low values, +1 towards
      high.
    - `position`: the position of the boundary; `inner`, `outer`: its 95 % interval, `inner` inside
      the space; in the unit of the grid. NaN if this end is beyond the line.
    - `binding`: number of the attribute that most often violates its limits just beyond the
      boundary.
    """

    axis: int
    at: tuple[int, ...]
    side: int
    position: Number
    inner: Number
    outer: Number
    binding: int


def distances(case: PharmaCase, values: Float[np.ndarray, "*n Q"]) -> Float[np.ndarray, "*n Q"]:
    """The distance of every value to the nearest of its limits, in margins; below 0 beyond it."""
    limits, margins = (
        AttributeLimits.of(case),
        np.array([attribute.margin for attribute in case.attributes]),
    )
    room = np.minimum(limits.distance(values), values - limits.lower) / margins
    return np.clip(np.nan_to_num(room, nan=-FAR), -FAR, FAR)


def boundaries(
    rooms: Float[np.ndarray, "*n draws Q"], grid: Sequence[np.ndarray], required: float
) -> list[Boundary]:
    """All ends of the space along all lines of the map; `rooms`: `distances` at the points of the
    map."""
    results = []
    for axis, positions in enumerate(grid):
        lines = np.moveaxis(rooms, axis, 0)
        others = lines.shape[1:-2]
        for where in np.ndindex(*others):
            at = (*where[:axis], -1, *where[axis:])
            line = lines[(slice(None), *where)]
            results += [Boundary(axis, at, *item) for item in _of_line(line, positions, required)]
    return results


def _of_line(rooms: np.ndarray, positions: np.ndarray, required: float) -> list[tuple]:
    """(side, position, inner, outer, binding) of every end along one line; `rooms` [n, draws,
    Q]."""
    fine, share, worst = _shares(rooms, positions)
    low, high = interval(share, rooms.shape[1], LEVEL)
    valid, rows = share >= required, []
    for k in np.flatnonzero(valid[:-1] != valid[1:]).tolist():
        side = 1 if valid[k] else -1
        inside, outside = (k, k + 1) if valid[k] else (k + 1, k)
        position = _between(fine, share - required, inside, outside)
        inner = _end(fine, low - required, inside, -side, False, valid)
        outer = _end(fine, high - required, outside, side, True, ~valid)
        rows.append((side, position, inner, outer, int(worst[outside])))
    return rows


def _shares(rooms: np.ndarray, positions: np.ndarray):
    """Positions [m] along the line, the share of draws that meet all limits there, and the
    attribute that most often breaks its limits."""
    part = np.arange(PARTS) / PARTS
    fine, selected, worst = [], [], []
    for k in range(len(positions) - 1):
        inside = rooms[k] + part[:, None, None] * (rooms[k + 1] - rooms[k])
        fine.append(positions[k] + part * (positions[k + 1] - positions[k]))
        selected.append((inside >= 0).all(-1).mean(-1))
        worst.append((inside < 0).sum(1).argmax(-1))
    fine.append(positions[-1:])
    selected.append([(rooms[-1] >= 0).all(-1).mean()])
    worst.append([(rooms[-1] < 0).sum(0).argmax()])
    return np.concatenate(fine), np.concatenate(selected), np.concatenate(worst)


def _between(fine: np.ndarray, excess: np.ndarray, one: int, other: int) -> float:
    """The point with zero `excess` between two neighbours, one on each side of it."""
    share = excess[one] / (excess[one] - excess[other])
    return float(fine[one] + share * (fine[other] - fine[one]))


def _end(
    fine: np.ndarray, excess: np.ndarray, start: int, step: int, above: bool, stays: np.ndarray
) -> float:
    """The position, from `start` in steps of `step`, where `excess` changes its sign; it begins at
    or above zero if `above` is true. NaN if it does not change while `stays` holds."""
    k = start
    while 0 <= k < len(fine) and stays[k]:
        if (excess[k] >= 0) != above:
            return _between(fine, excess, k - step, k)
        k += step
    return float("nan")
