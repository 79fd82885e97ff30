"""Reads `[assets]`: the classes, each by its kind, with their numbers, weights and bounds."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import Unquoted
from snapo.case.given import CaseInput
from snapo.case.quantity import FRACTION, Range
from snapo.case.table import TableContext

from ..market.assets.asset_class import SPECIAL, AssetClass, AssetNames
from ..market.registry import KINDS
from ..quantities import (
    FROM_YEAR,
    RATE,
    SHARE,
    VOLATILITY,
    YEARLY,
    FundQuantity,
    on_steps,
    side_by_side,
)
from ..records.assets import AssetGroup, Assets
from ..records.regulation import RISKS
from .cells import WHOLE, TimeGrid, empty, number, unique, word
from .tables import AssetsTable

MEAN = SHARE.of("premium", unit=YEARLY, range=Range(-0.999, 1.0)).in_column(
    "mean",
    "mean return of a class: over cash for excess returns, the whole return for total returns",
)
IN_CELL = VOLATILITY.in_column(
    "volatility", "volatility of a class in its own currency; the mean in the case does not change",
    range=Range(0.0, 5.0),
)  # fmt: skip
IN_FILE = replace(IN_CELL, range=VOLATILITY.range, by=FROM_YEAR, column="value")
SMOOTHING = SHARE.of("model").in_column(
    "smoothing", "the share of a step's return that appraised prices show at once"
)
LIMITS = ("low", "high", "group", "group_low", "group_high", "max_sale", "band")
OPTIONAL = (*SPECIAL, *LIMITS, "cost", "fee", "currency", "eligible", "risk")
OF_TRADE = RATE.of("assets", unit="1", range=FRACTION, blank=0.0)
COST = OF_TRADE.in_column("cost", "the cost of trading as a share of the trade")
FEE = OF_TRADE.in_column("fee", "the fee per year, as a share of the holding", unit=YEARLY)
WEIGHT = SHARE.of("assets", meaning="a weight in the holdings of today, before the first trade")
FARTHEST = 10.0  # a bound beyond 1,000 % of the assets is a percentage that was not divided by 100


def read_assets(
    section: TableContext, table: AssetsTable, amount: CaseInput, grid: TimeGrid, names: AssetNames
) -> Assets:
    """The table of asset classes; a cost or a fee that is empty is zero."""
    rows = read_rows(
        FileReference(section, "file", table.file), ("name", "kind", "weight"), OPTIONAL
    )
    labels = unique(rows, "name")
    classes = tuple(_class(row, names) for row in rows)
    cash = [class_.name for class_ in classes if class_.is_cash]
    if len(cash) != 1:
        got = Unquoted(f"{len(cash)} classes of kind cash")
        raise section.error("file", got, f"exactly one row of {table.file} must be cash")
    local = [i for i, item in enumerate(classes) if item.own_shock]
    smoothed = [i for i, row in enumerate(rows) if row.cells.get("smoothing")]
    for column_name in ("max_sale", "band"):
        if rows[_cash(classes)].cells.get(column_name):
            raise rows[_cash(classes)].error(
                column_name,
                "the weight of cash follows from the other classes, so cash has no such limit",
            )
    low, high = _bounds(rows)
    groups = _groups(rows, classes, low, high)
    _check_bounds(section, low, high, groups)
    endpoints = [(min(minimum, 0.0), max(maximum, 1.0)) for minimum, maximum in zip(low, high)]
    weights = _weights(section, table.file, rows, endpoints)

    def of(quantity: FundQuantity, of_rows: Sequence[int]) -> CaseInput:
        for i in of_rows:
            rows[i].cells.setdefault(quantity.column, "")
        selected = [rows[i] for i in of_rows]
        return quantity.from_rows(
            f"asset_{quantity.column}", selected, [labels[i] for i in of_rows]
        )

    return Assets(
        classes=classes,
        return_kind=table.return_kind,
        mean_kind=table.mean_kind,
        mean=of(MEAN, local),
        volatility=_volatilities(section, rows, local, grid),
        smoothing=of(SMOOTHING, smoothed),
        smoothed=np.array(smoothed, np.int64),
        cost=COST.column_of("asset_cost", rows, labels),
        fee=FEE.column_of("asset_fee", rows, labels),
        weight=WEIGHT.input(
            "asset_weight", weights, labels, positions=tuple(row.position("weight") for row in rows)
        ),
        low=low,
        high=high,
        groups=groups,
        max_sale=_limit(rows, "max_sale", math.inf),
        band=_limit(rows, "band", 0.0),
        turnover=table.turnover,
        risk=tuple(_risk(row, entry) for row, entry in zip(rows, classes)),
        amount=amount,
    )


def _risk(row: Row, of: AssetClass) -> str:
    return word(row, "risk", RISKS) if row.cells.get("risk") else of.risk


def _limit(rows: Sequence[Row], column_name: str, default: float) -> np.ndarray | None:
    """A column of shares from 0 to 1; None if no row has one."""
    if not any(row.cells.get(column_name) for row in rows):
        return None
    return np.array([number(row, column_name, default, 0.0, 1.0) for row in rows])


def _cash(classes: Sequence[AssetClass]) -> int:
    return next(i for i, class_ in enumerate(classes) if class_.is_cash)


def _class(row: Row, names: AssetNames) -> AssetClass:
    """One row: the common fields of all kinds, and those of its kind."""
    kind = KINDS[word(row, "kind", tuple(sorted(KINDS)))]
    for special in SPECIAL:
        if row.cells.get(special) and special not in kind.columns:
            owners = ", ".join(
                name for name, item in sorted(KINDS.items()) if special in item.columns
            )
            message = (
                f"a class of kind {kind.kind} has no such number: {kind.without} (kinds that "
                f"have it: {owners})"
            )
            raise row.error(special, message)
    return kind(
        name=row.cells["name"],
        currency=names.currency(row),
        group=row.cells.get("group", ""),
        eligible=number(row, "eligible", kind.collateral, 0.0, 1.0),
        **kind.read(row, names),
    )


def _volatilities(
    section: TableContext, rows: Sequence[Row], local: Sequence[int], grid: TimeGrid
) -> CaseInput:
    """Volatilities of the classes `local` with a separate shock, side by side."""
    if not local:
        return empty("asset_volatility", (grid.steps, 0))
    parts = [on_steps(_volatility(section, rows[i]), grid) for i in local]
    return side_by_side("asset_volatility", parts, [rows[i].cells["name"] for i in local])


def _volatility(section: TableContext, row: Row) -> CaseInput:
    """A number, or the name of a CSV with columns from_year,value."""
    text = row.cells.setdefault("volatility", "")
    if text.lower().endswith((".csv", ".parquet")):
        file = FileReference(section, "file", text)
        return IN_FILE.from_dated_rows("", read_rows(file, (FROM_YEAR, IN_FILE.column)))
    return IN_CELL.from_rows("", [row], ("",))


def _bounds(rows: Sequence[Row]) -> tuple[np.ndarray, np.ndarray]:
    """[n] low and [n] high, by default 0 and 1."""
    low = np.array([number(row, "low", 0.0, -FARTHEST, FARTHEST) for row in rows])
    high = np.array([number(row, "high", 1.0, -FARTHEST, FARTHEST) for row in rows])
    for row, minimum, maximum in zip(rows, low, high):
        if minimum > maximum:
            row.cells.setdefault("low", "")
            raise row.error("low", f"the lower bound must not exceed the upper one, {maximum:g}")
        for name, bound in (("low", minimum), ("high", maximum)):
            if bound > 1 and not (low < 0).any():
                message = "it must be at most 1, unless a low below 0 allows short positions"
                raise row.error(name, message)
        if minimum < 0 and row.cells.get("max_sale"):
            message = "a class whose low is below 0 can be sold short: its sales cannot be limited"
            raise row.error("max_sale", message)
    return low, high


def _weights(
    section: TableContext, file: str, rows: Sequence[Row], endpoints: Sequence[tuple[float, float]]
) -> list[float]:
    """Weights of today, between their `endpoints`: 0 and 1, or beyond as far as the bounds of the
    class go."""
    numbers = [row.number("weight", *item) for row, item in zip(rows, endpoints)]
    total = math.fsum(numbers)
    if abs(total - 1) > WHOLE:
        got = Unquoted(f"weights that add up to {total:.6g}")
        raise section.error("file", got, f"the weights in {file} must add up to 1")
    return numbers


def _groups(
    rows: Sequence[Row], classes: Sequence[AssetClass], low: np.ndarray, high: np.ndarray
) -> tuple[AssetGroup, ...]:
    """Groups in the order in which they appear; limits may be in any of a group's rows.

    Without limits a group has a weight from 0 to 1, or the sum of its classes' limits where a class
    may be short.
    """
    short, groups = bool((low < 0).any()), []
    minimum, maximum = (-FARTHEST, FARTHEST) if short else (0.0, 1.0)
    for name in dict.fromkeys(class_.group for class_ in classes if class_.group):
        members = tuple(i for i, item in enumerate(classes) if item.group == name)
        of = list(members)
        defaulted = (float(low[of].sum()), float(high[of].sum())) if short else (0.0, 1.0)
        limits = []
        for limit, default in zip(("group_low", "group_high"), defaulted):
            inputs = [rows[i] for i in members if rows[i].cells.get(limit)]
            values = [row.number(limit, minimum, maximum) for row in inputs]
            for row, value in zip(inputs, values):
                if value != values[0]:
                    raise row.error(limit, f"the group {name} has {values[0]:g} in an earlier row")
            limits.append(values[0] if values else default)
        groups.append(AssetGroup(name, members, limits[0], limits[1]))
    return tuple(groups)


def _check_bounds(
    section: TableContext, low: np.ndarray, high: np.ndarray, groups: Sequence[AssetGroup]
) -> None:
    """There must be weights within all bounds that add up to one."""
    minimum, maximum = float(low.sum()), float(high.sum())
    for group in groups:
        members = list(group.members)
        inside = float(low[members].sum()), float(high[members].sum())
        lower, upper = max(group.low, inside[0]), min(group.high, inside[1])
        if lower > upper + WHOLE:
            got = Unquoted(f"limits {group.low:g} to {group.high:g} of the group {group.name}")
            message = (
                f"the bounds of its classes allow a total weight from {inside[0]:g} to "
                f"{inside[1]:g}"
            )
            raise section.error("file", got, message)
        minimum += lower - inside[0]
        maximum += upper - inside[1]
    if minimum > 1 + WHOLE or maximum < 1 - WHOLE:
        got = Unquoted(f"bounds within which the weights add up to {minimum:g} to {maximum:g}")
        message = (
            "the weights must be able to add up to 1: the lower bounds add up to at most 1, the "
            "upper ones to at least 1"
        )
        raise section.error("file", got, message)
