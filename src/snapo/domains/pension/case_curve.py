"""Reads `[curve]`, `[rates]` and `[inflation]`: curves at their nodes, and what moves them."""

import numpy as np

from snapo.case.csv import Mention, Row, read_rows
from snapo.case.given import Given
from snapo.case.table import Section

from .cells import (
    Pieces,
    alone,
    empty,
    listed,
    rising,
    side_by_side,
    single,
    stepwise,
    years,
)
from .records import Curve, Inflation, RateModel
from .tables import CurveTable, InflationTable, RatesTable

SQUARE_ROOT, YEARLY = "1/sqrt(year)", "1/year"
FACTORS = {"hull-white": ("rate",), "g2++": ("rate", "rate 2")}


def read_curve(section: Section, table: CurveTable) -> Curve:
    """The nominal curve; inputs "zero_rate" or "forward_rate"."""
    names = {"zero": "zero_rate", "forward": "forward_rate"}
    return _curve(section, "file", table.file, table, names, "ultimate_forward")


def read_inflation(section: Section, table: InflationTable, steps: int, step: float) -> Inflation:
    """Break-evens under "break_even", and the numbers of expected and realised inflation."""
    names = {"rate": "break_even", "forward": "break_even"}
    given = (section, "break_evens", table.break_evens, table)

    def moving(name: str, key: str) -> Given:
        part = stepwise(section, key, getattr(table, key), steps, step)
        return alone(name, SQUARE_ROOT, part)

    return Inflation(
        break_even=_curve(*given, names, "ultimate_break_even"),
        mean_reversion=single("inflation_mean_reversion", table.mean_reversion, YEARLY),
        volatility=moving("inflation_volatility", "volatility"),
        price_of_risk=single("inflation_price_of_risk", table.price_of_risk, SQUARE_ROOT),
        index_volatility=moving("index_volatility", "index_volatility"),
        index_price_of_risk=single("index_price_of_risk", table.index_price_of_risk, SQUARE_ROOT),
        real_wage_growth=single("real_wage_growth", table.real_wage_growth, YEARLY),
        wage_volatility=single("wage_volatility", table.wage_volatility, SQUARE_ROOT),
    )


def _curve(section: Section, key: str, file: str, table, names: dict[str, str], far: str) -> Curve:
    """Nodes from a CSV whose second column says what is quoted."""
    rows = read_rows(Mention(section, key, file), ("tenor",))
    column = _quoted(rows, tuple(names))
    tenor = rising(rows, "tenor")
    # A rate of 1 is 100 % a year: larger ones are percentages that were not divided by 100.
    rates = np.array([row.number(column, -0.999, 1.0) for row in rows])
    if table.compounding == "annual":
        rates = np.log1p(rates)
        text = f"{file}: annual rates were made continuous; sensitivities are per continuous rate."
        section.notes.append(text)
    if (table.ultimate is None) != (table.extrapolation == "flat-forward"):
        what = 'extrapolation "ultimate" needs this key, "flat-forward" has no use for it'
        raise section.error("ultimate", table.ultimate, what)
    known = table.ultimate is not None
    return Curve(
        tenor=tenor,
        rate=listed(names[column], rates.tolist(), [years(t) for t in tenor], YEARLY),
        quote="forward" if column == "forward" else "zero",
        extrapolation=table.extrapolation,
        ultimate=single(far, table.ultimate, YEARLY) if known else empty(far, ()),
        speed=table.speed,
    )


def _quoted(rows: list[Row], columns: tuple[str, ...]) -> str:
    present = [each for each in columns if each in rows[0].cells]
    if len(present) != 1:
        got = f"the columns {', '.join(rows[0].cells)}"
        row = Row(rows[0].file, 1, {"header": got})
        raise row.error("header", f"exactly one of the columns {' and '.join(columns)} is needed")
    return present[0]


def read_rates(section: Section, table: RatesTable, steps: int, step: float) -> RateModel:
    """Hull-White or G2++; numbers per factor, volatilities that may change in time."""
    names = FACTORS[table.kind]
    count = len(names)

    def each(key: str) -> list:
        value = getattr(table, key)
        found = value if isinstance(value, list) else [value]
        # No price of risk is none for either factor.
        found = found * count if found == [0.0] else found
        if len(found) != count:
            what = f'kind "{table.kind}" needs {count} of them, one per factor'
            raise section.error(key, value, what)
        return found

    parts: list[Pieces] = [
        stepwise(section, "volatility", given, steps, step) for given in each("volatility")
    ]
    labels = [""] if count == 1 else list(names)
    return RateModel(
        kind=table.kind,
        mean_reversion=listed("rate_mean_reversion", each("mean_reversion"), labels, YEARLY),
        volatility=side_by_side("rate_volatility", SQUARE_ROOT, parts, labels),
        price_of_risk=listed("rate_price_of_risk", each("price_of_risk"), labels, SQUARE_ROOT),
    )


def no_rates(steps: int) -> RateModel:
    """The model that supplied scenarios do without: one factor that stands still."""
    return RateModel(
        kind="hull-white",
        mean_reversion=listed("rate_mean_reversion", [0.1], [""], YEARLY),
        volatility=Given(
            "rate_volatility", np.zeros(1), ("",), SQUARE_ROOT, np.zeros((steps, 1), np.int64)
        ),
        price_of_risk=listed("rate_price_of_risk", [0.0], [""], SQUARE_ROOT),
    )
