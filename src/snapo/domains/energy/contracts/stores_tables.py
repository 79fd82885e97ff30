"""Reads a contract of two stores, and the files of the two stores."""

import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput, NoPosition
from snapo.case.load import load
from snapo.case.quantity import NOT_NEGATIVE, Quantity
from snapo.case.table import CaseTable, Nonempty, TableContext, doc, parse

from ...gas_storage.read.limits import read_limits, small_move
from ...gas_storage.read.tables import ContractTable
from ..methods.measure import common_measure
from .stores import JOINT_FLOW, STORES, Store, StoresContract, layout_of

JOINT = Quantity("{volume_unit}/day", NOT_NEGATIVE, "contract", move=1.0, by="date")
# Keys of a gas store that this contract does not have, and the only value of each.
ONLY: dict[str, Any] = {
    "ratchets": None, "ratchet_interpolation": "linear", "fixed_costs": None,
    "injection_cost_settlement": "flow", "withdrawal_cost_settlement": "flow",
    "first_decision": "valuation-date", "nomination": None,
}  # fmt: skip
NOTHING = "it must be 0 if there are several stores"
ZERO = "min_injection", "min_withdrawal", "inventory_loss"


class StoresTable(CaseTable):
    """`[contract]` of kind "stores"."""

    stores: list[Nonempty] = doc(
        "stores behind one connection",
        allowed='two files like ["fast.toml", "slow.toml"], each with the [contract] of a store',
    )
    net_injection: CaseInput | None = JOINT("largest joint flow into the stores", None)
    net_withdrawal: CaseInput | None = JOINT("largest joint flow out of the stores", None)
    transfers: bool = doc("whether one store may inject gas that the other withdraws", True)
    inventory: list[float] | None = doc(
        "gas in store today, a number for each store, in volume_unit", None,
        "a list like [2000.0, 8000.0]; by default as in their files",
    )  # fmt: skip


class NamedTable(NamedTuple):
    """The table of a store: its name, the table, and its name in messages."""

    name: str
    table: ContractTable
    where: TableContext


@dataclass(frozen=True)
class OpenedStores:
    """The numbers of the contract and the tables of its stores, which have the same dates and
    units."""

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


def open_stores(where: TableContext, table: StoresTable, market: Any) -> OpenedStores:
    """The tables of the stores, from their files; `market`: the table of the case."""
    if len(table.stores) != STORES:
        message = (
            f"there must be {STORES} stores: the state that the methods use has their two "
            "inventories "
            "and the joint flow"
        )
        raise where.error("stores", ", ".join(table.stores), message)
    opened = [_open(where, name, market) for name in table.stores]
    first, second = (x.table for x in opened)
    if opened[0].name == opened[1].name:
        raise where.error("stores", ", ".join(table.stores), "it must be two different files")
    for key in ("start", "end", "volume_unit", "currency"):
        value = getattr(first, key)
        if getattr(second, key) != value:
            message = f"it must be the same as in {table.stores[0]}, {value}"
            raise opened[1].where.error(key, getattr(second, key), message)
    today = table.inventory or [None] * STORES
    if len(today) != STORES:
        message = f"it must be a list of {STORES} numbers, one for each store"
        raise where.error("inventory", str(today), message)
    unit = f"{first.volume_unit}/day"
    into, out = (x and replace(x, unit=unit) for x in (table.net_injection, table.net_withdrawal))
    return OpenedStores(
        tuple(opened), into, out, table.transfers, first.start, first.end, first.volume_unit,
        first.currency, tuple(today),
    )  # fmt: skip


def _open(where: TableContext, name: str, market: Any) -> NamedTable:
    path = where.file.parent / name
    if path.suffix.lower() != ".toml" or path.parent.resolve() != where.file.parent.resolve():
        message = "it must be the name of a TOML file next to the case"
        raise where.error("stores", name, message)
    if not re.fullmatch(r"\w[\w -]*", path.stem) or path.stem == JOINT_FLOW:
        message = "it must contain only letters, digits, spaces, - and _"
        raise where.error("stores", name, message)
    if not path.is_file():
        raise where.error("stores", name, "there is no such file next to the case")
    data = load(path)[1]
    if list(data) != ["contract"]:
        message = (
            "this file may have only the table [contract]; the case has the market and the prices"
        )
        raise CaseError(str(path), ", ".join(data), None, message)
    inner = TableContext(path, "contract", where.notes)
    table = parse(ContractTable, data["contract"], str(path), "contract", where.notes)
    for key, only in ONLY.items():
        if (value := getattr(table, key)) != only:
            allowed = "left out if there are several stores" if only is None else f'"{only}"'
            raise inner.error(key, str(value), f"it must be {allowed}")
    for key in ZERO:
        if np.any(getattr(table, key).values):
            raise inner.error(key, getattr(table, key).written, NOTHING)
    if table.end_value not in (None, 0.0):
        raise inner.error("end_value", table.end_value, NOTHING)
    costs = table.injection_cost, table.withdrawal_cost, table.inventory_cost
    if market.settlement != "flow" and any(np.any(x.values) for x in costs):
        message = 'if a store has costs, which are paid on the day of the flow, it must be "flow"'
        raise CaseError(str(where.file), "market.settlement", str(market.settlement), message)
    return NamedTable(path.stem, table, inner)


