"""Reads `[assets]`, `[credit]`, `[currencies]` and `[overlay]`: what the fund may hold."""

import math
from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np

from snapo.case.csv import Mention, Row, read_rows
from snapo.case.error import Unquoted
from snapo.case.given import Given
from snapo.case.table import Section

from .case_curve import SQUARE_ROOT, YEARLY
from .cells import (
    Pieces,
    above_zero,
    empty,
    listed,
    number,
    pieces,
    position,
    rising,
    side_by_side,
    single,
    unique,
    word,
    years,
)
from .records import AssetClass, AssetKind, Assets, Credit, Currencies, Group, Overlay
from .tables import AssetsTable, CreditTable, CurrenciesTable, OverlayTable

OWN_SHOCK = ("equity", "property", "commodity", "hedge-fund")
BONDS = ("bond", "credit")
KINDS = ("cash", *OWN_SHOCK, *BONDS)
WHOLE = 1e-6  # of a step, or of all weights: closer than this is a whole


class Grid(NamedTuple):
    """What all tables are read for: the number of decisions, the years of a step, the currency."""

    steps: int
    step: float
    currency: str


def read_assets(
    section: Section,
    table: AssetsTable,
    amount: float,
    grid: Grid,
    ratings: Sequence[str],
    currencies: Sequence[str],
) -> Assets:
    """The table of asset classes; costs and fees of classes without one are zero."""
    rows = read_rows(Mention(section, "file", table.file), ("name", "kind", "weight"))
    names = unique(rows, "name")
    classes = tuple(_class(row, grid.step, ratings, currencies) for row in rows)
    cash = [name for name, each in zip(names, classes) if each.kind == "cash"]
    if len(cash) != 1:
        got = Unquoted(f"{len(cash)} classes of kind cash")
        raise section.error("file", got, f"exactly one row of {table.file} must be cash")
    own = [i for i, each in enumerate(classes) if each.kind in OWN_SHOCK]
    smoothed = [i for i in own if rows[i].cells.get("smoothing")]
    low = np.array([number(row, "low", 0.0, 0.0, 1.0) for row in rows])
    high = np.array([number(row, "high", 1.0, 0.0, 1.0) for row in rows])
    groups = _groups(rows, classes)
    _check_bounds(section, rows, low, high, groups)
    return Assets(
        classes=classes,
        return_kind=table.return_kind,
        mean_kind=table.mean_kind,
        shocks=np.array(own, np.int64),
        mean=listed("asset_mean", [_mean(rows[i]) for i in own], [names[i] for i in own], YEARLY),
        volatility=side_by_side(
            "asset_volatility",
            SQUARE_ROOT,
            [_volatility(section, rows[i], grid) for i in own],
            [names[i] for i in own],
        )
        if own
        else empty("asset_volatility", (grid.steps, 0)),
        smoothing=listed(
            "asset_smoothing",
            [rows[i].number("smoothing", 0.0, 1.0) for i in smoothed],
            [names[i] for i in smoothed],
        ),
        smoothed=np.array(smoothed, np.int64),
        cost=_column("asset_cost", rows, "cost", names, "1"),
        fee=_column("asset_fee", rows, "fee", names, YEARLY),
        weight=listed("asset_weight", _weights(section, table.file, rows), names),
        low=low,
        high=high,
        groups=groups,
        amount=single("assets", amount, grid.currency),
    )


def _class(row: Row, step: float, ratings, currencies) -> AssetClass:
    kind = cast(AssetKind, word(row, "kind", KINDS))
    rating = position(row, "rating", ratings, "rating in [credit]")
    currency = position(row, "currency", currencies, "currency in [currencies]")
    if (kind == "credit") != (rating >= 0):
        row.cells.setdefault("rating", "")
        raise row.error("rating", "a class of kind credit needs a rating, and no other has one")
    if kind == "cash" and currency >= 0:
        raise row.error("currency", "cash is held in the fund's own currency")
    for column in ("mean", "volatility") if kind not in OWN_SHOCK else ():
        if row.cells.get(column):
            what = f"a class of kind {kind} has none: it follows from the curve"
            raise row.error(column, what)
    return AssetClass(
        name=row.cells["name"],
        kind=kind,
        maturity=_maturity(row, kind, step),
        rating=rating,
        currency=currency,
        group=row.cells.get("group", ""),
        eligible=number(row, "eligible", 1.0 if kind in ("cash", "bond") else 0.0, 0.0, 1.0),
    )


def _maturity(row: Row, kind: str, step: float) -> int:
    text = row.cells.setdefault("maturity", "")
    if kind not in BONDS:
        if text:
            raise row.error("maturity", "only classes of kind bond and credit have a maturity")
        return 0
    return whole_steps(row, "maturity", step)


def whole_steps(row: Row, column: str, step: float) -> int:
    """A time in years that is a whole number of steps, at least one."""
    steps = row.number(column, step, 100.0) / step
    if abs(steps - round(steps)) > WHOLE:
        raise row.error(column, f"allowed is a whole number of steps of {years(step)}")
    return round(steps)


def _mean(row: Row) -> float:
    row.cells.setdefault("mean", "")
    return row.number("mean", -0.999, 1.0)


def _volatility(section: Section, row: Row, grid: Grid) -> Pieces:
    """A number, or the name of a CSV with columns from_year,value."""
    text = row.cells.setdefault("volatility", "")
    if text.lower().endswith(".csv"):
        file = Mention(section, "file", text)
        return pieces(text, lambda: read_rows(file, ("from_year", "value")), *grid[:2], 0.0)
    return pieces(row.number("volatility", 0.0, 5.0), list, *grid[:2], 0.0)


