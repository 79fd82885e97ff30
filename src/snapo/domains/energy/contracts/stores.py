"""Stores: two gas stores behind one connection, with a daily limit on their joint flow.

    inventory k after a day = inventory k + in_k - out_k,
    -net_withdrawal <= sum over stores of in_k - out_k <= net_injection
    earnings = sum over days of discount x sum over stores of
               (out_k (1 - fuel out) - in_k (1 + fuel in)) S - costs

A day has two steps with the same price: one for the flow of the first store, and one for the flow
of the second store. The level `joint flow` counts the net flow of the day so far. The set of
inventories from which all limits can be kept is described by limits on each inventory and on their
sum. Such sets keep this form when the flows of a day, a set of the same kind, are added to them
(generalised polymatroids; A. Frank, E. Tardos, "Generalized polymatroids and submodular flows",
Mathematical Programming 42 (1988), 489-563).
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.problem.record import TreeRecord, field
from snapo.problem.record.arrays import Array, NumbersOf
from snapo.problem.record.either import backwards, with_numpy, xp

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
ROUNDED = 1e-9  # of the gas in both stores: rounding does not break a limit
STORES = 2  # with their joint flow three volumes are counted
# Joint limits, by transfers: of both inventories together, of the second one minus the joint flow,
# each from both sides; without transfers from above, and of the second one alone.
SUMS = {
    True: ((1.0, 1.0, 0.0), (-1.0, -1.0, 0.0), (0.0, 1.0, -1.0), (0.0, -1.0, 1.0)),
    False: ((-1.0, -1.0, 0.0), (0.0, -1.0, 1.0), (0.0, -1.0, 0.0)),
}


class Store(TreeRecord):
    """The terms of one store on T days.

    - `inventory`: index []; `limits`: minimum and maximum in store, index [T + 1]; `end`: the
      inventory owed at the end, index []; None if any inventory is allowed, and has no value.
    - `rates`: largest injection and withdrawal, to be multiplied by `factors` [T, 2]; `costs`,
      `fuel`: costs and fuel of injection and withdrawal; `holding`: the cost of a unit in store,
      None if it is free. Each has an index [T].
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
    """The limits of each inventory and of their sum within which the contract can be met; every
    limit is attained."""

    low: Array
    high: Array
    total_low: Array
    total_high: Array


class DailyFlows(NamedTuple):
    """The largest injection and withdrawal on a day, for each store and for both together."""

    into: Array
    out: Array
    net_in: Array
    net_out: Array


