"""Reads a gas-storage case, a TOML file and its CSVs; reads `[market]`, and checks whether numbers
are plausible."""

import calendar
import dataclasses
import datetime
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError
from snapo.case.given import CaseInput, NoPosition, SheetCell
from snapo.case.plausible import CaseFiles, Plausible, implausible
from snapo.case.report import ReportTable
from snapo.case.settings import (
    EvaluationTable,
    FittedTable,
    ObjectiveTable,
    check_window,
    read_evaluation,
    read_objective,
    read_training,
)
from snapo.case.table import TableContext, parse

from ..contract.feasibility import check_feasible
from ..contract.records import GasMarket, StorageCase, numbers_of
from ..curves.quotes import QuotedCurve, QuotedCurveTable, read_quotes
from ..hedges.table import HedgeTable, hedges_of
from ..history.table import BacktestTable, plan_of
from ..ladder.products import FORMATS as PRODUCTS
from ..ladder.products import products_of
from ..prices.process import Delivery
from ..prices.registry import check_curve, kinds, read_prices
from .contract import decision_days, payment_days, pays_by_price, read_contract
from .limits import read_limits
from .nomination import NominationTable, check_nomination, nominated_on
from .tables import FORWARD, ContractTable, MarketTable, StorageTable


def read_market(
    section: TableContext,
    table: MarketTable,
    days: Sequence[datetime.date],
    price_days: Sequence[datetime.date],
    moving: np.ndarray,
    unit: str,
) -> tuple[GasMarket, QuotedCurve | None]:
    """The market of a contract that has flows on `days` and needs prices on `price_days`, and the
    quotes from which its curve is made. `moving`: [T] whether gas can move on the day.
    """
    curve, quoted = _forward(section, table, price_days, unit)
    valuation = table.valuation_date
    rate, rate_day = _nodes(table.interest_rate, valuation)
    gas_day = payment_days(section, "settlement", table.settlement, days, valuation, moving)
    return GasMarket(curve, rate, rate_day, gas_day), quoted


_PLAIN = QuotedCurveTable()  # pyright: ignore[reportCallIssue]


def _forward(
    section: TableContext, table: MarketTable, days: Sequence[datetime.date], unit: str
) -> tuple[CaseInput, QuotedCurve | None]:
    """The forward price of each of `days`, from a curve or from quotes."""
    if (table.forward_curve is None) == (table.quotes is None):
        message = "[market] needs exactly one of: forward_curve, a CSV file of date,price, or "
        raise section.error("quotes", table.quotes, f"{message}quotes, one with product,price")
    if table.forward_curve is not None:
        if table.curve is not None:
            raise section.error(
                "curve",
                None,
                "this key is only used to make a curve from quotes, but the case has no quotes",
            )
        return read_curve(section, table.forward_curve, days, unit), None
    assert table.quotes is not None
    forward = replace(FORWARD, unit=unit)
    quoted = read_quotes(section, table.quotes, forward, table.curve or _PLAIN, days)
    labels = [day.isoformat() for day in days]
    reason = NoPosition(f"this curve is made from the quotes in {table.quotes}")
    return forward.input(
        "forward_curve", quoted.curve, labels, positions=(reason,) * len(days)
    ), quoted


def read_curve(
    section: TableContext, name: str, days: Sequence[datetime.date], unit: str
) -> CaseInput:
    """The forward price of each of `days`, from a CSV of quotes for days and months."""
    rows = read_rows(FileReference(section, "forward_curve", name), ("date", "price"))
    by_day, by_month = quotes(rows)
    both = [day for day in days if day in by_day and (day.year, day.month) in by_month]
    if both:
        more = f" and {len(both) - 1} more days have" if len(both) > 1 else " has"
        section.notes.append(
            f"In {name} {both[0]}{more} a quote for the day and one for the month: the quote for "
            "the day is used."
        )
    prices = []
    for day in days:
        price = by_day.get(day, by_month.get((day.year, day.month)))
        if price is None:
            message = (
                "there is no price for this day; the contract needs a quote for every day, or "
                f"its month, from {days[0]} to {days[-1]}"
            )
            raise CaseError(name, day.isoformat(), None, message)
        prices.append(price)
    labels = [day.isoformat() for day in days]
    forward = replace(FORWARD, unit=unit)
    positions = tuple(price.cell for price in prices)
    return forward.input(
        "forward_curve", [price.value for price in prices], labels, positions=positions
    )


class Quote(NamedTuple):
    """A price of the curve and its position."""

    value: float
    cell: SheetCell


CurveQuotes = tuple[Mapping[datetime.date, Quote], Mapping[tuple[int, int], Quote]]


