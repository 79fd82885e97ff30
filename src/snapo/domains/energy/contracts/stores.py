"""Stores: two gas stores behind one connection, whose joint flow is limited by day.

    inventory k after a day = inventory k + in_k - out_k,
    -net_withdrawal <= sum over stores of in_k - out_k <= net_injection
    earnings = sum over days of discount x sum over stores of
               (out_k (1 - fuel out) - in_k (1 + fuel in)) S - costs

A day is two steps at one price: first the flow of the first store, then that of the second one. In
between `joint flow` counts what flowed. The inventories from which all limits can be kept are those
within limits of each and of their sum: such sets stay so when the flows of a day, a set of the same
kind, are added to them (generalised polymatroids; A. Frank, E. Tardos, "Generalized polymatroids
and submodular flows", Mathematical Programming 42 (1988), 489-563).
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.case.given import CaseInput

from ...gas_storage.prices.process import use
from ..core.contract import (
    ContractLayout,
    ContractMove,
    EnergyContract,
    EnergyFlow,
    Level,
    LevelMoney,
    Promises,
    StepTerms,
    Terms,
)

JOINT_FLOW = "joint flow"  # its level
STORES = 2  # with their joint flow three volumes are counted
# Joint limits, by transfers: of both inventories together, of the second one less the joint flow,
# each from both sides; without transfers from above, and of the second one alone.
SUMS = {
    True: ((1.0, 1.0, 0.0), (-1.0, -1.0, 0.0), (0.0, 1.0, -1.0), (0.0, -1.0, 1.0)),
    False: ((-1.0, -1.0, 0.0), (0.0, -1.0, 1.0), (0.0, -1.0, 0.0)),
}


class Store(eqx.Module):
    """The terms of one store on T days.

    - `inventory`: index []; `limits`: least and most in store, index [T + 1]; `end`: owed at the
      end, index [], None where any inventory is allowed and worthless.
    - `rates`: most injected and most withdrawn, before `factors` [T, 2]; `costs`, `fuel`: of both;
      `holding`: of a unit in store, None where it is free; each index [T].
    """

    inventory: CaseInput
    limits: tuple[CaseInput, CaseInput]
    end: CaseInput | None
    rates: tuple[CaseInput, CaseInput]
    factors: np.ndarray
    costs: tuple[CaseInput, CaseInput]
    fuel: tuple[CaseInput, CaseInput]
    holding: CaseInput | None


class FeasibleSets(NamedTuple):
    """Limits of each inventory, and of their sum, from which all limits can be kept; each tight."""

    low: Array
    high: Array
    total_low: Array
    total_high: Array


class DailyFlows(NamedTuple):
    """The most that each store takes in and gives out on a day, and that both do."""

    into: Array
    out: Array
    net_in: Array
    net_out: Array


class StoresContract(EnergyContract):
    """The terms of both stores, and of their joint flow; None where it has no limit."""

    stores: tuple[Store, Store]
    net_injection: CaseInput | None
    net_withdrawal: CaseInput | None
    layout: ContractLayout = eqx.field(static=True)
    transfers: bool = eqx.field(static=True)

    @property
    def joint(self) -> bool:
        """Whether the stores depend on each other."""
        return len(self.layout.levels) > STORES

    def terms(self, inputs: dict[str, Any], paid: Array, settled: Array) -> Terms:
        daily = paid[::STORES]
        flows = self._daily_flows(inputs)
        sets = _feasible(flows, *self._limits(inputs), self.transfers)
        count, levels = len(daily), len(self.layout.levels)
        rates = jnp.stack([flows.into, flows.out], axis=2)  # [T, stores, 2]
        nothing = jnp.zeros((count, 2))
        price, money, largest = [], [], []
        for k, store in enumerate(self.stores):
            sign = jnp.array([-1.0, 1.0])
            fuel = jnp.stack([use(inputs, x) for x in store.fuel], axis=1)
            cost = jnp.stack([use(inputs, x) for x in store.costs], axis=1)
            price.append((sign - fuel) * daily[:, None])
            money.append(-cost * daily[:, None])
            largest.append([nothing] * k + [rates[:, k]] + [nothing] * (STORES - 1 - k))
        low, high = self._level_limits(flows, sets)
        none, restarts = (
            jnp.zeros((count * STORES, levels)),
            np.zeros((count * STORES, levels), bool),
        )
        restarts[STORES - 1 :: STORES, STORES:] = True
        steps = StepTerms(
            jnp.zeros((count * STORES, 2 * STORES)),
            _by_step(*(jnp.concatenate(x, axis=1) for x in largest)),
            _by_step(*[jnp.concatenate(price, axis=1)] * STORES),
            _by_step(*[jnp.concatenate(money, axis=1)] * STORES),
            low,
            high,
            jnp.where(restarts, low, none),
            none,
            jnp.asarray(restarts),
            jnp.zeros((count * STORES, len(self.layout.every_move))),
            promises=self._promises(flows, sets) if self.joint else None,
            of_levels=self._holding(inputs, daily),
        )
        return Terms(jnp.append(self._start(inputs), jnp.zeros(levels - STORES)), steps)

    def _start(self, inputs: dict[str, Any]) -> Array:
        return jnp.stack([use(inputs, store.inventory) for store in self.stores])

    def _daily_flows(self, inputs: dict[str, Any]) -> DailyFlows:
        """No more than the joint limits leave, whatever the other store does."""
        rates = [
            jnp.stack([use(inputs, x.rates[side]) * x.factors[:, side] for x in self.stores], 1)
            for side in (0, 1)
        ]
        into, out = rates
        limits = [
            jnp.sum(x, axis=1) if y is None else jnp.minimum(use(inputs, y), jnp.sum(x, axis=1))
            for x, y in zip(rates, (self.net_injection, self.net_withdrawal))
        ]
        net_in, net_out = limits
        if not self.transfers:
            into, out = jnp.minimum(into, net_in[:, None]), jnp.minimum(out, net_out[:, None])
        else:
            into, out = (
                jnp.minimum(into, net_in[:, None] + out[:, ::-1]),
                jnp.minimum(out, net_out[:, None] + into[:, ::-1]),
            )
        return DailyFlows(into, out, net_in, net_out)

    def _limits(self, inputs: dict[str, Any]) -> tuple[Array, Array]:
        """[T + 1, stores] the least and the most in store at the start of a day, and at the end."""
        low, high = (
            jnp.stack([use(inputs, x.limits[side]) for x in self.stores], axis=1) for side in (0, 1)
        )
        for k, store in enumerate(self.stores):
            if store.end is not None:
                low, high = (x.at[-1, k].set(use(inputs, store.end)) for x in (low, high))
        return low, high

    def _level_limits(self, flows: DailyFlows, sets: FeasibleSets) -> tuple[Array, Array]:
        """[steps, levels] after each step: of the first store those of the end of the day, of the
        second one those of its start until it has decided."""
        sides = []
        for limit, rate, net, sign in (
            (sets.low, flows.out, flows.net_out, -1.0),
            (sets.high, flows.into, flows.net_in, 1.0),
        ):
            early = [limit[1:, 0], limit[:-1, 1], sign * rate[:, 0]]
            late = [limit[1:, 0], limit[1:, 1], sign * net]
            count = len(self.layout.levels)
            sides.append(_by_step(*(jnp.stack(x[:count], axis=1) for x in (early, late))))
        return sides[0], sides[1]

    def _promises(self, flows: DailyFlows, sets: FeasibleSets) -> Promises:
        """Limits of sums after each step, from which the second store can keep its own limits, the
        joint ones and those of the sum; see `SUMS`."""
        rows = jnp.array(self.layout.sums)
        bottom, top, low, high = (
            sets.total_low[1:],
            sets.total_high[1:],
            sets.low[1:, 1],
            sets.high[1:, 1],
        )
        into, out = flows.into[:, 1], flows.out[:, 1]
        never = -2.0 * (
            jnp.sum(sets.high[1:] + flows.into + flows.out, axis=1) + sets.total_high[:-1]
        )
        if self.transfers:
            late_limits = [bottom, -top, never, never]
            modes = [[bottom - into, -top - out, low - flows.net_in, -high - flows.net_out]]
        else:
            late_limits, inward = [-top, never, never], [-top, never, -high]
            modes = [inward, inward, [-top - out, -high - flows.net_out, never]]
        early = jnp.stack([jnp.stack(x, axis=1) for x in modes], axis=2)
        late = jnp.stack([jnp.stack(late_limits, axis=1)] * len(modes), axis=2)
        minimum = _by_step(early, late)
        return Promises(
            jnp.broadcast_to(rows, (len(minimum), *rows.shape)), minimum, jnp.ones(len(minimum))
        )

    def _holding(self, inputs: dict[str, Any], daily: Array) -> LevelMoney | None:
        """What is in store at the start of a day is paid for on it."""
        if all(store.holding is None for store in self.stores):
            return None
        shape = len(daily), len(self.layout.levels), 2
        rates = jnp.zeros(shape)
        for k, store in enumerate(self.stores):
            if store.holding is not None:
                rates = rates.at[:, k, 1].set(use(inputs, store.holding) * daily)
        before = _by_step(rates, jnp.zeros(shape))
        return LevelMoney(before, jnp.zeros_like(before))

    def keys_at(self, levels: Mapping[str, float], mode: str, index: float | None) -> dict:
        return {"inventory": [max(levels[x.name], 0.0) for x in self.layout.levels[:STORES]]}


def _by_step(*parts: Array) -> Array:
    """[T x parts, …] of one array [T, …] for each step of a day."""
    return jnp.stack(parts, axis=1).reshape(-1, *parts[0].shape[1:])


def _feasible(flows: DailyFlows, low: Array, high: Array, transfers: bool) -> FeasibleSets:
    """[T + 1] at the start of each day, and at the end. Without transfers nothing must be injected:
    limits are then kept by withdrawing, or by no flow."""

    def tight(low: Array, high: Array, bottom: Array, top: Array) -> FeasibleSets:
        bottom, top = jnp.maximum(bottom, jnp.sum(low)), jnp.minimum(top, jnp.sum(high))
        return FeasibleSets(
            jnp.maximum(low, bottom - high[::-1]),
            jnp.minimum(high, top - low[::-1]),
            bottom,
            top,
        )

    def back(later: FeasibleSets, row):
        day, low, high = row
        into, net_in = (day.into, day.net_in) if transfers else (0.0, 0.0)
        now = tight(
            jnp.maximum(later.low - into, low),
            jnp.minimum(later.high + day.out, high),
            later.total_low - net_in,
            later.total_high + day.net_out,
        )
        return now, now

    last = tight(low[-1], high[-1], jnp.sum(low[-1]), jnp.sum(high[-1]))
    days = jax.lax.scan(back, last, (flows, low[:-1], high[:-1]), reverse=True)[1]
    return FeasibleSets(*(jnp.concatenate([x, y[None]]) for x, y in zip(days, last)))


def layout_of(names: Sequence[str], unit: str, joint: bool, transfers: bool) -> ContractLayout:
    """The inventories and, with joint limits, the joint flow of the day; a flow in and out of each
    store. Without transfers the first store decides whether the day is one of injections."""
    levels = [Level(name, unit) for name in names] + [Level(JOINT_FLOW, unit)] * joint
    flows = []
    for k, name in enumerate(names):
        for verb, sign in (("inject", 1.0), ("withdraw", -1.0)):
            effects = [sign * (i == k) for i in range(STORES)] + [sign] * joint
            flows.append(EnergyFlow(f"{verb} {name}", f"{unit}/day", tuple(effects)))
    sums = SUMS[transfers] if joint else ()
    if transfers:
        return ContractLayout(tuple(levels), tuple(flows), sums=sums)
    none = (0.0,) * len(levels)
    moves = [
        ContractMove(flow.name, before, after, (i,), none)
        for i, (flow, before, after) in enumerate(zip(flows, (0, 0, 1, 2), (1, 2, 0, 0)))
    ]
    modes = "day begins", "injects", "withdraws"
    return ContractLayout(tuple(levels), tuple(flows), modes, tuple(moves), sums=sums)
