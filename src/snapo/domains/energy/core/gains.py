"""The gains of the units of a feasible volume, from the rows of a table of unit values.

The value of one more unit of a volume is constant between the rows of the table and changes at
them. A line through the gains of a few units would place the last profitable unit between rows,
where the best volume never lies; without volatility, 0.1 to 0.7 % of the value would be lost. If a
volume spans several rows, the last profitable row is therefore searched for. If the value jumps
between levels, the search is for the row at which the sum of the gains is largest.
"""

import functools
import itertools
import math
from collections.abc import Callable
from typing import NamedTuple, Self

import jax.numpy as jnp
from jaxtyping import Array

from .tables import NEAR, UnitValues, along, nearest_row, row_number

ROUND_OFF = 1e-3  # of a whole number
SEGMENTS = 4  # of a volume; the gain of a unit is linear within each


class VolumeGains(NamedTuple):
    """The gains of a free volume. `units` [SEGMENTS]: the gains of the units at both ends of each
    segment; `positions` [SEGMENTS - 1]: the limits between segments, as shares of the volume."""

    units: list[tuple[Array, Array]]
    positions: list[Array]

    @classmethod
    def even(cls, units: list[Array]) -> Self:
        """Segments of the same length between these units."""
        positions = [jnp.full((), j / SEGMENTS, units[0].dtype) for j in range(1, SEGMENTS)]
        return cls(list(itertools.pairwise(units)), positions)