def _weights(section: Section, file: str, rows: Sequence[Row]) -> list[float]:
    weights = [row.number("weight", 0.0, 1.0) for row in rows]
    total = math.fsum(weights)
    if abs(total - 1) > WHOLE:
        got = Unquoted(f"weights that add up to {total:.6g}")
        raise section.error("file", got, f"the weights in {file} must add up to 1")
    return weights


def _groups(rows: Sequence[Row], classes: Sequence[AssetClass]) -> tuple[Group, ...]:
    """Groups in the order in which they appear; limits may stand in any of a group's rows."""
    found = []
    for name in dict.fromkeys(each.group for each in classes if each.group):
        members = tuple(i for i, each in enumerate(classes) if each.group == name)
        limits = []
        for column, default in (("group_low", 0.0), ("group_high", 1.0)):
            given = [rows[i] for i in members if rows[i].cells.get(column)]
            values = [row.number(column, 0.0, 1.0) for row in given]
            for row, value in zip(given, values):
                if value != values[0]:
                    raise row.error(column, f"the group {name} has {values[0]:g} further up")
            limits.append(values[0] if values else default)
        found.append(Group(name, members, limits[0], limits[1]))
    return tuple(found)


def _check_bounds(section: Section, rows, low, high, groups: Sequence[Group]) -> None:
    """There must be weights within all bounds that add up to one."""
    for row, least, most in zip(rows, low, high):
        if least > most:
            row.cells.setdefault("low", "")
            raise row.error("low", f"the lower bound must not exceed the upper one, {most:g}")
    least, most = float(low.sum()), float(high.sum())
    for group in groups:
        members = list(group.members)
        inside = float(low[members].sum()), float(high[members].sum())
        lower, upper = max(group.low, inside[0]), min(group.high, inside[1])
        if lower > upper + WHOLE:
            got = Unquoted(f"limits {group.low:g} to {group.high:g} of the group {group.name}")
            what = f"its classes together can weigh {inside[0]:g} to {inside[1]:g}"
            raise section.error("file", got, what)
        least += lower - inside[0]
        most += upper - inside[1]
    if least > 1 + WHOLE or most < 1 - WHOLE:
        got = Unquoted(f"bounds between which the weights add up to {least:g} to {most:g}")
        what = "within the bounds, the weights must be able to add up to 1"
        raise section.error("file", got, what)


def _column(
    name: str, rows: Sequence[Row], column: str, labels, unit: str, most: float = 1.0, least=0.0
) -> Given:
    """The numbers of a column that may be left out: then they are zero, and no input."""
    if column not in rows[0].cells:
        return empty(name, (len(rows),), unit)
    return listed(name, [number(row, column, 0.0, least, most) for row in rows], labels, unit)


def read_credit(section: Section, table: CreditTable | None) -> Credit:
    """Spreads by rating; none without the table."""
    names = ("spread", "mean_spread", "mean_reversion", "volatility", "default_loss")
    if table is None:
        return Credit((), *(empty(f"credit_{name}") for name in names))
    rows = read_rows(Mention(section, "file", table.file), ("rating", *names[:3]))
    ratings = unique(rows, "rating")

    def above(column: str) -> Given:
        values = [above_zero(row, column) for row in rows]
        return listed(f"credit_{column}", values, ratings, YEARLY)

    return Credit(
        names=ratings,
        spread=above("spread"),
        mean_spread=above("mean_spread"),
        mean_reversion=above("mean_reversion"),
        volatility=_column("credit_volatility", rows, "volatility", ratings, SQUARE_ROOT, 5.0),
        default_loss=_column("credit_default_loss", rows, "default_loss", ratings, YEARLY),
    )


def read_currencies(section: Section, table: CurrenciesTable | None) -> Currencies:
    """Foreign currencies; none without the table."""
    if table is None:
        names = ("volatility", "premium", "hedge_ratio", "hedge_cost")
        return Currencies((), *(empty(f"currency_{name}") for name in names))
    rows = read_rows(Mention(section, "file", table.file), ("currency", "volatility"))
    names = unique(rows, "currency")
    premium = "currency_premium"
    return Currencies(
        names=names,
        volatility=_column("currency_volatility", rows, "volatility", names, SQUARE_ROOT, 5.0),
        premium=_column(premium, rows, "premium", names, YEARLY, 1.0, -1.0),
        hedge_ratio=_column("currency_hedge_ratio", rows, "hedge_ratio", names, "1"),
        hedge_cost=_column("currency_hedge_cost", rows, "hedge_cost", names, YEARLY),
    )


def read_overlay(section: Section, table: OverlayTable | None, grid: Grid) -> Overlay | None:
    """Swaps by tenor bucket."""
    if table is None:
        return None
    rows = read_rows(Mention(section, "file", table.file), ("tenor", "notional", "low", "high"))
    rising(rows, "tenor")
    maturity = [whole_steps(row, "tenor", grid.step) for row in rows]
    labels = [years(steps * grid.step) for steps in maturity]
    low, high = (np.array([row.number(name) for row in rows]) for name in ("low", "high"))
    for row, least, most in zip(rows, low, high):
        if least > most:
            raise row.error("low", f"the lower limit must not exceed the upper one, {most:g}")
    notional = [row.number("notional") for row in rows]
    return Overlay(
        maturity=np.array(maturity, np.int64),
        notional=listed("overlay_notional", notional, labels, grid.currency),
        low=low,
        high=high,
        unit=table.unit,
        leverage=single("overlay_leverage", table.leverage),
        cost=_column("overlay_cost", rows, "cost", labels, "1"),
        collateral_stress=single("overlay_collateral_stress", table.collateral_stress, YEARLY),
    )