def read_stores(
    where: TableContext, opened: OpenedStores, steps: Sequence[datetime.date]
) -> StoresContract:
    """The contract on its decision days, each of which has two of the `steps`."""
    days = steps[::STORES]
    stores = tuple(
        _read_store(x, days, opened.transfers, today, (*where.keys, "inventory", k))
        for k, (x, today) in enumerate(zip(opened.stores, opened.inventory))
    )
    limits = opened.net_injection, opened.net_withdrawal
    into, out = (x and x.on(days, where.notes) for x in limits)
    stores = _bumped_by_lots(stores, (into, out))
    joint = into is not None or out is not None or not opened.transfers
    names = [x.name for x in opened.stores]
    return StoresContract(
        stores=(stores[0], stores[1]),
        net_injection=into,
        net_withdrawal=out,
        layout=layout_of(names, opened.volume_unit, joint, opened.transfers),
        transfers=opened.transfers,
    )


def _bumped_by_lots(
    stores: tuple[Store, ...], joint: tuple[CaseInput | None, ...]
) -> tuple[Store, ...]:
    """The stores; a limit of zero is bumped by the common measure of all volumes when its
    derivative is tested.

    A smaller bump would lead to inventories between the nodes of the fitted value, where the fit is
    worse. The loss of value from this, divided by the bump, would dominate the difference.
    """
    volumes = [np.abs(x.used()) for x in joint if x is not None]
    for store in stores:
        levels = [store.inventory, *store.limits, *([] if store.end is None else [store.end])]
        numbers = [x.used() for x in levels]
        rates = [x.used() * store.factors[:, k] for k, x in enumerate(store.rates)]
        volumes += [*numbers, *rates]
    lot = common_measure(np.unique(np.concatenate([np.ravel(x) for x in volumes])).tolist())
    result = []
    for store in stores:
        low, high = store.limits
        if not low.values.any():
            low = replace(low, judge_bump=lot)
            if lot and store.inventory.used() < lot:
                meaning = (
                    f"{low.meaning}, which cannot be raised, since the store begins with less gas"
                )
                low = replace(low, meaning=meaning)
        end = store.end
        if end is not None and not end.values.any():
            end = replace(end, judge_bump=lot)
        result.append(replace(store, limits=(low, high), end=end))
    return tuple(result)


def _read_store(
    opened: NamedTable,
    days: Sequence[datetime.date],
    transfers: bool,
    today: float | None,
    key: tuple[str | int, ...],
) -> Store:
    """The store on these days; `today`: the inventory that the case sets under `key`, None if it
    sets none."""
    name, table, where = opened
    limits = read_limits(where, table, days)
    low, high = limits.min_inventory, limits.max_inventory
    start = float(table.inventory.values[0]) if today is None else today
    if not low.used()[0] <= start <= high.used()[0]:
        message = f"it must be {low.used()[0]:g} to {high.used()[0]:g} on {days[0]}"
        raise where.error("inventory", start, message)
    end, move = None, 2 * small_move(limits.ratchets)
    if table.end_inventory != "free":
        quantity = ContractTable.model_fields["inventory"].metadata[-1]
        end = quantity.input("end_inventory", [table.end_inventory])
        end = replace(end, unit=table.volume_unit, meaning="gas owed at the end", move=move)
        if not low.used()[-1] <= table.end_inventory <= high.used()[-1]:
            message = f"on {table.end} the limits allow {low.used()[-1]:g} to {high.used()[-1]:g}"
            raise where.error("end_inventory", table.end_inventory, message)
    if not transfers:
        if end is not None and table.end_inventory:
            message = 'without transfers it must be 0 or "free"'
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
    rates = limits.ratchets.injection, limits.ratchets.withdrawal
    into, out = (replace(x, index=x.index[:, 0]) for x in rates)
    stock = replace(named(table.inventory), move=move)
    if today is not None:
        stock = replace(stock, values=np.array([today]), positions=(key,))
    return Store(
        inventory=stock,
        limits=(named(low), named(high)),
        end=None if end is None else named(end),
        rates=(named(into), named(out)),
        factors=np.stack([limits.injection_factor, limits.withdrawal_factor], axis=1),
        costs=(daily(table.injection_cost), daily(table.withdrawal_cost)),
        fuel=(daily(table.injection_fuel), daily(table.withdrawal_fuel)),
        holding=daily(holding) if np.any(holding.values) else None,
    )
