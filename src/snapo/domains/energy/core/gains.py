"""The gains of the units of a feasible volume, from the rows of a table of unit values.

The value of one more unit of a volume is constant between the rows of the table and changes at
them. A line through a few units would put the last one that gains between rows, where no best
volume ends; without volatility, 0.1 to 0.7 % of the value would be lost. Where volumes are
longer than a row, the last row that gains is therefore searched for.
"""

import itertools
import math
from typing import NamedTuple, Self

import jax.numpy as jnp
from jaxtyping import Array

from .tables import NEAR, UnitValues, along, nearest_row, row_number

SEGMENTS = 4  # of a volume; the gain of a unit is linear within each


class VolumeGains(NamedTuple):
    """Of a free volume: the gains `units` [SEGMENTS] of the units at both ends of each segment, and
    the `positions` [SEGMENTS - 1] between segments, as shares of the volume."""

    units: list[tuple[Array, Array]]
    positions: list[Array]

    @classmethod
    def even(cls, units: list[Array]) -> Self:
        """Segments of the same length between these units."""
        positions = [jnp.full((), j / SEGMENTS, units[0].dtype) for j in range(1, SEGMENTS)]
        return cls(list(itertools.pairwise(units)), positions)


class FlowRows(NamedTuple):
    """The rows along a flow from levels `start`, in the table of a step.

    `pair`: of a move and the flow, whose `effects` on the levels are not all zero; `banks`: so many
    last levels are balances, between whose rows values are linear.
    """

    table: UnitValues
    pair: int
    effects: tuple[float, ...]
    start: Array
    banks: int

    def gains(self, forced: Array, free: Array, read: Array, unit: Array) -> VolumeGains:
        """Those of the units of a `free` volume beyond a `forced` one. `read`: the functions of
        the prices; `unit`: earnings of a unit today."""
        if self.table.units is not None and self.table.slopes.shape[1:-1]:
            return self._searched(self.table.units[self.pair], forced, free, read, unit)
        positions = [forced + free * j / SEGMENTS for j in range(SEGMENTS + 1)]
        rows = [self._slope(x, x is positions[-1]) for x in positions]
        return VolumeGains.even([unit + jnp.sum(row * read) for row in rows])

    def _searched(self, units: Array, forced, free, read, unit: Array) -> VolumeGains:
        """With these segments: the rows before the last one that gains; that row; the next one; the
        rows behind it. Rows change together on all levels that the flow moves and that have
        several rows."""
        dims, flat = self._table
        position = position_of(self.table, self._levels(forced))
        begin = along(position, self.effects, first=True)
        touched = [i for i, effect in enumerate(self.effects) if effect]
        room, stride, behind = jnp.full((), jnp.inf), jnp.zeros(()), jnp.zeros(())
        for i in reversed(touched):
            up, several = self.effects[i] > 0, self.table.rows.spacing[i] > 0
            left_over = dims[i] - 1 - begin[i] if up else begin[i]
            room = jnp.where(several, jnp.minimum(room, left_over), room)
            step = math.prod(dims[i + 1 :]) * (1.0 if up else -1.0)
            stride = stride + jnp.where(several, step, 0.0)
            off = position[i] - begin[i]
            behind = jnp.where(several, off if up else -off, behind)
        length = free / units[-1]
        count = jnp.maximum(jnp.minimum(jnp.ceil(behind + length - NEAR), room + 1), 1.0)
        shares = []
        for i in range(-self.banks, 0):
            left, share = _between(position[i], dims[i])
            begin = begin.at[i].set(left)
            shares.append((share, math.prod(dims[len(dims) + i + 1 :])))
        first_row = row_number(self.pair, begin, dims)

        def between(at: Array, shares: list) -> Array:
            if not shares:
                return jnp.sum(flat[at] * read)
            (share, further), *others = shares
            value = between(at, others)
            return value + share * (between(at + further, others) - value)

        def gain(row: Array) -> Array:
            at = first_row + (row * stride).astype(jnp.int32)
            return unit + between(at, shares)

        first, last = gain(jnp.zeros_like(count)), gain(count - 1)
        gaining, above, below = jnp.zeros_like(count), first, first
        for power in reversed(range(len(units))):
            row = jnp.minimum(gaining + (2**power - 1), count - 1)
            gained = gain(row)
            more = gained > 0
            gaining = jnp.where(more, row + 1, gaining)
            above, below = jnp.where(more, gained, above), jnp.where(more, below, gained)
        divisor = jnp.where(length > 0, length, 1.0)
        positions = [jnp.clip((gaining + k - behind) / divisor, 0.0, 1.0) for k in (-1, 0, 1)]
        return VolumeGains(
            [(first, above), (above, above), (below, below), (below, last)], positions
        )

    @property
    def _table(self) -> tuple[tuple[int, ...], Array]:
        """Numbers of rows of each level, and all rows of all pairs."""
        slopes = self.table.slopes
        return slopes.shape[1:-1], slopes.reshape((-1, slopes.shape[-1]))

    def _levels(self, volume: Array) -> Array:
        return self.start + volume * jnp.asarray(self.effects)

    def _slope(self, volume: Array, last: bool) -> Array:
        """The row of the unit that starts after a volume, or of the last one up to it; between the
        rows of a bank's balances, which are the last levels."""
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


def _between(position: Array, count: int) -> tuple[Array, Array]:
    """The row below a position among a number of rows, and the share of the next one."""
    left = jnp.clip(jnp.floor(position), 0.0, max(count - 2, 0))
    return left, jnp.clip(position - left, 0.0, 1.0)


def position_of(table: UnitValues, levels: Array) -> Array:
    """[levels] where levels are, in rows."""
    rows = table.rows
    return (levels - rows.low) / jnp.where(rows.spacing > 0, rows.spacing, 1.0)
