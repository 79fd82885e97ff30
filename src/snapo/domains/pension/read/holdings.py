"""Reads `[credit]`, `[currencies]` and `[overlay]`: ratings, currencies and swaps."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.given import CaseInput
from snapo.case.table import TableContext

from ..records.assets import Overlay
from ..records.market import Credit, Currencies
from ..records.regulation import MARKETS
from ..records.said import YEARLY, InputNumber, amount, rate, share, volatility
from ..records.said import number as pure
from .cells import (
    TableReader,
    TimeGrid,
    above_zero,
    empty,
    listed,
    number,
    rising,
    single,
    unique,
    whole_steps,
    word,
    years,
)
from .tables import CreditTable, CurrenciesTable, OverlayTable

CREDIT = {
    "spread": rate("the spread today, at unchanged prices of the holdings", "credit"),
    "mean_spread": rate("where the spread reverts to", "model"),
    "mean_reversion": pure("mean reversion of the logarithm of a spread", "model", YEARLY),
    "volatility": volatility("volatility of the logarithm of a spread"),
    "default_loss": rate("the share of a holding lost per year at the mean spread", "premium"),
}
NOT_HEDGED = "the hedged share does not feel it"
CURRENCY = {
    "volatility": volatility(f"volatility of a currency; {NOT_HEDGED}"),
    "premium": rate(f"return of a currency over the difference of rates; {NOT_HEDGED}", "premium"),
    "hedge_ratio": share("the share of a currency's exposure that is hedged", "model"),
    "hedge_cost": rate("the cost of hedging a currency, per year of the hedged amount", "model"),
}
LIMIT = "a limit of the swaps"


def column(
    name: str,
    rows: Sequence[Row],
    column: str,
    labels,
    metadata: InputNumber,
    maximum: float = 1.0,
    minimum=0.0,
) -> CaseInput:
    """The numbers of a column that may be left out: then they are zero, and no input."""
    if column not in rows[0].cells:
        return empty(name, (len(rows),))
    return listed(
        name, [number(row, column, 0.0, minimum, maximum) for row in rows], labels, metadata
    )


def read_credit(section: TableContext, table: CreditTable | None) -> Credit:
    """Spreads by rating; none without the table."""
    if table is None:
        return Credit((), **{name: empty(f"credit_{name}") for name in CREDIT})
    needed = ("spread", "mean_spread", "mean_reversion")
    rows = read_rows(FileReference(section, "file", table.file), ("rating", *needed), tuple(CREDIT))
    ratings = unique(rows, "rating")

    def above(name: str) -> CaseInput:
        values = [above_zero(row, name) for row in rows]
        return listed(f"credit_{name}", values, ratings, CREDIT[name])

    def optional(name: str, maximum: float) -> CaseInput:
        return column(f"credit_{name}", rows, name, ratings, CREDIT[name], maximum)

    return Credit(
        names=ratings,
        **{name: above(name) for name in needed},
        volatility=optional("volatility", 5.0),
        default_loss=optional("default_loss", 1.0),
    )


def read_currencies(section: TableContext, table: CurrenciesTable | None) -> Currencies:
    """Foreign currencies; none without the table."""
    if table is None:
        none: dict[str, Any] = {name: empty(f"currency_{name}") for name in CURRENCY}
        return Currencies((), **none)
    rows = read_rows(
        FileReference(section, "file", table.file),
        ("currency", "volatility"),
        (*CURRENCY, "market"),
    )
    names = unique(rows, "currency")
    ranges = {"volatility": (5.0, 0.0), "premium": (1.0, -1.0)}
    markets = [word(row, "market", MARKETS) if row.cells.get("market") else "" for row in rows]
    numbers: dict[str, Any] = {
        name: column(f"currency_{name}", rows, name, names, metadata, *ranges.get(name, ()))
        for name, metadata in CURRENCY.items()
    }
    emerging = tuple(market == MARKETS[1] for market in markets)
    return Currencies(names=names, emerging=emerging, **numbers)


SWAPS = ("rates", "zero-coupon", "inflation")  # kinds of swaps of the overlay


def read_overlay(
    section: TableReader, table: OverlayTable | None, grid: TimeGrid
) -> Overlay | None:
    """Swaps by tenor bucket."""
    if table is None:
        return None
    rows = read_rows(
        FileReference(section, "file", table.file),
        ("tenor", "notional", "low", "high"),
        ("kind", "cost"),
    )
    inflation = [row for row in rows if _swap_kind(row) == SWAPS[-1]]
    rates = [row for row in rows if _swap_kind(row) != SWAPS[-1]]
    for of_kind in (rates, inflation):
        rising(of_kind, "tenor")
    rows = [*rates, *inflation]
    maturity = [whole_steps(row, "tenor", grid.step) for row in rows]
    labels = [years(steps * grid.step) for steps in maturity]
    labels = [f"{t} {SWAPS[-1]}" * (row in inflation) or t for t, row in zip(labels, rows)]
    low, high = (np.array([row.number(name) for row in rows]) for name in ("low", "high"))
    for row, minimum, maximum in zip(rows, low, high):
        if minimum > maximum:
            raise row.error("low", f"the lower limit must not exceed the upper one, {maximum:g}")
    held = amount("the notional held today, before the first trade", "overlay", grid.currency)
    cost = rate("the share of the notional traded that trading swaps costs", "overlay", "1")

    def limit(key: str, metadata: InputNumber) -> CaseInput:
        return section.input(table, key, single(f"overlay_{key}", getattr(table, key), metadata))

    return Overlay(
        maturity=np.array(maturity, np.int64),
        notional=listed("overlay_notional", [row.number("notional") for row in rows], labels, held),
        low=low,
        high=high,
        unit=table.unit,
        leverage=limit("leverage", share(LIMIT, "overlay")),
        cost=column("overlay_cost", rows, "cost", labels, cost),
        collateral_stress=limit("collateral_stress", share(LIMIT, "overlay", YEARLY)),
        inflation=len(inflation),
        zero_coupon=tuple(i for i, row in enumerate(rates) if _swap_kind(row) == SWAPS[1]),
    )


def _swap_kind(row: Row) -> str:
    return word(row, "kind", SWAPS) if row.cells.get("kind") else SWAPS[0]
