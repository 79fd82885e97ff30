"""Reads `[credit]`, `[currencies]` and `[overlay]`: ratings, currencies and swaps."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.given import CaseInput
from snapo.case.quantity import ANY, FRACTION, POSITIVE, Range
from snapo.case.table import TableContext

from ..quantities import AMOUNT, NUMBER, RATE, SHARE, VOLATILITY, YEARLY, FundQuantity, input_of
from ..records.assets import Overlay
from ..records.market import Credit, Currencies
from ..records.regulation import MARKETS
from .cells import TableReader, TimeGrid, rising, unique, whole_steps, word, years
from .tables import CreditTable, CurrenciesTable, OverlayTable

SPREAD, FEE = RATE.of("model", range=POSITIVE), RATE.of("model", range=FRACTION, blank=0.0)
SHOCK = replace(VOLATILITY, range=Range(0.0, 5.0), blank=0.0)
REVERSION = NUMBER.of("model", unit=YEARLY, range=POSITIVE)
CREDIT = (
    SPREAD.of("credit").in_column(
        "spread", "the spread today, with prices of the holdings unchanged"
    ),
    SPREAD.in_column("mean_spread", "the level to which the spread reverts"),
    REVERSION.in_column("mean_reversion", "mean reversion of the logarithm of a spread"),
    SHOCK.in_column("volatility", "volatility of the logarithm of a spread"),
    FEE.of("premium").in_column(
        "default_loss", "the share of a holding lost per year at the mean spread"
    ),
)
NOT_HEDGED = "the hedged share is not affected"
CURRENCY = (
    SHOCK.in_column("volatility", f"volatility of a currency; {NOT_HEDGED}"),
    FEE.of("premium", range=Range(-1.0, 1.0)).in_column(
        "premium", f"return of a currency in addition to the difference of rates; {NOT_HEDGED}"
    ),
    SHARE.of("model", blank=0.0).in_column(
        "hedge_ratio", "the share of a currency's exposure that is hedged"
    ),
    FEE.in_column(
        "hedge_cost", "the yearly cost of hedging a currency, as a share of the hedged amount"
    ),
)
NOTIONAL = AMOUNT.of("overlay").in_column(
    "notional", "the notional of today, before the first trade", range=ANY
)
SWAP_COST = FEE.of("overlay", unit="1").in_column(
    "cost", "the cost of trading swaps, as a share of the notional traded"
)


def read_credit(section: TableContext, table: CreditTable | None) -> Credit:
    """Spreads by rating; none without the table."""
    if table is None:
        return Credit((), **_columns("credit", CREDIT, (), ()))
    needed = [quantity.column for quantity in CREDIT if quantity.blank is None]
    optional = [quantity.column for quantity in CREDIT]
    rows = read_rows(FileReference(section, "file", table.file), ("rating", *needed), optional)
    ratings = unique(rows, "rating")
    return Credit(ratings, **_columns("credit", CREDIT, rows, ratings))


def read_currencies(section: TableContext, table: CurrenciesTable | None) -> Currencies:
    """Foreign currencies; none without the table."""
    if table is None:
        return Currencies((), **_columns("currency", CURRENCY, (), ()))
    optional = [*(quantity.column for quantity in CURRENCY), "market"]
    reference = FileReference(section, "file", table.file)
    rows = read_rows(reference, ("currency", "volatility"), optional)
    names = unique(rows, "currency")
    markets = [word(row, "market", MARKETS) if row.cells.get("market") else "" for row in rows]
    emerging = tuple(market == MARKETS[1] for market in markets)
    numbers = _columns("currency", CURRENCY, rows, names)
    return Currencies(names=names, emerging=emerging, **numbers)


def _columns(
    prefix: str, quantities: Sequence[FundQuantity], rows: Sequence[Row], labels: Sequence[str]
) -> dict[str, Any]:
    """{column: its numbers}; a column that was left out has none."""
    return {x.column: x.column_of(f"{prefix}_{x.column}", rows, labels) for x in quantities}


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

    def limit(key: str) -> CaseInput:
        return section.input(table, key, input_of(table, key, "overlay"))

    notional = replace(NOTIONAL, unit=grid.currency)
    return Overlay(
        maturities=np.array(maturity, np.int64),
        notional=notional.from_rows("overlay_notional", rows, labels),
        low=low,
        high=high,
        unit=table.unit,
        leverage=limit("leverage"),
        cost=SWAP_COST.column_of("overlay_cost", rows, labels),
        collateral_stress=limit("collateral_stress"),
        inflation=len(inflation),
        zero_coupon=tuple(i for i, row in enumerate(rates) if _swap_kind(row) == SWAPS[1]),
    )


def _swap_kind(row: Row) -> str:
    return word(row, "kind", SWAPS) if row.cells.get("kind") else SWAPS[0]