def quotes(rows: Sequence[Row]) -> CurveQuotes:
    """The prices by day and by (year, month), in any order; refuses a period that is quoted
    twice."""
    by_day: dict[datetime.date, Quote] = {}
    by_month: dict[tuple[int, int], Quote] = {}
    for row in rows:
        price = Quote(FORWARD.cell(row), row.position("price"))
        period = row.period("date")
        if period is None:
            raise row.error("date", "a day must be written YYYY-MM-DD, a whole month YYYY-MM")
        _once(by_month if isinstance(period, tuple) else by_day, period, price, row)
    return by_day, by_month


def _once(quotes: dict, period: Any, price: Quote, row: Row) -> None:
    if period in quotes:
        raise row.error("date", "an earlier row already has a price for this period")
    quotes[period] = price


def _nodes(rate: CaseInput, valuation: datetime.date) -> tuple[CaseInput, np.ndarray]:
    """The interest rates of all nodes, and the days of the nodes since the valuation date."""
    starts = rate.starts
    days = np.zeros(1, np.int64) if starts is None else starts - valuation.toordinal()
    return replace(rate, index=np.arange(len(rate.values))), days


# Energy of a volume unit in MWh, and minor units of a currency in major ones.
ENERGY = {"MWh": 1.0, "kWh": 1e-3, "GWh": 1e3, "therm": 0.0293071, "MMBtu": 0.293071, "GJ": 1 / 3.6}
MONEY = {"EUR": 1.0, "USD": 1.0, "GBP": 1.0, "CHF": 1.0, "p": 0.01, "GBp": 0.01, "ct": 0.01}
PRICES = (1.0, 1000.0)  # per MWh, in one of these currencies
APART = 20.0  # a forward price is less than this multiple of its neighbours


def unit_slips(case: StorageCase, data: Mapping[str, Any]) -> Iterable[str]:
    """Notes on numbers that are probably in another unit; `data`: the tables of the case."""
    ranges = [*_by_price(case), *_by_size(case)]
    return implausible(numbers_of(case), ranges, CaseFiles(case.file, data)).values()


def _by_price(case: StorageCase) -> Iterator[Plausible]:
    """The plausible ranges of prices and of costs per unit of volume."""
    unit = ENERGY.get(case.volume_unit, math.nan) / MONEY.get(case.currency, math.nan)
    low, high = (0.0, math.inf) if math.isnan(unit) else (PRICES[0] * unit, PRICES[1] * unit)
    name = f"{case.currency}/{case.volume_unit}"
    hint = f"the curve is in {name}"
    if not case.model.proportional:  # a curve may pass zero, and costs may be above its prices
        yield Plausible(0.0, high, hint, names=("forward_curve",), by_size=True)
        return
    yield Plausible(low, high, hint, names=("forward_curve",), ratio=APART, by_size=True)
    highest = float(np.max(np.abs(case.market.forward_curve.values), initial=0.0))
    if highest > 0:
        paid = f"costs are in {name}, and the highest gas price is {highest:.6g}"
        names = ("injection_cost", "withdrawal_cost")
        yield Plausible(0.0, 3 * highest, paid, names=names, by_size=True)
        paid = f"it is in {name} per day, and the highest gas price is {highest:.6g}"
        yield Plausible(0.0, highest / 20, paid, names=("inventory_cost",), by_size=True)


def _by_size(case: StorageCase) -> Iterator[Plausible]:
    """The plausible range of rates: the store is filled in 0.1 to 10,000 days."""
    size = float(np.max(case.contract.max_inventory.values, initial=0.0))
    if size > 0:
        hint = f"rates are in {case.volume_unit} per day, and the store holds up to {size:.6g}"
        names = ("ratchet_injection", "ratchet_withdrawal", "min_injection", "min_withdrawal")
        yield Plausible(size / 1e4, 10 * size, hint, names=names)


def end_too_early(start: datetime.date, end: datetime.date) -> str:
    """A note if `end` is the last day of a period of whole months, which is probably a mistake;
    otherwise ""."""
    last = calendar.monthrange(end.year, end.month)[1]
    if start.day != 1 or end.day != last or (end - start).days <= 31:
        return ""
    after = end + datetime.timedelta(1)
    return (
        f"contract.end: {end} is the first day without a decision, but it is also the last day "
        f"of its month. If the contract includes this day, set end = {after}."
    )


