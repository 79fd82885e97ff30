"""Tables of a fitted value on one path: the value of one more unit, and the control variate.

A value on a step is a sum of functions of the price factors (`functions`), whose coefficients lie
on evenly spaced rows of the levels. The tables are data: a sensitivity changes the contract and the
market, but not the tables.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ...gas_storage.bounds.basis import REACH, hinges, powers
from ...gas_storage.policy.value_table import Reading, functions


class LevelRows(NamedTuple):
    """The positions of the rows: `low` and `spacing` of each level [levels]."""

    low: Array
    spacing: Array


class UnitValues(NamedTuple):
    """One step: the value of one more unit of each volume after the step, and of each move.

    - `slopes` [pairs, rows …, n]: the value of one more unit along the flow from a row.
    - `moves` [moves, rows …, n]: the value of the mode and the levels in which a move ends,
      relative to the first move of its mode; None if there is no choice.
    - `units` [pairs, searches]: the volume of a row along each flow. The last profitable row is
      determined in that number of searches. It is None if no volume spans more than one row.
    - `between`: the same if levels lie between rows. The searches are then for the last profitable
      piece between two rows of any level, and `units` is None.
    - `every` [pairs, rows]: the volume of a row, if the value jumps between levels; all of these
      rows are then compared, and `units` and `between` are None.
    """

    rows: LevelRows
    slopes: Array
    moves: Array | None
    reading: Reading
    units: Array | None = None
    between: Array | None = None
    every: Array | None = None

    def read(self, factors: Array) -> Array:
        """[n] the values of the functions of the factors: polynomials and, if the table has them,
        hinges, each times the exponential; and the constant."""
        size, count = self.slopes.shape[-1], self.reading.whiten.shape[-2]
        plain = len(powers(count))
        at = hinges(count)
        if size - len(at) not in (plain, plain + 1):
            return functions(self.reading, factors, size, REACH)
        rest = functions(self.reading, factors, size - len(at), REACH)
        fast = jnp.clip((self.reading.whiten @ factors)[0], -REACH, REACH)
        level = jnp.exp(jnp.sum(self.reading.common * factors) - self.reading.shift)
        bends = level * jnp.maximum(fast - jnp.asarray(at, fast.dtype), 0.0)
        return jnp.concatenate([rest[:plain], bends, rest[plain:]])


class UnitValueTable(eqx.Module):
    """`steps`: a `UnitValues` whose leaves have a leading axis of steps."""

    steps: Any


def nearest_row(table: Array, k: int, position: Array, dims: tuple[int, ...]) -> Array:
    """The row of table k in the array `table` [tables x rows …, n] at a position [levels] of whole
    numbers.

    All tables are read from one array, because a slice of it would be copied for every step.
    """
    return table[row_number(k, position, dims)]


def row_number(k: int, position: Array, dims: tuple[int, ...]) -> Array:
    """The number of the row in table k that is nearest to a position [levels] of whole numbers."""
    place = jnp.full((), k, jnp.int32)
    for i, count in enumerate(dims):
        place = place * count + jnp.clip(position[i], 0, count - 1).astype(jnp.int32)
    return place


def along(position: Array, effects: tuple[float, ...], first: bool) -> Array:
    """The row of the table for one unit of a flow: with `first`, for the unit that starts at a
    position; otherwise for the last unit before the position."""
    ahead = jnp.asarray([1.0 if effect >= 0 else -1.0 for effect in effects])
    touched = jnp.asarray([1.0 if effect else 0.0 for effect in effects])
    directed = position * ahead
    whole = jnp.floor(directed + NEAR) if first else jnp.ceil(directed - NEAR) - touched
    return jnp.where(touched > 0, whole * ahead, jnp.round(position))


NEAR = 0.02  # of a row: a level this near to it is on it


class Values(NamedTuple):
    """The value on one date: `coefficients` [modes, rows …, n] on rows of the levels."""

    rows: LevelRows
    coefficients: Array


class Surprise(NamedTuple):
    """One step: the value at its start, and the expected value of the next step."""

    now: Values
    ahead: Values
    reading: Reading


class Surprises(eqx.Module):
    """`steps`: a `Surprise` with a leading axis of steps; `first`: the value expected today."""

    steps: Any
    first: Any


def of_step(row: Surprise, factors: Array, before: Any, after: Any) -> Array:
    """The value at the start of a step minus its expectation for the start of the next one.

    The sum of these differences over the steps, minus `first`, is the total innovation. The value
    is 0 after the last step.
    """
    row, factors, before, after = jax.lax.stop_gradient((row, factors, before, after))
    size = row.now.coefficients.shape[-1]
    observed = functions(row.reading, factors, size)
    ahead = row.reading.ahead(factors, size, observed)
    return _value(row.now, before, observed) - _value(row.ahead, after, ahead)


def at_end(first: Array) -> Array:
    """The part of this sum that is added at the end."""
    return -first


def _value(table: Values, state: Any, observed: Array) -> Array:
    """Linear between rows, flat beyond them."""
    total = jnp.zeros(())
    for mode in range(table.coefficients.shape[0]):
        row = _between(table.coefficients, mode, table.rows, state.levels)
        total = total + state.mode[mode] * row @ observed
    return total


def _between(tables: Array, k: int, rows: LevelRows, levels: Array) -> Array:
    """[n] a row between those around the levels, in table k of [tables, rows …, n]."""
    dims = tables.shape[1:-1]
    flat = tables.reshape((-1, tables.shape[-1]))
    if not dims:
        return flat[k]
    width = jnp.where(rows.spacing > 0, rows.spacing, 1.0)
    top = jnp.asarray([max(count - 1, 0) for count in dims], levels.dtype)
    position = jnp.clip((levels - rows.low) / width, 0.0, top)
    left = jnp.minimum(jnp.floor(position), jnp.maximum(top - 1, 0.0))
    share, total = position - left, jnp.zeros(flat.shape[-1])
    for corner in range(2 ** len(dims)):
        weight, place = jnp.ones(()), jnp.full((), k, jnp.int32)
        for i, count in enumerate(dims):
            up = (corner >> i) & 1
            weight = weight * (share[i] if up else 1 - share[i])
            row = jnp.minimum(left[i] + up, count - 1).astype(jnp.int32)
            place = place * count + row
        total = total + weight * flat[place]
    return total
