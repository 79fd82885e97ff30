"""Levels from which all obligations can be met, and the volumes that lead to such levels.

Each level has an interval at the start of every step, computed backwards from the end: the levels
from which the interval of the next step can be reached by at least one move. Levels are treated one
by one. A contract must therefore not have an obligation on one level that only another level
limits.
"""

import functools
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.record.arrays import Array, Float, jax, jnp
from snapo.problem.record.either import backwards, fixed, xp

from .contract import ContractLayout, ContractMove, StepPrices, StepTerms

FALLEN = 1e-3  # of the largest volume: rounding is not beyond a multiple
MISSED = 5.0  # charge for a unit of a promised minimum, in the largest amount that a unit moves


class Intervals(NamedTuple):
    """Intervals of the levels, each [T, levels], at the start of a step and after its moves."""

    low: Float[Array, "T levels"]
    high: Float[Array, "T levels"]
    next_low: Float[Array, "T levels"]
    next_high: Float[Array, "T levels"]


def intervals(layout: ContractLayout, steps: StepTerms) -> Intervals:
    """The intervals of all steps. In an empty interval, and in all intervals before it, `low` is
    above `high`."""
    least, most = changes(layout, steps)

    def back(successor, row):
        low, high, restarts, least, most = row
        next_low, next_high = successor[:2]
        possible = (next_low <= 0) & (next_high >= 0)
        after = (
            xp.where(restarts, xp.where(possible, low, xp.inf), xp.maximum(low, next_low)),
            xp.where(restarts, xp.where(possible, high, -xp.inf), xp.minimum(high, next_high)),
        )
        return after[0] - most, after[1] - least, *after

    free = xp.full(len(layout.levels), xp.inf)
    rows = steps.low, steps.high, steps.restarts, least, most
    return Intervals(*backwards(back, (-free, free, -free, free), rows, len(steps.low)))


def changes(layout: ContractLayout, steps: StepTerms) -> tuple[Array, Array]:
    """[T, levels] the smallest and the largest change of each level in a step."""
    least, most = [], []
    for move in layout.every_move:
        low = high = xp.broadcast_to(xp.asarray(move.changes), steps.low.shape)
        for flow in move.flows:
            effect = xp.asarray(layout.flows[flow].effects)
            volumes = steps.least[:, flow, None] * effect, steps.most[:, flow, None] * effect
            low, high = low + xp.minimum(*volumes), high + xp.maximum(*volumes)
        least.append(low)
        most.append(high)
    return xp.min(xp.stack(least), axis=0), xp.max(xp.stack(most), axis=0)


def charged(steps: StepTerms, forward: Array) -> StepTerms:
    """The terms; if they have promises, with a charge for a missed unit that is so large that no
    method misses one by choice."""
    if steps.promises is None:
        return steps
    price = xp.abs(steps.price) + (0.0 if steps.index is None else xp.abs(steps.index))
    unit = xp.max(price) * xp.max(xp.abs(forward)) + xp.max(xp.abs(steps.money))
    charge = fixed(MISSED * unit)
    if steps.promises.missed is not None:
        missed = steps.promises.missed * charge
        return steps._replace(promises=steps.promises._replace(missed=missed))
    return steps._replace(short=xp.full_like(steps.short, 1.0) * charge)


class FeasibleVolumes(NamedTuple):
    """Volumes of the flows of a move: the forced and the maximum volume of each.

    `up_to`: the volume between them at which a falling limit falls; None without such a limit.
    """

    forced: Array
    most: Array
    up_to: Array | None = None

    def at(self, k: int, share: Array) -> Array:
        """The volume of flow k: the forced volume plus this share of the rest of the feasible
        volume. A share on one side of the volume at which a limit falls remains on that side, so
        that a decision held fixed does not pass the fall; the derivatives are those on that side.
        """
        forced, free = self.forced[k], self.most[k] - self.forced[k]
        if self.up_to is None:
            return forced + share * free
        first = self.up_to[k] - forced
        at = jax.lax.stop_gradient(first / jnp.where(free > 0, free, 1.0))
        below = share * first / jnp.where(at > 0, at, 1.0)
        above = first + (share - at) * (free - first) / jnp.where(at < 1, 1 - at, 1.0)
        return forced + jnp.where(share <= at, below, above)


