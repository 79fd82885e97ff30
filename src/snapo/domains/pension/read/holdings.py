"""Reads `[credit]`, `[currencies]` and `[overlay]`: ratings, currencies and swaps."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.given import CaseInput
from snapo.case.quantity import ANY, FRACTION, POSITIVE, Range
from snapo.case.table import TableContext

from ..quantities import (
    AMOUNT,
    NUMBER,
    RATE,
    SHARE,
    VOLATILITY,
    YEARLY,
    FundQuantity,
    input_of,
)
from ..records.assets import Overlay
from ..records.market import Credit, Currencies
from ..records.regulation import MARKETS
from .cells import (
    TableReader,
    TimeGrid,
    empty,
    rising,
    unique,
    whole_steps,
    word,
    years,
)
from .tables import CreditTable, CurrenciesTable, OverlayTable

SPREAD = RATE.of("model", range=POSITIVE)
SHOCK = replace(VOLATILITY, range=Range(0.0, 5.0), blank=0.0)
CREDIT = {
    "spread": SPREAD.of("credit", meaning="the spread today, at unchanged prices of the holdings"),
    "mean_spread": replace(SPREAD, meaning="where the spread reverts to"),
    "mean_reversion": NUMBER.of(
        "model", unit=YEARLY, range=POSITIVE,
        meaning="mean reversion of the logarithm of a spread",
    ),
    "volatility": replace(SHOCK, meaning="volatility of the logarithm of a spread"),
    "default_loss": RATE.of(
        "premium", range=FRACTION, blank=0.0,
        meaning="the share of a holding lost per year at the mean spread",
    ),
}  # fmt: skip
NOT_HEDGED = "the hedged share does not feel it"
CURRENCY = {
    "volatility": replace(SHOCK, meaning=f"volatility of a currency; {NOT_HEDGED}"),
    "premium": RATE.of(
        "premium", range=Range(-1.0, 1.0), blank=0.0,
        meaning=f"return of a currency over the difference of rates; {NOT_HEDGED}",
    ),
    "hedge_ratio": SHARE.of(
        "model", blank=0.0, meaning="the share of a currency's exposure that is hedged"
    ),
    "hedge_cost": RATE.of(
        "model", range=FRACTION, blank=0.0,
        meaning="the cost of hedging a currency, per year of the hedged amount",
    ),
}  # fmt: skip
NOTIONAL = AMOUNT.of(
    "overlay", range=ANY, column="notional",
    meaning="the notional held today, before the first trade",
)  # fmt: skip
SWAP_COST = RATE.of(
    "overlay", unit="1", range=FRACTION, column="cost", blank=0.0,
    meaning="the share of the notional traded that trading swaps costs",
)  # fmt: skip


def read_credit(section: TableContext, table: CreditTable | None) -> Credit:
    """Spreads by rating; none without the table."""
    if table is None:
        return Credit((), **{name: empty(f"credit_{name}") for name in CREDIT})
    needed = [name for name, quantity in CREDIT.items() if quantity.blank is None]
    rows = read_rows(FileReference(section, "file", table.file), ("rating", *needed), tuple(CREDIT))
    ratings = unique(rows, "rating")
    return Credit(ratings, **_columns("credit", CREDIT, rows, ratings))


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
    markets = [word(row, "market", MARKETS) if row.cells.get("market") else "" for row in rows]
    emerging = tuple(market == MARKETS[1] for market in markets)
    numbers = _columns("currency", CURRENCY, rows, names)
    return Currencies(names=names, emerging=emerging, **numbers)


def _columns(
    prefix: str, quantities: Mapping[str, FundQuantity], rows: Sequence[Row], labels: Sequence[str]
) -> dict[str, Any]:
    """The numbers of columns, named like them; without one that was left out."""
    return {
        name: replace(quantity, column=name).column_of(f"{prefix}_{name}", rows, labels)
        for name, quantity in quantities.items()
    }


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
        maturity=np.array(maturity, np.int64),
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
