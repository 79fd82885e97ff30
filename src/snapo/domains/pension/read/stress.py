"""Reads `[stress]`: shocks from a file. The lines of a scenario apply together.

A line moves one of these:

- A curve ("curve" or "break_even"). `label` is a tenor in years; between tenors the size is linear,
  and beyond them it is constant. Without a label all nodes move equally. "multiply" applies to
  annual rates, "add" to continuous rates.
- The price of assets ("price"). `label` is a class or a kind of classes.
- Any other input of the case, by its name and label.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.load import load
from snapo.case.plausible import CheckedNumbers
from snapo.case.table import TableContext, nearest, parse

from ..records.case import PensionCase
from ..records.inputs import every_given
from .cells import word
from .tables import StressTable

CURVES = ("curve", "break_even")


PRICE = "price"


@dataclass(frozen=True)
class Shock:
    """One line: "add" `size` in the input's unit, or "multiply" by 1 + `size`."""

    scenario: str
    target: str
    label: str
    kind: str
    size: float

    def of(self, values: np.ndarray, size: np.ndarray | float | None = None) -> np.ndarray:
        """The values after the shock; `size` replaces that of the line if it differs between
        values."""
        size = self.size if size is None else size
        return values + size if self.kind == "add" else values * (1 + size)


def read_shocks(case: PensionCase) -> tuple[Shock, ...]:
    """The shocks of the file that `[stress]` names; none without it."""
    return parse_shocks(case, load(case.file)[1].get("stress"))


def parse_shocks(case: PensionCase, data: Any) -> tuple[Shock, ...]:
    """The shocks of a table `[stress]` that was read already; none if there is no table."""
    if data is None:
        return ()
    table = parse(StressTable, data, str(case.file), "stress")
    reference = FileReference(TableContext(case.file, "stress", []), "file", table.file)
    rows = read_rows(reference, ("scenario", "input", "label", "kind", "size"))
    return tuple(_shock(case, row) for row in rows)


def shock_sizes(shocks: Iterable[Shock]) -> Iterator[CheckedNumbers]:
    """The sizes of shocks as numbers to be checked: shifts of curves, and factors."""
    for shock in shocks:
        value, label = np.array([shock.size]), (shock.scenario,)
        if shock.kind == "multiply":
            yield CheckedNumbers("stress factor", value, label)
        elif shock.target in CURVES:
            yield CheckedNumbers("stress shift", value, label, "1/year", "", "bp", 1e4)


def _shock(case: PensionCase, row: Row) -> Shock:
    target, label = row.cells["input"], row.label("label")
    if not row.cells["scenario"]:
        raise row.error("scenario", "every line must have the name of a scenario")
    values = {item.name: item for item in every_given(case)}
    available = (*CURVES, PRICE, *values)
    if target not in available:
        raise row.error("input", f"there is no such input; {nearest(target, available)}")
    if target in CURVES:
        if label:
            row.number("label", 0.0)
    elif target == PRICE:
        _held(case, row)
    elif label and label not in values[target].labels:
        labels = ", ".join(filter(None, values[target].labels))
        one_of = f"must be empty or one of the labels of {target}: {labels}"
        raise row.error(
            "label", one_of if labels else f"must be empty: {target} is a single number"
        )
    kind = word(row, "kind", ("add", "multiply"))
    if target == PRICE and kind != "multiply":
        raise row.error(
            "kind", 'for prices it must be "multiply": a size of -0.3 is a fall by 30 %'
        )
    size = row.number("size", -1.0 if kind == "multiply" else -np.inf)
    return Shock(row.cells["scenario"], target, label, kind, size)


def _held(case: PensionCase, row: Row) -> None:
    names = [n for class_ in case.assets.classes for n in (class_.name, class_.kind)]
    label = row.cells["label"]
    if label and label not in names:
        available = ", ".join(dict.fromkeys(names))
        raise row.error(
            "label", f"there is no such class or kind of classes; available: {available}"
        )
