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

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from pydantic import Field

from snapo.case.error import CaseError
from snapo.case.given import CaseInput, NoPosition
from snapo.case.load import load
from snapo.case.quantity import NOT_NEGATIVE, Quantity
from snapo.case.table import CaseTable, NotNegative, TableContext, parse

from ...gas_storage.prices.process import use
from ...gas_storage.read.limits import read_limits
from ...gas_storage.read.tables import ContractTable, FileName
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

STORES = 2  # with their joint flow three volumes are counted
JOINT = Quantity("{volume_unit}/day", NOT_NEGATIVE, "contract", move=1.0, by="date")
KEEPS = "in, out and nothing on each day"
# Keys of a gas store that this contract does not have, and the only value of each.
ONLY: dict[str, Any] = {
    "ratchets": None, "ratchet_interpolation": "linear", "fixed_costs": None,
    "injection_cost_settlement": "flow", "withdrawal_cost_settlement": "flow",
    "first_decision": "valuation-date", "nomination": None,
}  # fmt: skip
ZERO = "min_injection", "min_withdrawal", "inventory_loss"


# Joint limits, by transfers: of both inventories together, of the second one less the joint flow,
# each from both sides; without transfers from above, and of the second one alone.
SUMS = {
    True: ((1.0, 1.0, 0.0), (-1.0, -1.0, 0.0), (0.0, 1.0, -1.0), (0.0, -1.0, 1.0)),
    False: ((-1.0, -1.0, 0.0), (0.0, -1.0, 1.0), (0.0, -1.0, 0.0)),
}


class StoresTable(CaseTable):
    """`[contract]` of kind "stores"."""

    stores: list[FileName] = Field(
        description='two files like ["fast.toml", "slow.toml"], each the `[contract]` of a gas store'
    )
    net_injection: CaseInput | None = JOINT("largest joint flow into the stores", None)
    net_withdrawal: CaseInput | None = JOINT("largest joint flow out of the stores", None)
    transfers: bool = True
    inventory: list[NotNegative] | None = Field(
        None,
        description="gas in store today in each of the stores, a list like [2000.0, 8000.0]; "
        "without it that of their files",
    )


class NamedTable(NamedTuple):
    """The table of a store: its name, the table, its place in messages."""

    name: str
    table: ContractTable
    where: TableContext


