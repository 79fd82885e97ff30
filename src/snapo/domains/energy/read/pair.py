"""`[market]` and `[model]` of a contract that turns a fuel into power: two commodities."""

from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import Field

from snapo.case.csv import FileReference, read_rows
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.quantity import Range
from snapo.case.table import CaseTable, TableContext

from ...gas_storage.contract.records import GasMarket
from ...gas_storage.prices.factors import CORRELATION, OneFactorTable
from ...gas_storage.prices.pair import CommodityPair
from ...gas_storage.read.tables import DATE, ZERO_RATE, DateKey, FileName
from .hours import Hours, dated_curve, hourly_curve, hourly_market

FIRST, SECOND = "power", "gas"
CORRELATIONS = 'a list like [["power", "gas", 0.4]]'
RHO = Range(-1.0, 1.0, "()")


class PowerMarketTable(CaseTable):
    """`[market.power]`."""

    forward_curve: FileName = Field(description="a CSV file with columns time,price")


class GasMarketTable(CaseTable):
    """`[market.gas]`."""

    forward_curve: FileName = Field(
        description="a CSV file with columns date,price (by day) or time,price (by hour)"
    )


class PairMarketTable(CaseTable):
    """`[market]` of a plant."""

    valuation_date: DateKey = Field(description=DATE)
    interest_rate: CaseInput = ZERO_RATE("continuous zero rate", 0.0)
    power: dict = Field(description="the table [market.power]")
    gas: dict = Field(description="the table [market.gas]")


class PairModelTable(CaseTable):
    """`[model]` of a plant."""

    power: dict = Field(description="the table [model.power]")
    gas: dict = Field(description="the table [model.gas]")
    correlation: list[Any] = Field([], description=CORRELATIONS)


def read_pair_market(
    section: TableContext, table: PairMarketTable, hours: Hours, unit: str
) -> tuple[GasMarket, CaseInput]:
    """Power by the hour, with the rates; and the price of gas of each hour, by the hour or day."""
    power = section.nested(PowerMarketTable, table.power, FIRST)
    gas = section.nested(GasMarketTable, table.gas, SECOND)
    inner = TableContext(section.file, f"{section.name}.{FIRST}", section.notes)
    curve = hourly_curve(inner, power.forward_curve, hours, unit, f"{FIRST}_curve")
    inner = TableContext(section.file, f"{section.name}.{SECOND}", section.notes)
    columns = read_rows(FileReference(inner, "forward_curve", gas.forward_curve), ("price",))
    daily = bool(columns) and "time" not in columns[0].cells
    read = dated_curve if daily else hourly_curve
    second = read(inner, gas.forward_curve, hours, unit, f"{SECOND}_curve")
    for file, prices in ((power.forward_curve, curve), (gas.forward_curve, second)):
        for t in np.flatnonzero(prices.values <= 0)[:1]:
            message = "the model multiplies the forward price and needs it above 0"
            raise CaseError(file, prices.labels[t], float(prices.values[t]), message)
    return hourly_market(curve, table, hours), second


def read_pair_model(
    section: TableContext, table: PairModelTable, hours: Any, second: CaseInput
) -> CommodityPair:
    """The prices of both; `hours`: the delivery, with the curve of power."""
    factors = [section.nested(OneFactorTable, x, name)
               for name, x in ((FIRST, table.power), (SECOND, table.gas))]  # fmt: skip
    both = [(FIRST, factors[0]), (SECOND, factors[1])]
    reversions = tuple(replace(x.mean_reversion, name=f"{name}_mean_reversion") for name, x in both)
    volatilities = tuple(
        replace(x.volatility.on(hours.dates, section.notes), name=f"{name}_volatility")
        for name, x in both
    )
    rho = _correlation(section, table.correlation)
    position = (*section.keys, "correlation", 0, 2) if table.correlation else None
    correlation = CORRELATION.input("correlation", [rho], positions=(position,))
    return CommodityPair(  # pyright: ignore[reportCallIssue]
        hours.times, second, reversions, volatilities, correlation
    )


def _correlation(section: TableContext, entries: list[Any]) -> float:
    if not entries:
        return 0.0
    if len(entries) > 1 or not isinstance(entries[0], list) or len(entries[0]) != 3:
        raise section.error("correlation", entries, f"it must be {CORRELATIONS}")
    one, other, rho = entries[0]
    if {one, other} != {FIRST, SECOND} if _texts(one, other) else True:
        raise section.error("correlation", entries, f"it must be {CORRELATIONS}")
    if isinstance(rho, bool) or not isinstance(rho, int | float) or not RHO.contains(rho):
        raise section.error("correlation", rho, f"it must be {RHO}")
    return float(rho)


def _texts(*names: Any) -> bool:
    return all(isinstance(name, str) for name in names)