def free_money(case: StorageCase) -> Iterator[str]:
    """Notes if the contract pays for moving gas at any price, which often means a wrong sign."""
    contract = case.contract
    inward, outward = contract.injection_cost.used(), contract.withdrawal_cost.used()
    if not len(case.days):
        return
    price = case.market.forward_curve.used()[: len(case.days)]
    paid = price * (1 + contract.injection_fuel.used()) + inward < 0
    if np.any(paid & (price > 0)):
        t = int(np.argmax(paid & (price > 0)))
        yield (
            f"On {case.days[t]} an injection earns money: injection_cost is {inward[t]:g}, and "
            f"gas costs {price[t]:g}. Is the sign of the cost right?"
        )
    elif (minimum := float(np.min(inward) + np.min(outward))) < 0:
        yield (
            "Injecting gas and withdrawing it again earns money at any prices: the sum of the "
            f"lowest injection_cost and the lowest withdrawal_cost is {minimum:g}. Is the sign of "
            "the costs right?"
        )


FORMATS = {
    "": StorageTable,
    "contract": ContractTable,
    "contract.nomination": NominationTable,
    "market": MarketTable,
    "model": [process.table for process in kinds().values()],
    **PRODUCTS,
    "hedge": HedgeTable,
    "backtest": BacktestTable,
    "report": ReportTable,
    "objective": ObjectiveTable,
    "training": FittedTable,
    "evaluation": EvaluationTable,
}


def read_case(file: Path, data: Mapping[str, Any]) -> StorageCase:
    """The case in the TOML file `file`; `data`: the tables of this file.

    Other files are read from its folder.

    **Raises:** `CaseError` if a table, a file or a number is wrong, or if the contract cannot be
    met; nothing is written.
    """
    top = parse(StorageTable, data, str(file), "")
    parse(ReportTable, top.report, str(file), "report")
    notes: list[str] = []
    contract_table, market_table = _parse_both(top, str(file), notes)
    valuation, end = market_table.valuation_date, contract_table.end
    where = TableContext(file, "contract", notes)
    if end <= contract_table.start:
        message = f"the first day without a decision must come after start, {contract_table.start}"
        raise where.error("end", end, message)
    days = decision_days(contract_table, valuation)
    expired = valuation > end
    price_days = (*days, end) if pays_by_price(contract_table) and not expired else days
    unit = f"{contract_table.currency}/{contract_table.volume_unit}"
    limits = read_limits(where, contract_table, days)
    section = TableContext(file, "market", notes)
    market, quoted = read_market(section, market_table, days, price_days, limits.moving(), unit)
    contract = read_contract(where, contract_table, days, valuation, limits, market.gas_day)
    section = TableContext(file, "model", notes)
    nominated = nominated_on(where, contract_table, (*days, end))
    delivery = Delivery(days, price_days, end, valuation, market.forward_curve, nominated)
    model = read_prices(section, top.model, delivery)
    check_curve(market_table.forward_curve or str(market_table.quotes), model, delivery)
    products = products_of(file, top.products, notes, days, valuation)
    case = StorageCase(
        file=file,
        title=top.title,
        volume_unit=contract_table.volume_unit,
        currency=contract_table.currency,
        valuation_date=valuation,
        start=contract_table.start,
        end=end,
        days=days,
        day=np.array([(day - valuation).days for day in days], np.int64),
        end_day=(end - valuation).days,
        expired=expired,
        contract=contract,
        market=market,
        quotes=quoted,
        products=products,
        hedges=hedges_of(file, top.hedge, notes, products),
        backtest=plan_of(file, top.backtest, notes),
        model=model,
        objective=read_objective(top.objective, str(file)),
        training=read_training(top.training, str(file), FittedTable),
        evaluation=read_evaluation(top.evaluation, str(file)),
        notes=tuple(notes),
    )
    check_window(case.training, [case.objective.kind], str(file))
    check_nomination(where, contract_table, case.objective.kind, products)
    unused = "" if expired else check_feasible(case)
    early = end_too_early(case.start, case.end)
    more = (*(note for note in (early, unused) if note), *unit_slips(case, data), *free_money(case))
    return dataclasses.replace(case, notes=(*case.notes, *more))


def _parse_both(
    top: StorageTable, file: str, notes: list[str]
) -> tuple[ContractTable, MarketTable]:
    """Reads both tables, and reports the mistakes of both in one message."""
    mistakes: list[CaseError] = []
    tables = []
    for table, data, name in (
        (ContractTable, top.contract, "contract"),
        (MarketTable, top.market, "market"),
    ):
        try:
            tables.append(parse(table, data, file, name, notes))
        except CaseError as error:
            mistakes.append(error)
    if mistakes:
        first, *rest = mistakes
        others = (*first.others, *rest)
        raise CaseError(first.file, first.where, first.value, first.allowed, others)
    return tables[0], tables[1]