class FlowRows(NamedTuple):
    """The rows along a flow from levels `start`, in the table of a step.

    `pair`: the number of the pair of a move and the flow; `effects`: the effects of the flow on the
    levels, not all zero; `banks`: how many of the last levels are balances, between whose rows
    values are linear; `signs`: the signs of the layout.
    """

    table: UnitValues
    pair: int
    effects: tuple[float, ...]
    start: Array
    banks: int
    signs: tuple[int, ...]

    def gains(self, forced: Array, free: Array, read: Array, unit: Array) -> VolumeGains:
        """The gains of the units of a `free` volume beyond a `forced` one. `read`: the values of
        the functions of the prices; `unit`: the earnings of a unit today."""
        if self.table.slopes.shape[1:-1]:
            if self.table.units is not None:
                return self._searched(self.table.units[self.pair], forced, free, read, unit)
            if self.table.every is not None:
                return self._compared(self.table.every[self.pair], forced, free, read, unit)
            if self.table.between is not None:
                return self._between_rows(self.table.between[self.pair], forced, free, read, unit)
        positions = [forced + free * (j / SEGMENTS) for j in range(SEGMENTS + 1)]
        rows = [self._slope(x, x is positions[-1]) for x in positions]
        return VolumeGains.even([unit + jnp.sum(row * read) for row in rows])

    def _searched(self, units: Array, forced, free, read, unit: Array) -> VolumeGains:
        """The segments are the rows before the last profitable row, that row, the next one, and the
        rows behind the next one."""
        dims, flat = self._table
        position, start, room, stride, behind = self._along(forced)
        length = free / units[-1]
        count = jnp.maximum(jnp.minimum(jnp.ceil(behind + length - NEAR), room + 1), 1.0)
        shares = []
        for i in range(-self.banks, 0):
            left, share = _between(position[i], dims[i])
            start = start.at[i].set(left)
            shares.append((share, math.prod(dims[len(dims) + i + 1 :])))
        first_row = row_number(self.pair, start, dims)

        def between(at: Array, shares: list) -> Array:
            if not shares:
                return jnp.sum(flat[at] * read)
            (share, further), *others = shares
            value = between(at, others)
            return value + share * (between(at + further, others) - value)

        def gain(row: Array) -> Array:
            at = first_row + (row * stride).astype(jnp.int32)
            return unit + between(at, shares)

        return _up_to_last(gain, lambda row: row - behind, count, length, len(units))

    def _compared(self, units: Array, forced, free, read, unit: Array) -> VolumeGains:
        """The segments are the rows up to the one at which the sum of the gains is largest, and the
        rows behind it, both with their mean gain."""
        dims, flat = self._table
        _, start, room, stride, behind = self._along(forced)
        length, first_row = free / units[-1], row_number(self.pair, start, dims)
        gained = end = best = at_best = jnp.zeros_like(length)
        gains = []
        for k in range(len(units)):
            row = jnp.minimum(float(k), room)
            gains.append(unit + jnp.sum(flat[first_row + (row * stride).astype(jnp.int32)] * read))
            further = jnp.clip(k + 1 - behind, 0.0, length)
            gained, end = gained + gains[-1] * (further - end), further
            better = gained > best
            best, at_best = jnp.where(better, gained, best), jnp.where(better, end, at_best)
        left = length - at_best
        up_to = jnp.where(at_best > 0, best / jnp.where(at_best > 0, at_best, 1.0), gains[0])
        after = jnp.where(left > 0, (gained - best) / jnp.where(left > 0, left, 1.0), gains[-1])
        position = at_best / jnp.where(length > 0, length, 1.0)
        return VolumeGains([(up_to, up_to)] * 2 + [(after, after)] * 2, [position] * (SEGMENTS - 1))

    def _along(self, forced: Array) -> tuple[Array, Array, Array, Array, Array]:
        """For the rows along the flow: the position after the forced volume, the row from which the
        free volume starts, how many rows are ahead, the difference between the numbers of
        neighbouring rows, and the part of the first row that is already behind. All levels that the
        flow moves and that have several rows change their rows together."""
        dims = self._table[0]
        position = position_of(self.table, self._levels(forced))
        start = along(position, self.effects, first=True)
        touched = [i for i, effect in enumerate(self.effects) if effect]
        room, stride, behind = jnp.full((), jnp.inf), jnp.zeros(()), jnp.zeros(())
        for i in reversed(touched):
            up, several = self.effects[i] > 0, self.table.rows.spacing[i] > 0
            left_over = dims[i] - 1 - start[i] if up else start[i]
            room = jnp.where(several, jnp.minimum(room, left_over), room)
            step = math.prod(dims[i + 1 :]) * (1.0 if up else -1.0)
            stride = stride + jnp.where(several, step, 0.0)
            off = position[i] - start[i]
            behind = jnp.where(several, off if up else -off, behind)
        return position, start, room, stride, behind

    def _between_rows(self, units: Array, forced, free, read, unit: Array) -> VolumeGains:
        """The segments are the pieces before the last profitable piece, that piece, the next one,
        and the pieces behind the next one. A piece ends where any level that the flow moves passes
        a row.

        The value is linear on simplices along the flows (`methods/corners.py`). On a piece it
        therefore changes as along one of the edges of the cell between rows, and every edge is a
        row of the table. Levels pass their rows in the order of their distances from them.
        """
        dims, flat = self._table
        position = position_of(self.table, self._levels(forced))
        touched = [i for i, effect in enumerate(self.effects) if effect]
        reversed_signs = self.signs[touched[0]] * self.effects[touched[0]] < 0
        signs = [-sign if reversed_signs else sign for sign in self.signs]
        # A level that does not move changes its row where the moving one passes its share.
        crossing = list(range(len(dims))) if len(touched) == 1 else touched
        floors = [jnp.floor(x * sign + NEAR) for x, sign in zip(position, signs)]
        shares = [jnp.maximum(x * sign - y, 0.0) for x, sign, y in zip(position, signs, floors)]
        several = [self.table.rows.spacing[i] > 0 for i in range(len(dims))]
        nearest = functools.reduce(
            jnp.minimum, [jnp.where(several[i], 1 - shares[i], 1.0) for i in touched]
        )
        passed, distances = {}, {}
        for i in crossing:
            distance, between = 1 - shares[i], several[i]
            if i not in touched:
                distance = shares[i] - shares[touched[0]]
                passed[i] = jnp.where(distance > 0, 0.0, 1.0)
                distance = jnp.where(distance > 0, distance, distance + 1)
                between = between & (shares[i] > NEAR)
            distances[i] = jnp.where(between, distance, nearest)
            if i in passed:
                passed[i] = jnp.where(between, passed[i], jnp.inf)
        ranks = {
            i: sum((distances[j] < distances[i] - NEAR) * 1.0 for j in crossing if j != i)
            for i in crossing
        }
        kinds, length = len(crossing), free / units[-1]
        crossed = [jnp.maximum(jnp.ceil(length - NEAR - distances[i]), 0.0) for i in crossing]
        count = 1 + functools.reduce(jnp.add, crossed)

        def gain(piece: Array) -> Array:
            times = {
                i: jnp.floor((piece + kinds - 1 - rank) / kinds + ROUND_OFF)
                for i, rank in ranks.items()
            }
            row = jnp.round(position)
            for i in crossing:
                further = times[i]
                if i in passed:  # its row is the next one until it is passed
                    since = passed[i] + times[i] - times[touched[0]]
                    further = jnp.where(since > 0, 0.0, 1.0)
                row = row.at[i].set((floors[i] + further) * signs[i])
            return unit + jnp.sum(nearest_row(flat, self.pair, row, dims) * read)

        def start(piece: Array) -> Array:
            before = jnp.floor((piece - 1) / kinds + ROUND_OFF)
            rest = piece - 1 - kinds * before + ROUND_OFF
            parts = [jnp.where(ranks[i] <= rest, distances[i], 0.0) for i in crossing]
            return jnp.where(piece > 0, before + functools.reduce(jnp.maximum, parts), 0.0)

        return _up_to_last(gain, start, count, length, len(units))

    @property
    def _table(self) -> tuple[tuple[int, ...], Array]:
        """The number of rows of each level, and the rows of all pairs in one array."""
        slopes = self.table.slopes
        return slopes.shape[1:-1], slopes.reshape((-1, slopes.shape[-1]))

    def _levels(self, volume: Array) -> Array:
        return self.start + volume * jnp.asarray(self.effects)

    def _slope(self, volume: Array, last: bool) -> Array:
        """The slopes of the unit that follows a volume, or (`last`) of the last unit of the volume;
        interpolated between the rows of the balances of a bank, which are the last levels."""
        dims, flat = self._table
        if not dims:
            return flat[self.pair]
        position = position_of(self.table, self._levels(volume))
        row = along(position, self.effects, not last)

        def between(row: Array, banks: int) -> Array:
            if not banks:
                return nearest_row(flat, self.pair, row, dims)
            left, share = _between(position[-banks], dims[-banks])
            sides = [between(row.at[-banks].set(left + k), banks - 1) for k in (0, 1)]
            return sides[0] + share * (sides[1] - sides[0])

        return between(row, self.banks)