def volumes(
    layout: ContractLayout, move: int, now: Any, levels: Array, smooth, scale
) -> FeasibleVolumes:
    """The volumes of one move from these levels [levels], in the order of its flows.

    A part of a flow is forced if the levels would otherwise leave the next interval, and a flow is
    limited so that the levels remain in it. `now`: a row of a schedule with `terms` and
    `intervals`.
    """
    this = layout.every_move[move]
    start = [levels[i] + change for i, change in enumerate(this.changes)]
    forced, most = [], []
    room_of_sums, falling, up_to = _room_of_sums(layout, this, now, start), now.terms.falling, []
    for flow in this.flows:
        least, room = now.terms.least[flow], now.terms.most[flow]
        if layout.sums:
            need, leave = _range(layout, flow, now, start, room_of_sums)
            least = smooth.maximum(least, need, scale)
            room = smooth.minimum(room, leave, scale)
        for i, effect in enumerate(() if layout.sums else layout.flows[flow].effects):
            if not effect:
                continue
            low, high = now.intervals.next_low[i] - start[i], now.intervals.next_high[i] - start[i]
            need, leave = (low, high) if effect > 0 else (high, low)
            least = smooth.maximum(least, need / effect, scale)
            room = smooth.minimum(room, leave / effect, scale)
        if falling is not None:
            near, effects = FALLEN * scale, layout.flows[flow].effects
            falls = falling.falls(start[-1], near, jnp)
            if effects[0] > 0:
                ceiling = now.terms.high[0] - falls * falling.by
                room = smooth.minimum(room, (ceiling - start[0]) / effects[0], scale)
            next_fall = falling.every * (falls + 1) - start[-1]
            up_to.append(next_fall / effects[-1] if effects[-1] > 0 else jnp.inf)
        if now.terms.promises is not None and not layout.sums:
            promises, effects = now.terms.promises, jnp.asarray(layout.flows[flow].effects)
            need = promises.minimum[:, this.after] - promises.weights @ jnp.stack(start)
            effect = promises.weights @ effects
            for k in range(len(need)):
                more = need[k] / jnp.where(effect[k] > 0, effect[k], 1.0)
                least = smooth.maximum(least, jnp.where(effect[k] > 0, more, 0.0), scale)
        # One feasible volume where rounding leaves the least above the most.
        least, room = jax.lax.optimization_barrier((least, room))
        room = jnp.maximum(room, 0.0)
        least = jnp.clip(least, 0.0, jnp.maximum(room, now.terms.least[flow]))
        forced.append(least)
        most.append(jnp.maximum(room, least))
    volumes = FeasibleVolumes(jnp.stack(forced), jnp.stack(most))
    if falling is None:
        return volumes
    return volumes._replace(up_to=jnp.clip(jnp.stack(up_to), *volumes[:2]))


def _room_of_sums(layout: ContractLayout, move: ContractMove, now: Any, start: list) -> list[Array]:
    """How far the sum of each joint limit is above the minimum that applies after this move, at
    these levels."""
    if not layout.sums:
        return []
    minimum, room = now.terms.promises.minimum[:, move.after], []
    for k, weights in enumerate(layout.sums):
        total = [start[i] if w == 1 else w * start[i] for i, w in enumerate(weights) if w]
        room.append(sum(total[1:], total[0]) - minimum[k])
    return room


def _range(
    layout: ContractLayout, flow: int, now: Any, start: list, room_of_sums: list[Array]
) -> tuple[Array, Array]:
    """The smallest and the largest volume of a flow that the limits of levels and the joint limits
    allow."""
    need, leave, effects = [], [], layout.flows[flow].effects
    for i, effect in enumerate(effects):
        if effect:
            low, high = now.intervals.next_low[i] - start[i], now.intervals.next_high[i] - start[i]
            need.append((low if effect > 0 else high) / effect)
            leave.append((high if effect > 0 else low) / effect)
    for weights, room in zip(layout.sums, room_of_sums):
        effect = float(np.dot(weights, effects))
        if effect:
            (need if effect > 0 else leave).append(-room / effect)
    return functools.reduce(jnp.maximum, need), functools.reduce(jnp.minimum, leave)


def volumes_by_move(
    layout: ContractLayout, now: Any, levels: Array, smooth, scale
) -> list[FeasibleVolumes | None]:
    """[moves] `volumes` of each move; None for a move without flows. They are the same for all
    moves whose flows have no effect on the levels."""
    shared: dict[tuple[int, ...], FeasibleVolumes] = {}
    result: list[FeasibleVolumes | None] = []
    for i, move in enumerate(layout.every_move):
        touched = any(any(layout.flows[flow].effects) for flow in move.flows)
        key = (i,) if touched or now.terms.promises is not None else (-1, *move.flows)
        if move.flows and key not in shared:
            shared[key] = volumes(layout, i, now, levels, smooth, scale)
        result.append(shared.get(key))
    return result


def of_fixed_moves(
    layout: ContractLayout, terms: StepTerms, prices: StepPrices
) -> tuple[Array, list[Array]]:
    """[moves] the earnings of the moves, each of which fixes its volume; and for each flow the
    volumes [moves]."""
    earned = prices.move(terms, slice(None))
    volumes = [terms.fixed_volume * of_move for of_move in layout.flow_of]
    for flow, volume in enumerate(volumes):
        earned = earned + volume * prices.unit(terms, flow)
    return earned, volumes


def first_fault(layout: ContractLayout, schedule: Any) -> tuple[int, int] | None:
    """(step, level) at which no decision meets the limits; None if all limits can be met.

    The step is -1 if only the start is the reason.
    """
    result, terms = schedule.steps.intervals, schedule.steps.terms
    tolerance = 1e-9 * max(1.0, float(np.max(np.abs(terms.most), initial=0.0)))
    start = np.asarray(schedule.constants.start)
    for i in range(len(layout.levels)):
        empty = np.flatnonzero(result.next_low[:, i] > result.next_high[:, i] + tolerance)
        if len(empty):
            return int(empty[-1]), i
        if not result.low[0, i] - tolerance <= start[i] <= result.high[0, i] + tolerance:
            return -1, i
    return None


def check_limits(case: Any, schedule: Any) -> None:
    """Refuses a contract whose limits cannot be met; `schedule`: with NumPy leaves.

    **Raises:** `CaseError` with the first step and level at which no decisions can meet the
    limits.
    """
    layout = case.contract.layout
    fault = first_fault(layout, schedule)
    if fault is not None:
        step, level = fault
        day = case.days[max(step, 0)]
        name = layout.levels[level].name
        raise CaseError(str(case.file), f"contract: {name}", None,
                        f"no decisions can meet its limits from {day} on")  # fmt: skip
    case.contract.check_together(str(case.file), case.days)
