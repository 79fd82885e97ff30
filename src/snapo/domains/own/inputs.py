"""`[inputs]`: numbers with units, in the file or in a CSV beside it, as differentiable inputs."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.csv import FileReference, read_rows
from snapo.case.error import CaseError
from snapo.case.given import FilePosition, positions
from snapo.case.plausible import CaseFiles, CheckedNumbers, Plausible, checked_numbers, implausible
from snapo.case.table import TableContext, parse
from snapo.problem.inputs import Input

from .tables import InputTable

ATTRIBUTES = {  # keys of the table that an input has, and the names that it has for them
    "unit": "unit", "words": "meaning", "group": "group", "bump": "bump", "move": "move",
    "trade_unit": "display_unit", "trade_factor": "display_factor",
}  # fmt: skip

APART = Plausible(-math.inf, math.inf, "", ratio=50.0)  # numbers in a row are not so far apart
PERCENT = re.compile("%|point|percent")


Positions = tuple[FilePosition, ...]


def read_inputs(
    tables: Mapping[str, Any], file: Path, notes: list[str]
) -> tuple[dict[str, Input], dict[str, Positions]]:
    """{name: input} in the order of the file, and {name: positions of its numbers}.

    `prepare` receives arrays under the same names.
    """
    pairs = {name: _input(name, table, file, notes) for name, table in tables.items()}
    inputs = {name: entry for name, (entry, _) in pairs.items()}
    entries = [checked_numbers(entry, name) for name, entry in inputs.items()]
    files = CaseFiles(file, {"inputs": tables})
    notes += implausible(entries, [*_shares(entries), APART], files).values()
    return inputs, {name: locations for name, (_, locations) in pairs.items()}


def _shares(entries: Sequence[CheckedNumbers]) -> Iterator[Plausible]:
    """The ranges of shares: those that are shown as percentage points, or in basis points."""
    for entry in entries:
        if entry.display_factor == 100 and PERCENT.search(entry.display_unit):
            hint = "a fraction is meant, of which the trade unit is a hundredth"
            yield Plausible(0.0, 5.0, hint, names=(entry.name,), ratio=APART.ratio, by_size=True)
        if entry.display_factor == 1e4 and entry.display_unit == "bp":
            hint = "a fraction is meant, 0.0001 is 1 bp"
            yield Plausible(0.0, 0.5, hint, names=(entry.name,), by_size=True)


def _input(name: str, data: Any, file: Path, notes: list[str]) -> tuple[Input, Positions]:
    where = f"inputs.{name}"
    if not isinstance(data, Mapping):
        message = f'an input is a table: {name} = {{ value = 60, unit = "hm3" }}'
        raise CaseError(str(file), where, data, message)
    table = parse(InputTable, data, str(file), where)
    if table.move == 0:
        raise CaseError(str(file), f"{where}.move", 0.0, "allowed is a number other than 0")
    section = TableContext(file, where, notes)
    values, labels, locations = (_from_csv if table.file else _in_file)(section, table)
    attributes = {name: getattr(table, key) for key, name in ATTRIBUTES.items()}
    return Input(values, labels=labels, **attributes), locations


InputParts = tuple[np.ndarray, tuple[str, ...], Positions]


def _in_file(section: TableContext, table: InputTable) -> InputParts:
    """The numbers under `value`, any shape."""
    if table.value is None:
        message = 'this key is missing; give value = 60, or file = "x.csv" with column = "price"'
        raise section.error("value", None, message)
    for key in ("column", "label"):
        if getattr(table, key) is not None:
            raise section.error(key, getattr(table, key), "it belongs to a file, not to a value")
    try:
        values = np.array(table.value, np.float64)
    except ValueError:
        raise section.error("value", table.value, "all rows must have the same length") from None
    labels = tuple(table.labels or ())
    if labels and len(labels) != values.size:
        message = f"there are {values.size} numbers; give each one label"
        raise section.error("labels", table.labels, message)
    return values, labels, positions((*section.keys, "value"), values.shape)


def _from_csv(section: TableContext, table: InputTable) -> InputParts:
    """The numbers of a column, with the texts of another one as labels."""
    assert table.file is not None
    if table.value is not None:
        raise section.error("value", table.value, "an input has a value or a file, not both")
    if table.labels is not None:
        raise section.error("labels", table.labels, "a file labels its numbers by a column: label")
    if not table.column:
        raise section.error("column", table.column, "allowed is the name of a column of the file")
    column, label = table.column.lower(), (table.label or "").lower()
    rows = read_rows(FileReference(section, "file", table.file), [c for c in (column, label) if c])
    values = np.array([row.number(column) for row in rows])
    labels = tuple(row.label(label) for row in rows) if label else ()
    return values, labels, tuple(row.position(column) for row in rows)
