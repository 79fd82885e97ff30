"""`[market]` and `[model]` of a contract that turns a fuel into power: two or three commodities."""

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from snapo.case.csv import FileReference, read_rows
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.quantity import Range
from snapo.case.table import CaseTable, Nonempty, TableContext, doc, subtable

from ...gas_storage.contract.records import GasMarket
from ...gas_storage.prices.factors import CORRELATION, OneFactorTable
from ...gas_storage.prices.pair import CommodityPair
from ...gas_storage.prices.trio import CommodityTrio
from ...gas_storage.read.tables import ZERO_RATE, ValuationDay
from .hours import HourlyCurve, Hours, dated_curve, hourly_curve, hourly_market

FIRST, SECOND, THIRD = "power", "gas", "co2"
CORRELATIONS = 'a list like [["power", "gas", 0.4]]'
RHO = Range(-1.0, 1.0, "()")


class PowerMarketTable(CaseTable):
    """`[market.power]`."""

    forward_curve: HourlyCurve


class GasMarketTable(CaseTable):
    """`[market.gas]`, or `[market.co2]` for emission certificates."""

    forward_curve: Nonempty = doc(
        "price today by day or hour of delivery, in currency/MWh, or in currency per certificate",
        allowed="a CSV file with columns date,price (by day) or time,price (by hour)",
    )


class PairMarketTable(CaseTable):
    """`[market]` of a plant."""

    valuation_date: ValuationDay
    interest_rate: CaseInput = ZERO_RATE("continuous zero rate", 0.0)
    power: dict = subtable("market of the power", "market.power")
    gas: dict = subtable("market of the gas", "market.gas")
    co2: dict | None = doc(
        "market of certificates", None, "the table [market.co2], if emissions need it"
    )


class PairModelTable(CaseTable):
    """`[model]` of a plant."""

    power: dict = subtable("model of the price of power", "model.power")
    gas: dict = subtable("model of the price of gas", "model.gas")
    co2: dict | None = doc(
        "model of the price of certificates", None, "the table [model.co2], if emissions need it"
    )
    correlation: list[Any] = doc("correlations of the shocks of two prices", [], CORRELATIONS)


def read_pair_market(
    section: TableContext, table: PairMarketTable, hours: Hours, unit: str
) -> tuple[GasMarket, tuple[CaseInput, ...]]:
    """The hourly prices of power, with the interest rates; and for each hour the prices of gas and,
    if they have a market, of certificates. Gas and certificates may have one price for the whole
    day."""
    power = section.nested(PowerMarketTable, table.power, FIRST)
    inner = TableContext(section.file, f"{section.name}.{FIRST}", section.notes)
    curve = hourly_curve(inner, power.forward_curve, hours, unit, f"{FIRST}_curve")
    tables = [(SECOND, table.gas, unit)]
    if table.co2 is not None:
        tables.append((THIRD, table.co2, unit.partition("/")[0]))
    others, files = [], [power.forward_curve]
    for name, raw, of_price in tables:
        file = section.nested(GasMarketTable, raw, name).forward_curve
        inner = TableContext(section.file, f"{section.name}.{name}", section.notes)
        columns = read_rows(FileReference(inner, "forward_curve", file), ("price",))
        daily = bool(columns) and "time" not in columns[0].cells
        read = dated_curve if daily else hourly_curve
        others.append(read(inner, file, hours, of_price, f"{name}_curve"))
        files.append(file)
    for file, prices in zip(files, (curve, *others)):
        for t in np.flatnonzero(prices.values <= 0)[:1]:
            message = "the model multiplies the forward price, which must therefore be above 0"
            raise CaseError(file, prices.labels[t], float(prices.values[t]), message)
    return hourly_market(curve, table, hours), tuple(others)


def read_pair_model(
    section: TableContext,
    table: PairModelTable,
    hours: Any,
    others: tuple[CaseInput, ...],
    share: CaseInput | None,
) -> CommodityPair:
    """The model of the prices of all commodities. `hours`: the delivery hours, with the curve of
    power; `others`: the curves of gas and of certificates; `share`: how many certificates a unit
    of gas needs, None without certificates."""
    _check_third(section, table, others, share)
    tables = [(FIRST, table.power), (SECOND, table.gas)]
    tables += [] if share is None else [(THIRD, table.co2)]
    every = [(name, section.nested(OneFactorTable, x, name)) for name, x in tables]
    reversions = tuple(
        replace(x.mean_reversion, name=f"{name}_mean_reversion") for name, x in every
    )
    volatilities = tuple(
        replace(x.volatility.on(hours.dates, section.notes), name=f"{name}_volatility")
        for name, x in every
    )
    names = [name for name, _ in every]
    by_pair = _correlations(section, table.correlation, names)
    pairs = [frozenset(x) for x in combinations(names, 2)]
    numbers = [by_pair.get(pair, (0.0, None)) for pair in pairs]
    labels = [", ".join(x) for x in combinations(names, 2)] if share is not None else [""]
    correlation = CORRELATION.input(
        "correlation", [x for x, _ in numbers], labels, positions=tuple(x for _, x in numbers)
    )
    both = hours.times, others[0], reversions, volatilities, correlation
    if share is None:
        return CommodityPair(*both)  # pyright: ignore[reportCallIssue]
    rho = np.eye(3)
    rho[np.triu_indices(3, 1)] = correlation.values
    if np.linalg.eigvalsh(rho, "U")[0] <= 0:
        message = (
            "these correlations are impossible together: their matrix must be positive definite"
        )
        raise section.error("correlation", table.correlation, message)
    return CommodityTrio(*both, third_curve=others[1], share=share)  # pyright: ignore[reportCallIssue]


def _check_third(section: TableContext, table: PairModelTable, others, share) -> None:
    """Refuses certificates with a market but without a curve and a model, and the reverse."""
    for name, there in (("market.co2", len(others) > 1), ("model.co2", table.co2 is not None)):
        if there and share is None:
            message = 'allowed only if contract.emission has market = "co2"'
            raise CaseError(str(section.file), name, None, message)
        if not there and share is not None:
            message = 'this table is needed if contract.emission has market = "co2"'
            raise CaseError(str(section.file), name, None, message)


def _correlations(section: TableContext, entries: list[Any], names: list[str]) -> dict:
    """{pair of names: (correlation, position in the file)} of the entries."""
    result: dict[frozenset, tuple[float, Any]] = {}
    allowed = CORRELATIONS
    if len(names) > 2:
        allowed += f", with one entry for each pair of {', '.join(names)}"
    for i, entry in enumerate(entries):
        if len(entries) > len(names) * (len(names) - 1) // 2 or not isinstance(entry, list):
            raise section.error("correlation", entries, f"it must be {allowed}")
        *pair, rho = entry
        valid = all(isinstance(name, str) and name in names for name in pair)
        if not valid or len(pair) != 2 or pair[0] == pair[1] or frozenset(pair) in result:
            raise section.error("correlation", entries, f"it must be {allowed}")
        if isinstance(rho, bool) or not isinstance(rho, int | float) or not RHO.contains(rho):
            raise section.error("correlation", rho, f"it must be {RHO}")
        result[frozenset(pair)] = float(rho), (*section.keys, "correlation", i, 2)
    return result
