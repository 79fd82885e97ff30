"""The observation of a policy: today's gains of each volume and move, and features of the state."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.problem.smooth import EXACT

from .contract import ContractLayout, StepPrices
from .feasibility import volumes_by_move
from .tables import UnitValues, along, nearest_row

POINTS = 5  # units of a volume whose gain is looked at, from the first to the last feasible one


class Head(NamedTuple):
    """Numbers of the decision rule, at the start of the observation; prices over their scale.

    - `units` [pairs, POINTS]: gains of units of each feasible volume, evenly spaced in it.
    - `room` [pairs]: the free volume, over the largest volume of a step.
    - `base` [choices]: gain of each move without its free volume, over price and volume scale;
      those that are not open are far below. Empty where there is no choice.
    """

    units: Array
    room: Array
    base: Array

    @classmethod
    def of(cls, observation: Array, layout: ContractLayout) -> "Head":
        """From the start of an observation."""
        pairs, size = len(layout.pairs), head_size(layout)
        units = observation[: pairs * POINTS].reshape((pairs, POINTS))
        end = pairs * (POINTS + 1)
        return cls(units, observation[pairs * POINTS : end], observation[end:size])


def head_size(layout: ContractLayout) -> int:
    """How many numbers a head has."""
    return (POINTS + 1) * len(layout.pairs) + len(layout.choices)


CLOSED = -1e4


def head(
    layout: ContractLayout,
    process: Any,
    constants: Any,
    now: Any,
    state: Any,
    prices: StepPrices,
    free: Array,
) -> Head:
    """The gains of one step at one state; `free` [moves]: which are open."""
    price, size = constants.price_scale, constants.volume_scale
    unit_values = None if now.unit_values is None else jax.lax.stop_gradient(now.unit_values)
    read = jnp.zeros(())
    if unit_values is not None:
        read = unit_values.read(jax.lax.stop_gradient(process.gaussian(state.price)))
    units, rooms, base = [], [], []
    pairs, choices, first = (
        layout.pairs,
        layout.choices,
        [-1, *(move.before for move in layout.every_move)],
    )
    spaces = volumes_by_move(layout, now, state.levels, EXACT, size)
    for i, (move, room) in enumerate(zip(layout.every_move, spaces)):
        start = state.levels + jnp.asarray(move.changes)
        forced_gain = prices.move(now.terms, i) / price / size
        if room is not None:
            for k, flow in enumerate(move.flows):
                effects = jnp.asarray(layout.flows[flow].effects)
                unit = prices.unit(now.terms, flow)
                gains, free_volume = [unit] * POINTS, room.most[k] - room.forced[k]
                if unit_values is not None and any(layout.flows[flow].effects):
                    pair = pairs.index((i, flow))
                    for j in range(POINTS):
                        volume = room.forced[k] + free_volume * j / (POINTS - 1)
                        last, place = j == POINTS - 1, start + volume * effects
                        effects_of = layout.flows[flow].effects
                        row = _slope(unit_values, pair, effects_of, place, last, layout.banked)
                        gains[j] = unit + jnp.sum(row * read)
                if (i, flow) in pairs:
                    units.append(jnp.stack(gains) / price)
                    rooms.append(free_volume / size)
                forced_gain = forced_gain + room.forced[k] / size * gains[0] / price
        if i in choices:
            others = move.before in first[: i + 1]  # of the first of a mode, these are zero
            if unit_values is not None and unit_values.moves is not None and others:
                table, position = unit_values.moves, _position(unit_values, state.levels)
                flat = table.reshape((-1, table.shape[-1]))
                row = nearest_row(flat, i, jnp.round(position), table.shape[1:-1])
                forced_gain = forced_gain + jnp.sum(row * read) / price / size
            base.append(jnp.where(free[i] > 0, forced_gain, CLOSED))
    return Head(jnp.stack(units), jnp.stack(rooms), jnp.stack(base) if base else jnp.zeros(0))


def _position(unit_values: UnitValues, levels: Array) -> Array:
    rows = unit_values.rows
    return (levels - rows.low) / jnp.where(rows.spacing > 0, rows.spacing, 1.0)


def _slope(
    unit_values: UnitValues,
    pair: int,
    effects: tuple[float, ...],
    levels: Array,
    last: bool,
    banked: bool,
) -> Array:
    """The row of the unit that starts at a level, or of the last one up to it; between the rows of
    a bank's balance, which is the last level."""
    table = unit_values.slopes
    dims, flat = table.shape[1:-1], table.reshape((-1, table.shape[-1]))
    if not dims:
        return flat[pair]
    position = _position(unit_values, levels)
    row = along(position, effects, not last)
    if not banked:
        return nearest_row(flat, pair, row, dims)
    left = jnp.clip(jnp.floor(position[-1]), 0.0, max(dims[-1] - 2, 0))
    share = jnp.clip(position[-1] - left, 0.0, 1.0)
    sides = [nearest_row(flat, pair, row.at[-1].set(left + k), dims) for k in (0, 1)]
    return sides[0] + share * (sides[1] - sides[0])


def observation(
    layout: ContractLayout,
    process: Any,
    constants: Any,
    now: Any,
    state: Any,
    prices: StepPrices,
    free: Array,
) -> Float[Array, " features"]:
    """The head first, then the features of the network."""
    gains = head(layout, process, constants, now, state, prices, free)
    year, left = 2 * jnp.pi * now.time, constants.last_time - now.time
    low, high = now.intervals.low, now.intervals.high
    width = jnp.maximum(high - low, 1e-6 * constants.volume_scale)
    filling = jnp.clip((state.levels - low) / width, -1.0, 2.0)
    features = [
        jnp.stack([jnp.sin(year), jnp.cos(year), jnp.tanh(left), jnp.tanh(20 * left)]),
        2 * filling - 1,
        jnp.tanh(5 * gains.units[:, 0]),
        jnp.tanh(5 * gains.units[:, -1]),
        process.observe(constants.price, now.price, state.price),
        now.ahead,
    ]
    if len(layout.modes) > 1:
        features.append(state.mode)
    return jnp.concatenate([*map(jnp.ravel, gains), *features])
