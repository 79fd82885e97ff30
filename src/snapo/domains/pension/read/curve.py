"""Reads `[curve]`, `[rates]` and `[inflation]`: quotes at nodes, and the models around them; and
`[correlations]`: a square matrix with names, checked, and repaired only when asked.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import Unquoted
from snapo.case.given import CaseInput, ConvertedNumber, Copies, FilePosition, NoPosition
from snapo.case.quantity import Range
from snapo.case.table import TableContext, nearest, parse
from snapo.problem.record.either import with_numpy, xp

from ..market.correlation import check_correlation
from ..market.correlation import nearest as nearest_correlation
from ..market.rates.short_rate import ShortRate
from ..market.registry import MODELS
from ..market.smith_wilson import MAXIMUM, cash_flows, distance, fit, log_bond
from ..quantities import NUMBER, RATE, FundQuantity, on_steps
from ..records.market import Correlation, Inflation, MarketCurve
from ..records.people import PAYMENT_YEARS
from .cells import NEVER, TableReader, TimeGrid, empty, rising, unique, years
from .tables import CorrelationsTable, CurveTable, InflationTable, RatesTable

SPEED = 0.1  # towards an ultimate rate, if the case does not say
QUOTES: dict[str, Literal["forward", "swap"]] = {"forward": "forward", "swap": "swap"}
PERIOD, EARLIEST = 40.0, 60.0  # years from the last liquid tenor to convergence, and its earliest
HELD = "Today's market values of assets, prices of risk and excess returns are held fixed"
# A rate of 1 is 100 % a year: larger ones are percentages that were not divided by 100.
NODE = RATE.of("curve", range=Range(-0.999, 1.0))
ZERO = NODE.in_column(
    "zero",
    "KR01: a move of the zero rate at one node, linear between nodes; the sum of all nodes is a "
    f"parallel shift. {HELD}",
)
SWAP = NODE.in_column(
    "swap", f"KR01: a move of the par swap rate of one tenor, with the others fixed. {HELD}"
)
FORWARD = NODE.in_column(
    "forward",
    f"KR01: a move of the forward rate of one interval; the sum of all is a parallel shift. {HELD}",
)
BREAK_EVEN = NODE.in_column(
    "rate", "IE01: a move of the break-even at one node, while nominal rates are held fixed"
)
# Ready-made scenarios need no model: this one is at rest.
IDLE = {"kind": "hull-white", "mean_reversion": 0.1, "volatility": 0.0}


class RateQuotes(NamedTuple):
    """The quotes of a curve: the `key` and the name of its `file`; its `inputs` by name, each with
    a separate column; and the name of the ultimate rate (`far`)."""

    key: str
    file: str
    inputs: Sequence[tuple[str, FundQuantity]]
    far: str


def read_curve(section: TableReader, table: CurveTable) -> MarketCurve:
    """The nominal curve; inputs "zero_rate", "forward_rate" or "swap_rate"."""
    annual = table.compounding == "annual"
    rates = (("zero_rate", ZERO), ("forward_rate", FORWARD), ("swap_rate", SWAP))
    curve = quotes(
        section, table, RateQuotes("file", table.file, rates, "ultimate_forward"), annual
    )
    return _smith_wilson(section, table, curve)


def _smith_wilson(section: TableReader, table: CurveTable, curve: MarketCurve) -> MarketCurve:
    """The curve with the numbers of the method; a curve of another method is unchanged.

    **Raises:** `CaseError` if keys or quotes do not suit the method, if no speed converges,
    or if the price of a bond would not be above 0.
    """
    if curve.extrapolation != "smith-wilson":
        if curve.quote == "swap":
            message = 'a column "swap" is allowed with "smith-wilson" only'
            raise section.error("extrapolation", curve.extrapolation, message)
        return curve
    last = float(curve.tenor[-1])
    if curve.quote == "forward":
        message = 'with "smith-wilson" a column zero or swap is needed'
        raise section.error("file", table.file, message)
    if curve.quote == "swap" and np.any(np.abs(curve.tenor - np.round(curve.tenor)) > NEVER):
        raise section.error(
            "file", table.file, "swaps pay every year, so tenors must be whole years"
        )
    convergence = table.convergence or max(last + PERIOD, EARLIEST)
    if convergence <= last:
        raise section.error(
            "convergence", convergence, f"it must be above the last tenor, {last:g}"
        )
    complete = np.round(curve.tenor) if curve.quote == "swap" else curve.tenor
    curve = replace(curve, tenors=complete, speed=table.speed, convergence=convergence)
    _possible(section, table, curve)
    return curve


def _possible(section: TableReader, table: CurveTable, curve: MarketCurve) -> None:
    def price_all(rate, ultimate):
        result = fit(curve, rate, ultimate)
        dates, flows = cash_flows(curve, rate)
        local = xp.exp(-ultimate * dates)[:, None] * flows.T
        prices = log_bond(curve, rate, ultimate, np.arange(1.0, PAYMENT_YEARS + 61))
        return result.speed, distance(dates, local, result.speed, curve.convergence), prices

    values = curve.rate.used(), curve.ultimate.used()
    speed, missed, prices = with_numpy(price_all)(*values)
    if not np.isfinite(prices).all():
        message = (
            "there is no Smith-Wilson curve with positive prices for these quotes and this speed"
        )
        raise section.error("file", table.file, message)
    if table.speed is None and missed > 1e-6:
        message = (
            f"no speed up to {MAXIMUM:g} brings the forward rate within a basis point of the "
            "ultimate rate by then"
        )
        raise section.error("convergence", curve.convergence, message)
    if table.speed is None:
        section.notes.append(
            f"{table.file}: Smith-Wilson with a speed of {float(speed):.6f}, chosen so that the "
            f"forward rate at {curve.convergence:g} years is within a basis point of the "
            "ultimate rate; in sensitivities the speed changes with the quotes."
        )


def quotes(
    section: TableReader, table: CurveTable | InflationTable, values: RateQuotes, annual: bool
) -> MarketCurve:
    """Nodes from a CSV whose second column is the quoted rate."""
    rows = read_rows(FileReference(section, values.key, values.file), ("tenor",))
    name, quantity = _quoted(rows, values.inputs)
    column, rows = quantity.column, _liquid(section, table, rows)
    tenor = rising(rows, "tenor")
    rates = quantity.from_rows(name, rows, [years(t) for t in tenor])
    if annual and column != "swap":
        rates = _continuous(rates)
        text = "annual rates are converted, so sensitivities refer to continuous rates."
        section.notes.append(f"{values.file}: {text}")
    if (table.ultimate is None) != (table.extrapolation == "flat-forward"):
        message = 'all values of extrapolation except "flat-forward" need this key'
        stated = None if table.ultimate is None else table.ultimate.written
        raise section.error("ultimate", stated, message)
    far = empty(values.far, ())
    if table.ultimate is not None:
        far = _continuous(table.ultimate) if annual else table.ultimate
    return MarketCurve(
        tenors=tenor,
        rate=rates,
        quote=QUOTES.get(column, "zero"),
        extrapolation=table.extrapolation,
        ultimate=far,
        speed=SPEED if table.speed is None else table.speed,
    )


def _continuous(annual: CaseInput) -> CaseInput:
    """Annual rates as continuous ones."""
    located = tuple(ConvertedNumber(position, np.log1p, np.expm1) for position in annual.positions)
    return replace(annual, values=np.log1p(annual.values), positions=located)


def _liquid(section: TableReader, table: CurveTable | InflationTable, rows: list[Row]) -> list[Row]:
    """The rows up to the last liquid tenor, if the case names one."""
    last = getattr(table, "last_liquid", None)
    if last is None:
        return rows
    selected = [row for row in rows if row.number("tenor") <= last]
    if not selected or selected[-1].number("tenor") != last:
        raise section.error("last_liquid", last, "no row of the file has this tenor")
    return selected


def _quoted(
    rows: list[Row], inputs: Sequence[tuple[str, FundQuantity]]
) -> tuple[str, FundQuantity]:
    columns = [quantity.column for _, quantity in inputs]
    present = [entry for entry, column in zip(inputs, columns) if column in rows[0].cells]
    if len(present) != 1:
        got = f"the columns {', '.join(rows[0].cells)}"
        row = Row(rows[0].file, 1, {"header": got})
        raise row.error("header", f"exactly one of the columns {', '.join(columns)} is needed")
    return present[0]


def read_rates(section: TableReader, table: RatesTable | None, grid: TimeGrid) -> ShortRate:
    """The model with its numbers; without the table, a model without any motion."""
    if table is None:
        table = parse(RatesTable, IDLE, str(section.file), section.name)
    if table.kind not in MODELS:
        available = ", ".join(f'"{model}"' for model in sorted(MODELS))
        message = f"it must be one of {available}; {nearest(table.kind, sorted(MODELS))}"
        raise section.error("kind", table.kind, message)
    return MODELS[table.kind].read(section, table, grid)


def read_inflation(
    section: TableReader, table: InflationTable, grid: TimeGrid, compounding: str
) -> Inflation:
    """Break-evens under "break_even", and the models of prices and wages; `compounding`: the
    compounding of the rates of the case, by default."""
    annual = (table.compounding or compounding) == "annual"

    def input(key: str) -> CaseInput:
        return section.input(table, key, getattr(table, key))

    def moving(key: str) -> CaseInput:
        return on_steps(input(key), grid)

    forward = replace(BREAK_EVEN, column="forward")
    rates = (("break_even", BREAK_EVEN), ("break_even", forward))
    values = RateQuotes("break_evens", table.break_evens, rates, "ultimate_break_even")
    growth = input("real_wage_growth")
    return Inflation(
        break_even=quotes(section, table, values, annual),
        mean_reversion=input("mean_reversion"),
        volatility=moving("volatility"),
        price_of_risk=input("price_of_risk"),
        index_volatility=moving("index_volatility"),
        index_price_of_risk=input("index_price_of_risk"),
        real_wage_growth=_continuous(growth) if annual else growth,
        wage_volatility=input("wage_volatility"),
    )


CORRELATION = NUMBER.of(
    "model", meaning="a correlation, which moves together with its mirror entry"
)
SMALLEST = 1e-8  # eigenvalue that a matrix must have to count as positive definite
EQUAL = 1e-9


def read_correlations(
    section: TableContext, table: CorrelationsTable | None, available: Sequence[str]
) -> Correlation:
    """The matrix that `table` names; without a table, everything is independent."""
    folded = [name.lower() for name in available]
    for i, name in enumerate(folded):
        if name in folded[:i]:
            message = "ratings, currencies and classes with a separate shock need different names"
            raise section.error("file", available[i], message)
    if table is None:
        return Correlation((), empty("correlation"))
    rows = read_rows(FileReference(section, "file", table.file), ("name",))
    names = _names(rows, available, folded)
    matrix = _matrix(rows)
    smallest, change = check_correlation(matrix), 0.0
    if smallest < SMALLEST:
        if not table.repair:
            got = Unquoted(f"a matrix whose smallest eigenvalue is {smallest:.3g}")
            message = (
                "a correlation matrix must be positive definite; repair = true uses the nearest "
                "such matrix"
            )
            raise section.error("file", got, message)
        matrix, change = nearest_correlation(matrix)
        section.notes.append(
            f"{table.file} is not positive definite (smallest eigenvalue {smallest:.3g}); the "
            "nearest positive definite matrix is used instead, whose entries differ by at most "
            f"{change:.3g}."
        )
    below = np.tril_indices(len(names), -1)
    labels = [f"{names[i]}, {names[j]}" for i, j in zip(*below)]
    columns = [name.lower() for name in names]
    positions: list[FilePosition] = [rows[i].position(columns[j]) for i, j in zip(*below)]
    for k, (i, j) in enumerate(zip(*below)):
        if rows[j].cells[columns[i]]:
            positions[k] = Copies((positions[k], rows[j].position(columns[i])))
    if change:
        reason = f"the matrix of {table.file} was repaired, so the case uses other numbers"
        positions = [NoPosition(reason)] * len(positions)
    located = tuple(positions)
    return Correlation(
        names, CORRELATION.input("correlation", matrix[below], labels, positions=located), change
    )


def _names(rows: Sequence[Row], available: Sequence[str], folded: Sequence[str]) -> tuple[str, ...]:
    """The names of the rows, which must be those of the columns in the same order."""
    unique(rows, "name")
    names = []
    for row in rows:
        name = row.cells["name"].lower()
        if name not in folded:
            raise row.error(
                "name",
                f"there is no random quantity of this name; available: {', '.join(available)}",
            )
        names.append(available[folded.index(name)])
    columns = [column for column in rows[0].cells if column != "name"]
    if columns != [name.lower() for name in names]:
        head = Row(rows[0].file, 1, {"header": f"the columns {', '.join(columns)}"})
        message = f"the columns must have the names and the order of the rows: {', '.join(names)}"
        raise head.error("header", message)
    return tuple(names)


def _matrix(rows: Sequence[Row]) -> np.ndarray:
    """[k, k], ones on the diagonal and symmetric; cells above the diagonal may be empty."""
    columns = [row.cells["name"].lower() for row in rows]
    matrix = np.eye(len(rows))
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            if j > i and not row.cells[column]:
                continue
            value = row.number(column, -1.0, 1.0)
            if i == j and value != 1:
                raise row.error(column, "a number on the diagonal must be 1")
            if j < i:
                matrix[i, j] = matrix[j, i] = value
    for i, row in enumerate(rows):
        for j in range(i + 1, len(rows)):
            text = row.cells[columns[j]]
            if text and abs(float(text) - matrix[i, j]) > EQUAL:
                message = f"the matrix must be symmetric, and the mirror entry is {matrix[i, j]:g}"
                raise row.error(columns[j], message)
    return matrix