class StoresContract(EnergyContract):
    """The terms of both stores, and the limits of their joint flow, None if there is none."""

    stores: tuple[Store, Store]
    net_injection: CaseInput | None
    net_withdrawal: CaseInput | None
    layout: ContractLayout = field(static=True)
    transfers: bool = field(static=True)

    @property
    def joint(self) -> bool:
        """Whether the stores depend on each other."""
        return len(self.layout.levels) > STORES

    def terms(self, at: NumbersOf, paid: Array, settled: Array) -> Terms:
        daily = paid[::STORES]
        flows = self._daily_flows(at)
        sets = _feasible(flows, *self._limits(at), self.transfers)
        count, levels = len(daily), len(self.layout.levels)
        rates = xp.stack([flows.into, flows.out], axis=2)  # [T, stores, 2]
        nothing = xp.zeros((count, 2))
        price, money, largest = [], [], []
        for k, store in enumerate(self.stores):
            sign = xp.array([-1.0, 1.0])
            fuel = xp.stack([at(x) for x in store.fuel], axis=1)
            cost = xp.stack([at(x) for x in store.costs], axis=1)
            price.append((sign - fuel) * daily[:, None])
            money.append(-cost * daily[:, None])
            largest.append([nothing] * k + [rates[:, k]] + [nothing] * (STORES - 1 - k))
        low, high = self._level_limits(flows, sets)
        none, restarts = (
            xp.zeros((count * STORES, levels)),
            np.zeros((count * STORES, levels), bool),
        )
        restarts[STORES - 1 :: STORES, STORES:] = True
        steps = StepTerms(
            xp.zeros((count * STORES, 2 * STORES)),
            _by_step(*(xp.concatenate(x, axis=1) for x in largest)),
            _by_step(*[xp.concatenate(price, axis=1)] * STORES),
            _by_step(*[xp.concatenate(money, axis=1)] * STORES),
            low,
            high,
            xp.where(restarts, low, none),
            none,
            xp.asarray(restarts),
            xp.zeros((count * STORES, len(self.layout.every_move))),
            promises=self._promises(flows, sets) if self.joint else None,
            of_levels=self._holding(at, daily),
        )
        return Terms(xp.append(self._start(at), xp.zeros(levels - STORES)), steps)

    @with_numpy
    def check_together(self, file: str, days: Sequence[Any]) -> None:
        at, unit = CaseInput.used, self.layout.levels[0].unit
        sets = _feasible(self._daily_flows(at), *self._limits(at), self.transfers)
        low, high = sets.total_low[0], sets.total_high[0]
        gas, near = float(xp.sum(self._start(at))), ROUNDED * max(1.0, float(high))
        if low - near <= gas <= high + near:
            return
        above = gas > high
        key = "net_withdrawal" if above else "net_injection"
        limit = f"at most {high:.10g}" if above else f"at least {low:.10g}"
        number: CaseInput | None = getattr(self, key)
        message = (
            f"with this limit both stores together must have {limit} {unit} on {days[0]}, but they "
            f"have {gas:.10g} {unit}"
        )
        raise CaseError(file, f"contract.{key}", number and number.written, message)

    def _start(self, at: NumbersOf) -> Array:
        return xp.stack([at(store.inventory) for store in self.stores])

    def _daily_flows(self, at: NumbersOf) -> DailyFlows:
        """The largest flows that the joint limits allow with the best flow of the other store."""
        rates = [
            xp.stack([at(x.rates[side]) * x.factors[:, side] for x in self.stores], 1)
            for side in (0, 1)
        ]
        into, out = rates
        limits = [
            xp.sum(x, axis=1) if y is None else xp.minimum(at(y), xp.sum(x, axis=1))
            for x, y in zip(rates, (self.net_injection, self.net_withdrawal))
        ]
        net_in, net_out = limits
        if not self.transfers:
            into, out = xp.minimum(into, net_in[:, None]), xp.minimum(out, net_out[:, None])
        else:
            into, out = (
                xp.minimum(into, net_in[:, None] + out[:, ::-1]),
                xp.minimum(out, net_out[:, None] + into[:, ::-1]),
            )
        return DailyFlows(into, out, net_in, net_out)

    def _limits(self, at: NumbersOf) -> tuple[Array, Array]:
        """[T + 1, stores] the smallest and the largest inventory at the start of each day, and at
        the end."""
        low, high = (xp.stack([at(x.limits[side]) for x in self.stores], axis=1) for side in (0, 1))
        for k, store in enumerate(self.stores):
            if store.end is not None:
                end = np.zeros(low.shape, bool)
                end[-1, k] = True
                low, high = (xp.where(end, at(store.end), x) for x in (low, high))
        return low, high

    def _level_limits(self, flows: DailyFlows, sets: FeasibleSets) -> tuple[Array, Array]:
        """[steps, levels] after each step: the limits of the first store are those at the end of
        the day; the limits of the second store are those at the start of the day, and after its own
        step those at the end."""
        sides = []
        for limit, rate, net, sign in (
            (sets.low, flows.out, flows.net_out, -1.0),
            (sets.high, flows.into, flows.net_in, 1.0),
        ):
            early = [limit[1:, 0], limit[:-1, 1], sign * rate[:, 0]]
            late = [limit[1:, 0], limit[1:, 1], sign * net]
            count = len(self.layout.levels)
            sides.append(_by_step(*(xp.stack(x[:count], axis=1) for x in (early, late))))
        return sides[0], sides[1]

    def _promises(self, flows: DailyFlows, sets: FeasibleSets) -> Promises:
        """Limits of sums of levels after each step, see `SUMS`. If they hold after the step of the
        first store, the second store can keep its own limits, the joint limits and those of the
        sum."""
        rows = xp.array(self.layout.sums)
        bottom, top, low, high = (
            sets.total_low[1:],
            sets.total_high[1:],
            sets.low[1:, 1],
            sets.high[1:, 1],
        )
        into, out = flows.into[:, 1], flows.out[:, 1]
        never = -2.0 * (
            xp.sum(sets.high[1:] + flows.into + flows.out, axis=1) + sets.total_high[:-1]
        )
        if self.transfers:
            late_limits = [bottom, -top, never, never]
            modes = [[bottom - into, -top - out, low - flows.net_in, -high - flows.net_out]]
        else:
            late_limits, inward = [-top, never, never], [-top, never, -high]
            modes = [inward, inward, [-top - out, -high - flows.net_out, never]]
        early = xp.stack([xp.stack(x, axis=1) for x in modes], axis=2)
        late = xp.stack([xp.stack(late_limits, axis=1)] * len(modes), axis=2)
        minimum = _by_step(early, late)
        return Promises(
            xp.broadcast_to(rows, (len(minimum), *rows.shape)), minimum, xp.ones(len(minimum))
        )

    def _holding(self, at: NumbersOf, daily: Array) -> LevelMoney | None:
        """The cost of the gas in store at the start of each day, paid on that day."""
        if all(store.holding is None for store in self.stores):
            return None
        shape = len(daily), len(self.layout.levels), 2
        nothing = xp.zeros(len(daily))
        above = [nothing if x.holding is None else at(x.holding) * daily for x in self.stores]
        above += [nothing] * (shape[1] - STORES)
        rates = xp.stack([xp.zeros(shape[:2]), xp.stack(above, axis=1)], axis=2)
        before = _by_step(rates, xp.zeros(shape))
        return LevelMoney(before, xp.zeros_like(before))

    def keys_at(self, levels: Mapping[str, float], mode: str, index: float | None) -> dict:
        return {"inventory": [max(levels[x.name], 0.0) for x in self.layout.levels[:STORES]]}