def _up_to_last(
    gain: Callable, start: Callable, count: Array, length: Array, searches: int
) -> VolumeGains:
    """The gains of a volume with `count` parts and the length `length`, whose last profitable part
    is determined in `searches` steps of bisection. `gain`: the gain of a unit in a part; `start`:
    the position at which a part starts."""
    first, last = gain(jnp.zeros_like(count)), gain(count - 1)
    gaining, above, below = jnp.zeros_like(count), first, first
    for power in reversed(range(searches)):
        part = jnp.minimum(gaining + (2**power - 1), count - 1)
        gained = gain(part)
        more = gained > 0
        gaining = jnp.where(more, part + 1, gaining)
        above, below = jnp.where(more, gained, above), jnp.where(more, below, gained)
    divisor = jnp.where(length > 0, length, 1.0)
    positions = [jnp.clip(start(gaining + k) / divisor, 0.0, 1.0) for k in (-1, 0, 1)]
    return VolumeGains([(first, above), (above, above), (below, below), (below, last)], positions)


def _between(position: Array, count: int) -> tuple[Array, Array]:
    """The row below a position among `count` rows, and the weight of the next row."""
    left = jnp.clip(jnp.floor(position), 0.0, max(count - 2, 0))
    return left, jnp.clip(position - left, 0.0, 1.0)


def position_of(table: UnitValues, levels: Array) -> Array:
    """[levels] the position of the levels, counted in rows."""
    rows = table.rows
    return (levels - rows.low) * (1 / jnp.where(rows.spacing > 0, rows.spacing, 1.0))