@dataclass(frozen=True)
class OpenedStores:
    """The contract with the tables of its stores, which have the same dates and units."""

    stores: tuple[NamedTable, ...]
    net_injection: CaseInput | None
    net_withdrawal: CaseInput | None
    transfers: bool
    start: datetime.date
    end: datetime.date
    volume_unit: str
    currency: str
    inventory: tuple[float | None, ...] = (None,) * STORES
    nomination: None = None


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
    least: Array
    most: Array


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
        most = jnp.stack([flows.into, flows.out], axis=2)  # [T, stores, 2]
        nothing = jnp.zeros((count, 2))
        price, money, largest = [], [], []
        for k, store in enumerate(self.stores):
            sign = jnp.array([-1.0, 1.0])
            fuel = jnp.stack([use(inputs, x) for x in store.fuel], axis=1)
            cost = jnp.stack([use(inputs, x) for x in store.costs], axis=1)
            price.append((sign - fuel) * daily[:, None])
            money.append(-cost * daily[:, None])
            largest.append([nothing] * k + [most[:, k]] + [nothing] * (STORES - 1 - k))
        low, high = self._level_limits(flows, sets)
        none, again = jnp.zeros((count * STORES, levels)), np.zeros((count * STORES, levels), bool)
        again[STORES - 1 :: STORES, STORES:] = True
        steps = StepTerms(
            jnp.zeros((count * STORES, 2 * STORES)),
            _by_step(*(jnp.concatenate(x, axis=1) for x in largest)),
            _by_step(*[jnp.concatenate(price, axis=1)] * STORES),
            _by_step(*[jnp.concatenate(money, axis=1)] * STORES),
            low,
            high,
            jnp.where(again, low, none),
            none,
            jnp.asarray(again),
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
        for limit, own, net, sign in (
            (sets.low, flows.out, flows.net_out, -1.0),
            (sets.high, flows.into, flows.net_in, 1.0),
        ):
            early = [limit[1:, 0], limit[:-1, 1], sign * own[:, 0]]
            late = [limit[1:, 0], limit[1:, 1], sign * net]
            count = len(self.layout.levels)
            sides.append(_by_step(*(jnp.stack(x[:count], axis=1) for x in (early, late))))
        return sides[0], sides[1]

    def _promises(self, flows: DailyFlows, sets: FeasibleSets) -> Promises:
        """Limits of sums after each step, from which the second store can keep its own limits, the
        joint ones and those of the sum; see `SUMS`."""
        rows = jnp.array(self.layout.sums)
        least, most, low, high = sets.least[1:], sets.most[1:], sets.low[1:, 1], sets.high[1:, 1]
        into, out = flows.into[:, 1], flows.out[:, 1]
        never = -2.0 * (jnp.sum(sets.high[1:] + flows.into + flows.out, axis=1) + sets.most[:-1])
        if self.transfers:
            ends = [least, -most, never, never]
            modes = [[least - into, -most - out, low - flows.net_in, -high - flows.net_out]]
        else:
            ends, inward = [-most, never, never], [-most, never, -high]
            modes = [inward, inward, [-most - out, -high - flows.net_out, never]]
        early = jnp.stack([jnp.stack(x, axis=1) for x in modes], axis=2)
        late = jnp.stack([jnp.stack(ends, axis=1)] * len(modes), axis=2)
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

    def tight(low: Array, high: Array, least: Array, most: Array) -> FeasibleSets:
        least, most = jnp.maximum(least, jnp.sum(low)), jnp.minimum(most, jnp.sum(high))
        return FeasibleSets(
            jnp.maximum(low, least - high[::-1]),
            jnp.minimum(high, most - low[::-1]),
            least,
            most,
        )

    def back(later: FeasibleSets, row):
        day, low, high = row
        into, net_in = (day.into, day.net_in) if transfers else (0.0, 0.0)
        now = tight(
            jnp.maximum(later.low - into, low),
            jnp.minimum(later.high + day.out, high),
            later.least - net_in,
            later.most + day.net_out,
        )
        return now, now

    last = tight(low[-1], high[-1], jnp.sum(low[-1]), jnp.sum(high[-1]))
    days = jax.lax.scan(back, last, (flows, low[:-1], high[:-1]), reverse=True)[1]
    return FeasibleSets(*(jnp.concatenate([x, y[None]]) for x, y in zip(days, last)))


def layout_of(names: Sequence[str], unit: str, joint: bool, transfers: bool) -> ContractLayout:
    """The inventories and, with joint limits, the joint flow of the day; a flow in and out of each
    store. Without transfers the first store decides whether the day is one of injections."""
    levels = [Level(name, unit) for name in names] + [Level("joint flow", unit)] * joint
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


def open_stores(where: TableContext, table: StoresTable, market: Any) -> OpenedStores:
    """The tables of the stores, from their files; `market`: the table of the case."""
    if len(table.stores) != STORES:
        message = f"allowed are {STORES} stores: their inventories and the joint flow are counted"
        raise where.error("stores", ", ".join(table.stores), message)
    opened = [_open(where, name, market) for name in table.stores]
    first, second = (x.table for x in opened)
    if opened[0].name == opened[1].name:
        raise where.error("stores", ", ".join(table.stores), "allowed are two different files")
    for key in ("start", "end", "volume_unit", "currency"):
        value = getattr(first, key)
        if getattr(second, key) != value:
            message = f"allowed is that of {table.stores[0]}, {value}"
            raise opened[1].where.error(key, getattr(second, key), message)
    today = table.inventory or [None] * STORES
    if len(today) != STORES:
        message = f"allowed is a list of {STORES} numbers, one for each store"
        raise where.error("inventory", str(today), message)
    unit = f"{first.volume_unit}/day"
    limits = [x and replace(x, unit=unit) for x in (table.net_injection, table.net_withdrawal)]
    return OpenedStores(
        tuple(opened), *limits, table.transfers, first.start, first.end, first.volume_unit,
        first.currency, tuple(today),
    )  # fmt: skip


def _open(where: TableContext, name: str, market: Any) -> NamedTable:
    path = where.file.parent / name
    if path.suffix.lower() != ".toml" or path.parent.resolve() != where.file.parent.resolve():
        message = "allowed is the name of a TOML file next to the case"
        raise where.error("stores", name, message)
    if not path.is_file():
        raise where.error("stores", name, "there is no such file next to the case")
    data = load(path)[1]
    if list(data) != ["contract"]:
        message = "allowed is the table [contract] alone; market and prices are those of the case"
        raise CaseError(str(path), ", ".join(data), None, message)
    inner = TableContext(path, "contract", where.notes)
    table = parse(ContractTable, data["contract"], str(path), "contract", where.notes)
    for key, only in ONLY.items():
        if (value := getattr(table, key)) != only:
            allowed = "no such key in a store of several" if only is None else f'"{only}"'
            raise inner.error(key, str(value), f"allowed is {allowed}")
    for key in ZERO:
        if np.any(getattr(table, key).values):
            raise inner.error(key, getattr(table, key).written, "allowed is 0 in a store of several")
    if table.end_value not in (None, 0.0):
        raise inner.error("end_value", table.end_value, "allowed is 0 in a store of several")
    costs = table.injection_cost, table.withdrawal_cost, table.inventory_cost
    if market.settlement != "flow" and any(np.any(x.values) for x in costs):
        message = 'with costs, which are paid on the day of the flow, allowed is "flow"'
        raise CaseError(str(where.file), "market.settlement", str(market.settlement), message)
    return NamedTable(path.stem, table, inner)


def read_stores(
    where: TableContext, opened: OpenedStores, steps: Sequence[datetime.date]
) -> StoresContract:
    """The contract on its decision days, each of which is on two `steps`."""
    days = steps[::STORES]
    stores = tuple(
        _read_store(x, days, opened.transfers, today, (*where.keys, "inventory", k))
        for k, (x, today) in enumerate(zip(opened.stores, opened.inventory))
    )
    limits = [x and x.on(days, where.notes) for x in (opened.net_injection, opened.net_withdrawal)]
    joint = any(limits) or not opened.transfers
    names = [x.name for x in opened.stores]
    return StoresContract(  # pyright: ignore[reportCallIssue]
        stores,  # pyright: ignore[reportArgumentType]
        *limits,
        layout_of(names, opened.volume_unit, joint, opened.transfers),
        opened.transfers,
    )


def _read_store(
    opened: NamedTable,
    days: Sequence[datetime.date],
    transfers: bool,
    today: float | None,
    key: tuple[str | int, ...],
) -> Store:
    """The store on these days; `today`: what is in store, which the case gives under `key`."""
    name, table, where = opened
    limits = read_limits(where, table, days)
    low, high = limits.min_inventory, limits.max_inventory
    start = float(table.inventory.values[0]) if today is None else today
    if not low.used()[0] <= start <= high.used()[0]:
        message = f"allowed is {low.used()[0]:g} to {high.used()[0]:g} on {days[0]}"
        raise where.error("inventory", start, message)
    end = None
    if table.end_inventory != "free":
        quantity = ContractTable.model_fields["inventory"].metadata[-1]
        end = quantity.input("end_inventory", [table.end_inventory])
        end = replace(end, unit=table.volume_unit, meaning="gas owed at the end")
    if not transfers:
        if end is not None and table.end_inventory:
            message = 'without transfers allowed is 0 or "free"'
            raise where.error("end_inventory", table.end_inventory, message)
        if np.any(np.diff(low.used()) > 0):
            message = "without transfers it may not rise"
            raise where.error("min_inventory", table.min_inventory.written, message)
    reason = NoPosition(f"it is in {where.file.name}")

    def named(numbers: CaseInput) -> CaseInput:
        positions = tuple(x if x is None else reason for x in numbers.positions)
        return replace(numbers, name=f"{name}_{numbers.name}", positions=positions)

    def daily(numbers: CaseInput) -> CaseInput:
        return named(numbers.on(days, where.notes))

    holding = table.inventory_cost
    rates = (replace(x, index=x.index[:, 0]) for x in (limits.ratchets.injection,
                                                       limits.ratchets.withdrawal))  # fmt: skip
    stock = named(table.inventory)
    if today is not None:
        stock = replace(stock, values=np.array([today]), positions=(key,))
    return Store(
        stock,
        (named(low), named(high)),
        None if end is None else named(end),
        tuple(map(named, rates)),  # pyright: ignore[reportArgumentType]
        np.stack([limits.injection_factor, limits.withdrawal_factor], axis=1),
        (daily(table.injection_cost), daily(table.withdrawal_cost)),
        (daily(table.injection_fuel), daily(table.withdrawal_fuel)),
        daily(holding) if np.any(holding.values) else None,
    )
