"""The observation of a policy: today's gains of each volume and move, and features of the state."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.smooth import EXACT

from .contract import ContractLayout, StepPrices
from .feasibility import of_fixed_moves, volumes_by_move
from .gains import SEGMENTS, FlowRows, VolumeGains, position_of
from .tables import nearest_row

OF_PAIR = 3 * SEGMENTS  # numbers: gains at both ends, positions between segments, the free volume


class Head(NamedTuple):
    """The numbers of the decision rule, at the start of the observation; prices are divided by
    their scale.

    - `units` [pairs, SEGMENTS, 2]: the gains of the units of each feasible volume, see
      `VolumeGains`.
    - `positions` [pairs, SEGMENTS - 1]: the limits between segments, as shares of the free volume.
    - `room` [pairs]: the free volume, divided by the largest volume of a step.
    - `base` [choices]: the gain of each move without its free volume, divided by the scales of
      price and volume; a large negative number for moves that are not allowed. Empty if there is no
      choice.
    """

    units: Array
    positions: Array
    room: Array
    base: Array

    @classmethod
    def of(cls, observation: Array, layout: ContractLayout) -> "Head":
        """The head, read from the start of an observation."""
        pairs, size = len(layout.pairs), head_size(layout)
        sizes = np.cumsum([pairs * 2 * SEGMENTS, pairs * (SEGMENTS - 1), pairs])
        units, positions, room = jnp.split(observation[: sizes[-1]], sizes[:-1])
        units = units.reshape((pairs, SEGMENTS, 2))
        positions = positions.reshape((pairs, SEGMENTS - 1))
        return cls(units, positions, room, observation[sizes[-1] : size])


def head_size(layout: ContractLayout) -> int:
    """The number of entries of a head."""
    return OF_PAIR * len(layout.pairs) + len(layout.choices)


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
    """The gains of one step in one state; `free` [moves]: the moves that are allowed."""
    # Products with inverses that all paths share: divisions take a third of a step's time.
    size, per_price = constants.volume_scale, 1 / constants.price_scale
    per_size, per_money = 1 / size, 1 / (constants.price_scale * size)
    unit_values = None if now.unit_values is None else jax.lax.stop_gradient(now.unit_values)
    read = jnp.zeros(())
    if unit_values is not None:
        read = unit_values.read(jax.lax.stop_gradient(process.gaussian(state.price)))
    if layout.fixed_volumes:
        return _of_fixed_moves(layout, constants, now, state, prices, free, read)
    units, positions, rooms, base = [], [], [], []
    pairs, choices = layout.pairs, layout.choices
    first = [-1, *(move.before for move in layout.every_move)]
    spaces = volumes_by_move(layout, now, state.levels, EXACT, size)
    for i, (move, room) in enumerate(zip(layout.every_move, spaces)):
        start = state.levels + jnp.asarray(move.changes)
        forced_gain = prices.move(now.terms, i) * per_money
        if room is not None:
            for k, flow in enumerate(move.flows):
                unit, free_volume = prices.unit(now.terms, flow), room.most[k] - room.forced[k]
                effects = layout.flows[flow].effects
                volume = VolumeGains.even([unit] * (SEGMENTS + 1))
                if unit_values is not None and any(effects):
                    pair = pairs.index((i, flow))
                    of_flow = FlowRows(
                        unit_values, pair, effects, start, layout.banks, layout.signs
                    )
                    volume = of_flow.gains(room.forced[k], free_volume, read, unit)
                if (i, flow) in pairs:
                    units.append(jnp.stack([jnp.stack(x) for x in volume.units]) * per_price)
                    positions.append(jnp.stack(volume.positions))
                    rooms.append(free_volume * per_size)
                forced_gain = forced_gain + room.forced[k] * volume.units[0][0] * per_money
        if i in choices:
            others = move.before in first[: i + 1]  # of the first of a mode, these are zero
            if unit_values is not None and unit_values.moves is not None and others:
                table, position = unit_values.moves, position_of(unit_values, state.levels)
                flat = table.reshape((-1, table.shape[-1]))
                row = nearest_row(flat, i, jnp.round(position), table.shape[1:-1])
                forced_gain = forced_gain + jnp.sum(row * read) * per_money
            base.append(jnp.where(free[i] > 0, forced_gain, CLOSED))
    base = jnp.stack(base) if base else jnp.zeros(0)
    return Head(jnp.stack(units), jnp.stack(positions), jnp.stack(rooms), base)


def _of_fixed_moves(
    layout: ContractLayout,
    constants: Any,
    now: Any,
    state: Any,
    prices: StepPrices,
    free: Array,
    read: Array,
) -> Head:
    """The gains if each move fixes its volume; `read`: the values of the functions of the
    prices."""
    gain = of_fixed_moves(layout, now.terms, prices)[0]
    if now.unit_values is not None and now.unit_values.moves is not None:
        unit_values = jax.lax.stop_gradient(now.unit_values)
        table, counts = unit_values.moves, unit_values.moves.shape[1:-1]
        if counts:
            flat = table.reshape((-1, table.shape[-1]))
            at = jnp.round(position_of(unit_values, state.levels))
            rows = [nearest_row(flat, m, at, counts) for m in range(len(layout.moves))]
            gain = gain + jnp.stack([jnp.sum(row * read) for row in rows])
        else:
            gain = gain + table @ read  # that of the first move of a mode is zero
    per_money = 1 / (constants.price_scale * constants.volume_scale)
    gain = jnp.where(free > 0, gain * per_money, CLOSED)
    count = len(layout.pairs)
    units = jnp.stack([jnp.stack([prices.unit(now.terms, flow)] * 2) for _, flow in layout.pairs])
    units = jnp.broadcast_to((units / constants.price_scale)[:, None], (count, SEGMENTS, 2))
    positions = jnp.broadcast_to(jnp.arange(1.0, SEGMENTS) / SEGMENTS, (count, SEGMENTS - 1))
    return Head(units, positions, jnp.zeros(count), gain[np.array(layout.choices)])


def observation(
    layout: ContractLayout,
    process: Any,
    constants: Any,
    now: Any,
    state: Any,
    prices: StepPrices,
    free: Array,
) -> Float[Array, " features"]:
    """The observation: the head, followed by the features of the network."""
    gains = head(layout, process, constants, now, state, prices, free)
    year, left = 2 * jnp.pi * now.time, constants.last_time - now.time
    low, high = now.intervals.low, now.intervals.high
    width = jnp.maximum(high - low, 1e-6 * constants.volume_scale)
    filling = jnp.clip((state.levels - low) / width, -1.0, 2.0)
    features = [
        jnp.stack([jnp.sin(year), jnp.cos(year), jnp.tanh(left), jnp.tanh(20 * left)]),
        2 * filling - 1,
        jnp.tanh(5 * gains.units[:, 0, 0]),
        jnp.tanh(5 * gains.units[:, -1, -1]),
        process.observe(constants.price, now.price, state.price),
        now.ahead,
    ]
    if len(layout.modes) > 1:
        features.append(state.mode)
    return jnp.concatenate([*map(jnp.ravel, gains), *features])
