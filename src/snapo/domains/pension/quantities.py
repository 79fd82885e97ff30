"""The quantities of a pension case, with their units, ranges, standard moves and groups.

The standard moves are those of an actuary: one basis point for rates, spreads and fees; one
percentage point for shares, volatilities and ratios; a relative change of one per cent for
quantities (money, members, death probabilities). Groups, which reports and readers use: "curve"
(nodes of a curve), "volatility", "premium" (used in the real world only), "model", "assets",
"overlay", "people", "plan". The unit "money" is the currency of the case.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from snapo.case.csv import Row
from snapo.case.given import CaseInput, NoPosition
from snapo.case.quantity import (
    FRACTION,
    NOT_NEGATIVE,
    POSITIVE,
    KeyContext,
    Quantity,
    Range,
    stacked,
)
from snapo.case.table import CaseTable, doc

from .read.cells import NEVER, TimeGrid, empty, rising, years

SQUARE_ROOT, YEARLY = "1/sqrt(year)", "1/year"
YEARLY_RATE = Range(-1.0, 1.0, "()", ", like 0.02 for 2 %")
MONEY_YEARLY = Range(0.0, noun="money per year")
FROM_YEAR, BY_AGE = "from_year", "sex,age"


@dataclass(frozen=True)
class FundQuantity(Quantity):
    """A number of a fund; each row of its CSV applies from its "from_year" on, or from its age on
    (columns "sex,age", which another reader handles).

    - `blank`: the number that an empty cell means, if a cell may be empty.
    - `by_factor`: whether a list has one number for each factor of a model.
    """

    blank: float | None = None
    by_factor: bool = False

    @property
    def allowed(self) -> str:
        return f"{super().allowed}{'; a list with one number for each factor' * self.by_factor}"

    def of(self, group: str, **changes: Any) -> Self:
        """The quantity in a group of inputs."""
        return replace(self, group=group, **changes)

    def __get_pydantic_json_schema__(self, *more: Any) -> dict[str, Any]:
        one = super().__get_pydantic_json_schema__(*more)
        return {"anyOf": [one, {"type": "array", "items": one}]} if self.by_factor else one

    def in_column(self, column: str, meaning: str, **changes: Any) -> Self:
        """The quantity of a column of a CSV."""
        return replace(self, column=column, meaning=meaning, **changes)

    def cell(self, row: Row) -> float:
        if self.blank is not None and not row.cells.get(self.column):
            return self.blank
        return super().cell(row)

    def read(self, raw: Any, key: KeyContext) -> Any:
        if self.by == BY_AGE and isinstance(raw, str) and raw:
            return raw
        if not self.by_factor:
            return super().read(raw, key)
        if not isinstance(raw, list):
            return (super().read(raw, key),)
        one = replace(self, by_factor=False)
        parts: list[CaseInput] = [one.read(item, key) for item in raw]
        return tuple(
            part if isinstance(item, str) else replace(part, positions=((*key.path, i),))
            for i, (item, part) in enumerate(zip(raw, parts))
        )

    def from_dated_rows(self, name: str, rows: Sequence[Row]) -> CaseInput:
        """The numbers of rows from_year,value; `starts` are years from now."""
        begins = rising(rows, self.by, -NEVER)
        if begins[0] > NEVER:
            raise rows[0].error(self.by, "the first value must apply from year 0 on")
        return self.from_rows(name, rows, [f"from {years(b)}" for b in begins], starts=begins)

    def column_of(self, name: str, rows: Sequence[Row], labels: Sequence[str]) -> CaseInput:
        """The numbers of an optional column; without the column they are zero, and not an input."""
        if not rows or self.column not in rows[0].cells:
            return empty(name, (len(rows),))
        return self.from_rows(name, rows, labels)


RATE = FundQuantity(YEARLY, YEARLY_RATE, move=1e-4, display_unit="bp", display_factor=1e4)
SHARE = FundQuantity(
    "1", FRACTION, move=0.01, display_unit="percentage point", display_factor=100.0
)
VOLATILITY = replace(SHARE, unit=SQUARE_ROOT, range=NOT_NEGATIVE, group="volatility")
# Of rates and growth: a percentage point would double it.
QUIET_VOLATILITY = replace(VOLATILITY, move=1e-3, display_unit="bp", display_factor=1e4)
NUMBER = FundQuantity(move=0.01)
AMOUNT = FundQuantity("money", NOT_NEGATIVE)
TIME = FundQuantity("year", POSITIVE, move=1.0, display_unit="year")


def plain(meaning: str, allowed: Range, default: Any = ...) -> Any:
    """A field for a number that is not an input: it has no gradient."""
    lower, upper = (
        ("gt" if allowed.endpoints[0] == "(" else "ge"),
        ("lt" if allowed.endpoints[1] == ")" else "le"),
    )
    limits: dict[str, Any] = {lower: allowed.low, upper: allowed.high}
    limits = {key: limit for key, limit in limits.items() if math.isfinite(limit)}
    return doc(meaning, default, str(allowed), **limits)


def input_of(table: CaseTable, key: str, prefix: str, currency: str = "money") -> CaseInput:
    """The numbers of a key with the name of their input, in the currency of the case."""
    numbers: CaseInput = getattr(table, key)
    unit = numbers.unit.replace("money", currency)
    return replace(numbers, name=f"{prefix}_{key}", unit=unit)


def on_steps(numbers: CaseInput, grid: TimeGrid) -> CaseInput:
    """Numbers on the steps of the horizon, index [T]. Numbers that begin after the horizon are
    omitted."""
    if numbers.starts is None:
        return replace(numbers, index=np.zeros(grid.steps, np.int64))
    times = np.arange(grid.steps) * grid.step
    index = np.searchsorted(numbers.starts, times + NEVER, side="right") - 1
    used = int(index[-1]) + 1
    parts = {key: getattr(numbers, key)[:used] for key in ("values", "labels", "positions")}
    return replace(numbers, **parts, starts=numbers.starts[:used], index=index)


def side_by_side(name: str, parts: Sequence[CaseInput], names: Sequence[str]) -> CaseInput:
    """Several numbers that change over time, as one input with the index [T, len(parts)]."""
    labels = [f"{n} {label}".strip() for n, x in zip(names, parts) for label in x.labels]
    numbers = replace(stacked(name, parts), labels=tuple(labels))
    if len(set(numbers.positions)) == len(labels):
        return numbers
    reason = (
        "the files of the case have one number for several of these numbers, so they cannot "
        "be changed separately"
    )
    return replace(numbers, positions=(NoPosition(reason),) * len(labels))