def _by_step(*parts: Array) -> Array:
    """[T x parts, …] of one array [T, …] for each step of a day."""
    return xp.stack(parts, axis=1).reshape(-1, *parts[0].shape[1:])


def _feasible(flows: DailyFlows, low: Array, high: Array, transfers: bool) -> FeasibleSets:
    """The feasible sets [T + 1] at the start of each day, and at the end. Without transfers nothing
    must be injected: limits are then kept by withdrawing, or by no flow."""

    def tight(low: Array, high: Array, bottom: Array, top: Array) -> FeasibleSets:
        bottom, top = xp.maximum(bottom, xp.sum(low)), xp.minimum(top, xp.sum(high))
        return FeasibleSets(
            xp.maximum(low, bottom - high[::-1]),
            xp.minimum(high, top - low[::-1]),
            bottom,
            top,
        )

    def back(later: FeasibleSets, row):
        day, low, high = row
        into, net_in = (day.into, day.net_in) if transfers else (0.0, 0.0)
        return tight(
            xp.maximum(later.low - into, low),
            xp.minimum(later.high + day.out, high),
            later.total_low - net_in,
            later.total_high + day.net_out,
        )

    last = tight(low[-1], high[-1], xp.sum(low[-1]), xp.sum(high[-1]))
    days = backwards(back, last, (flows, low[:-1], high[:-1]), len(flows.into))
    return FeasibleSets(*(xp.concatenate([x, y[None]]) for x, y in zip(days, last)))


def layout_of(names: Sequence[str], unit: str, joint: bool, transfers: bool) -> ContractLayout:
    """The inventories and, with joint limits, the joint flow of the day; and one flow into and one
    out of each store. Without transfers the first store decides whether the day is for injections
    or for withdrawals."""
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
