"""Reads `[curve]`: quotes at nodes; break-evens have the same form."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from snapo.case.csv import Mention, Row, read_rows

from ..records.market import Curve
from ..records.said import Said, rate
from .cells import Place, empty, listed, rising, single, years
from .tables import CurveTable, InflationTable

HELD = "Market values of assets today, prices of risk and excess returns are held"
ZERO = rate(
    "KR01: the zero rate at one node, between nodes linearly; the sum of all nodes is"
    f" a parallel shift. {HELD}",
    "curve",
)
FORWARD = rate(
    f"KR01: the forward rate of one interval; the sum of all is a parallel shift. {HELD}", "curve"
)
ULTIMATE = rate("the forward rate far beyond the last node", "model")


class Quotes(NamedTuple):
    """Where a curve stands: the key and the name of its file; by column the name of the input and
    its meaning; the name of the rate far out."""

    key: str
    file: str
    columns: Mapping[str, tuple[str, Said]]
    far: str


def read_curve(section: Place, table: CurveTable) -> Curve:
    """The nominal curve; inputs "zero_rate" or "forward_rate"."""
    columns = {"zero": ("zero_rate", ZERO), "forward": ("forward_rate", FORWARD)}
    return quotes(section, table, Quotes("file", table.file, columns, "ultimate_forward"))


def quotes(section: Place, table: CurveTable | InflationTable, given: Quotes) -> Curve:
    """Nodes from a CSV whose second column says which rate is quoted."""
    rows = read_rows(Mention(section, given.key, given.file), ("tenor",))
    column = _quoted(rows, tuple(given.columns))
    tenor = rising(rows, "tenor")
    # A rate of 1 is 100 % a year: larger ones are percentages that were not divided by 100.
    rates = np.array([row.number(column, -0.999, 1.0) for row in rows])
    if table.compounding == "annual":
        rates = np.log1p(rates)
        text = "annual rates were made continuous; sensitivities are per continuous rate."
        section.notes.append(f"{given.file}: {text}")
    if (table.ultimate is None) != (table.extrapolation == "flat-forward"):
        what = 'extrapolation "ultimate" needs this key, "flat-forward" has no use for it'
        raise section.error("ultimate", table.ultimate, what)
    far = empty(given.far, ())
    if table.ultimate is not None:
        far = single(given.far, table.ultimate, ULTIMATE)
    name, said = given.columns[column]
    return Curve(
        tenor=tenor,
        rate=listed(name, rates.tolist(), [years(t) for t in tenor], said),
        quote="forward" if column == "forward" else "zero",
        extrapolation=table.extrapolation,
        ultimate=far,
        speed=table.speed,
    )


def _quoted(rows: list[Row], columns: tuple[str, ...]) -> str:
    present = [each for each in columns if each in rows[0].cells]
    if len(present) != 1:
        got = f"the columns {', '.join(rows[0].cells)}"
        row = Row(rows[0].file, 1, {"header": got})
        raise row.error("header", f"exactly one of the columns {' and '.join(columns)} is needed")
    return present[0]
