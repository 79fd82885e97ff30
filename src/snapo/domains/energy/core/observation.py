"""The observation of a policy: today's gains of each volume and move, and features of the state."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.problem.smooth import EXACT

from .contract import Layout
from .feasibility import volumes
from .tables import Worth, along, nearest_row


class Head(NamedTuple):
    """Numbers of the decision rule, at the start of the observation; prices over their scale.

    - `first`, `last` [pairs]: gains of the first and the last feasible unit of each volume.
    - `room` [pairs]: the free volume, over the largest volume of a step.
    - `base` [moves]: gain of each move without its free volume, over price and volume scale; those
      that are not open are far below. Empty where there is no choice.
    """

    first: Array
    last: Array
    room: Array
    base: Array

    @classmethod
    def of(cls, observation: Array, layout: Layout) -> "Head":
        """From the start of an observation."""
        pairs, moves = len(layout.pairs), len(layout.moves)
        ends = [pairs, 2 * pairs, 3 * pairs]
        parts = [observation[a:b] for a, b in zip([0, *ends], [*ends, 3 * pairs + moves])]
        return cls(*parts)


def head_size(layout: Layout) -> int:
    """How many numbers a head has."""
    return 3 * len(layout.pairs) + len(layout.moves)


CLOSED = -1e4


def head(
    layout: Layout, process: Any, constants: Any, now: Any, state: Any, spot: Array, free: Array
) -> Head:
    """The gains of one step at one state; `free` [moves]: which are open."""
    price, size = constants.price_scale, constants.volume_scale
    worth = None if now.worth is None else jax.lax.stop_gradient(now.worth)
    read = None if worth is None else worth.read(jax.lax.stop_gradient(process.gaussian(state.price)))
    first, last, rooms, base = [], [], [], []
    for i, move in enumerate(layout.every_move):
        start = state.levels + jnp.asarray(move.changes)
        forced_gain = now.terms.fixed[i] / price / size
        if move.flows:
            room = volumes(layout, i, now, state.levels, EXACT, size)
            for k, flow in enumerate(move.flows):
                effects = layout.flows[flow].effects
                unit = now.terms.price[flow] * spot + now.terms.money[flow]
                ends = unit, unit
                if worth is not None:
                    pair = layout.pairs.index((i, flow))
                    spread = room.forced[k] * jnp.asarray(effects), room.most[k] * jnp.asarray(effects)
                    slopes = _slopes(worth, pair, effects, [start + x for x in spread])
                    ends = tuple(unit + row @ read for row in slopes)
                free_volume = room.most[k] - room.forced[k]
                first.append(ends[0] / price)
                last.append(ends[1] / price)
                rooms.append(free_volume / size)
                forced_gain = forced_gain + room.forced[k] / size * ends[0] / price
        if layout.moves:
            if worth is not None and worth.moves is not None:
                position = _position(worth, state.levels)
                row = nearest_row(worth.moves[i].reshape((-1, worth.moves.shape[-1])),
                                  jnp.round(position), worth.moves.shape[1:-1])  # fmt: skip
                forced_gain = forced_gain + (row @ read) / price / size
            base.append(jnp.where(free[i] > 0, forced_gain, CLOSED))
    none = jnp.zeros(0)
    return Head(*(jnp.stack(part) if part else none for part in (first, last, rooms, base)))


def _position(worth: Worth, levels: Array) -> Array:
    rows = worth.rows
    return (levels - rows.low) / jnp.where(rows.spacing > 0, rows.spacing, 1.0)


def _slopes(worth: Worth, pair: int, effects: tuple[float, ...], levels: list[Array]) -> list[Array]:
    """Rows of the first unit from a level, and of the last unit up to another."""
    table = worth.slopes[pair]
    dims, flat = table.shape[:-1], table.reshape((-1, table.shape[-1]))
    if not dims:
        return [flat[0], flat[0]]
    places = [along(_position(worth, x), effects, k == 0) for k, x in enumerate(levels)]
    return [nearest_row(flat, place, dims) for place in places]


def observation(
    layout: Layout, process: Any, constants: Any, now: Any, state: Any, spot: Array, free: Array
) -> Float[Array, " features"]:
    """The head first, then the features of the network."""
    gains = head(layout, process, constants, now, state, spot, free)
    year, left = 2 * jnp.pi * now.time, constants.last_time - now.time
    low, high = now.intervals.low, now.intervals.high
    width = jnp.maximum(high - low, 1e-6 * constants.volume_scale)
    filling = jnp.clip((state.levels - low) / width, -1.0, 2.0)
    features = [
        jnp.stack([jnp.sin(year), jnp.cos(year), jnp.tanh(left), jnp.tanh(20 * left)]),
        2 * filling - 1,
        jnp.tanh(5 * gains.first),
        jnp.tanh(5 * gains.last),
        process.observe(constants.price, now.price, state.price),
        now.ahead,
    ]
    if len(layout.modes) > 1:
        features.append(state.mode)
    return jnp.concatenate([*gains, *features])
