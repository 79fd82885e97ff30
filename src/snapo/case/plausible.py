"""Ranges outside which a number is likely to be in another unit; such a number gets a note and is
never refused.

A domain declares `Plausible` ranges by name, or by group and unit; `implausible` checks the numbers
of a case. It writes one note for each input with a number outside of its range or, on a curve, far
from its neighbours.

    RATE = Plausible(-0.02, 0.2, "a fraction is expected (0.02 is 2 %)", group="interest rate")
    notes = implausible(inputs, [RATE], CaseFiles(file, data)).values()

Zero is the same number in every unit, and gets no note. The position of a number is the cell of the
case's files that contains the number and resembles the name and label of its input.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .csv import NUMBER, FileReference, read_rows
from .error import CaseError
from .given import (
    ConvertedNumber,
    Copies,
    FilePosition,
    KeyedUnit,
    NoPosition,
    QuantityKey,
    SheetCell,
)
from .table import TableContext

AROUND = 4  # neighbours along a curve with which a number is compared
FRACTION = "a fraction is expected (0.02 is 2 %)"
EXACT = 1e-9  # relative, between a number and its text
TABLES = (".csv", ".parquet")
LARGEST = 4 << 20  # bytes of a table in which a number is looked up


class CheckedNumbers(NamedTuple):
    """The numbers of an input, in the form that all checks of this module use.

    - `values`: [n]; `labels`: [n], "" for a single number. `written`: [n] the numbers as in the
      case's files.
    - `display_unit`: the unit that the trade uses; one `unit` is `display_factor` display units.
    - `source`: the input from which the numbers are made; if that input has a note, these numbers
      get none.
    - `range`: the plausible range in the declaration; `positions`: [n] the positions of the
      numbers, if recorded.
    """

    name: str
    values: np.ndarray
    labels: tuple[str, ...]
    unit: str = ""
    group: str = ""
    display_unit: str = ""
    display_factor: float = 1.0
    written: np.ndarray | None = None
    source: str = ""
    range: "Plausible | None" = None
    positions: tuple[Any, ...] = ()


def checked_numbers(entry: Any, name: str = "") -> CheckedNumbers:
    """The numbers of an input of a case or of a simulator; `name` if it has none."""
    if isinstance(entry, CheckedNumbers):
        return entry
    values = entry.values if hasattr(entry, "values") else entry.value
    values = np.asarray(values, np.float64).ravel()
    labels = tuple(entry.labels)
    if not labels:
        labels = ("",) if values.size == 1 else tuple(map(str, range(values.size)))
    return CheckedNumbers(
        getattr(entry, "name", "") or name,
        values,
        labels,
        entry.unit,
        entry.group,
        getattr(entry, "display_unit", ""),
        getattr(entry, "display_factor", 1.0),
        range=getattr(getattr(entry, "quantity", None), "plausible", None),
        positions=getattr(entry, "positions", ()),
    )


@dataclass(frozen=True)
class Plausible:
    """The range of a kind of numbers, in the unit of the input.

    It applies to the inputs that satisfy all the fields that are set: a name among `names`, this
    `group`, this `unit`, and a name that has one of the `endings`.

    - `hint`: a clause on the unit that is expected.
    - `ratio`: the largest ratio between a number and its neighbours along the curve.
    - `by_size`: whether the range is for absolute values, because the sign has another meaning.
    """

    low: float
    high: float
    hint: str
    names: tuple[str, ...] = ()
    group: str = ""
    unit: str = ""
    endings: tuple[str, ...] = ()
    ratio: float = math.inf
    by_size: bool = False

    def fits(self, entry: CheckedNumbers) -> bool:
        """Whether the range applies to this input."""
        return (
            (not self.names or entry.name in self.names)
            and self.group in ("", entry.group)
            and self.unit in ("", entry.unit)
            and (not self.endings or entry.name.endswith(self.endings))
        )

    def outside(self, values: np.ndarray) -> np.ndarray:
        """The indices of the numbers outside of the range."""
        size = np.abs(values) if self.by_size else values
        return np.flatnonzero(~((size >= self.low) & (size <= self.high)) & (values != 0))


def implausible(
    entries: Iterable[Any], ranges: Sequence[Plausible], files: "CaseFiles"
) -> dict[str, str]:
    """{name: note} of the inputs with implausible numbers.

    The range of an input is the one in its declaration or else the first of `ranges` that fits.
    """
    notes: dict[str, str] = {}
    for entry in map(checked_numbers, entries):
        range_ = entry.range or next((item for item in ranges if item.fits(entry)), None)
        if range_ is None or entry.name in notes or entry.source in notes:
            continue
        note = _outside(entry, range_, files) or _apart(entry, range_, files)
        if note:
            notes[entry.name] = note
    return notes


def _outside(entry: CheckedNumbers, range_: Plausible, files: "CaseFiles") -> str:
    """The note on numbers outside of the range; "" if there are none."""
    rows = range_.outside(entry.values)
    if not rows.size:
        return ""
    low, high = (_plain(x * entry.display_factor) for x in (range_.low, range_.high))
    if math.isinf(range_.high):
        limits = f"below {low}"
    elif math.isinf(range_.low):
        limits = f"above {high}"
    else:
        limits = f"outside {low} to {high}"
    limits = f"{limits} {_unit(entry)}".rstrip() + more(rows.size - 1, " of its numbers")
    return f"{_start(entry, int(rows[0]), files)}, {limits}: {range_.hint}."


def _apart(entry: CheckedNumbers, range_: Plausible, files: "CaseFiles") -> str:
    """The note on the number that is the farthest from its neighbours; "" if none is too far."""
    if math.isinf(range_.ratio):
        return ""
    usual = around(entry.values)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.abs(np.log(entry.values / usual))
    gap = np.where(np.isfinite(gap), gap, 0.0)
    row = int(np.argmax(gap)) if gap.size else 0
    if not gap.size or gap[row] <= math.log(range_.ratio):
        return ""
    near = f"{_plain(usual[row] * entry.display_factor)} {_unit(entry)}".rstrip()
    return (
        f"{_start(entry, row, files)}, {entry.values[row] / usual[row]:.3g} times its "
        f"neighbours, which are about {near}: is it in the same unit?"
    )


def around(values: np.ndarray) -> np.ndarray:
    """[n] the median of the neighbours along a curve; equal numbers in a row count once.

    If there are at most three numbers, the result is the median of all the others.
    """
    if not values.size:
        return values
    first = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    runs = values[first]
    usual = np.full(runs.size, np.nan)
    for i in range(runs.size):
        window = range(max(i - AROUND, 0), min(i + AROUND + 1, runs.size))
        near = sorted((j for j in window if j != i), key=lambda j: (abs(j - i), j))
        if near:
            usual[i] = _median(runs[near[:AROUND]])
    return usual[np.cumsum(np.isin(np.arange(values.size), first)) - 1]


def _median(values: np.ndarray) -> float:
    """The median; the function of NumPy would also load NumPy's masked arrays."""
    ordered, half = np.sort(values), len(values) // 2
    return ordered[half] if len(values) % 2 else (ordered[half - 1] + ordered[half]) / 2


def _start(entry: CheckedNumbers, row: int, files: "CaseFiles") -> str:
    """Position, name and value of the entry; the value is in the display unit and as written in the
    file."""
    written = entry.values if entry.written is None else entry.written
    label = f" {entry.labels[row]}" if entry.labels[row] else ""
    position = in_words(entry.positions[row]) if entry.positions else ""
    if not position:
        name, number = entry.source or entry.name, float(written[row])
        position = files.position(name, entry.labels[row], number)
    displayed = f"{_plain(entry.values[row] * entry.display_factor)} {_unit(entry)}".rstrip()
    if entry.display_factor != 1 and entry.written is None:
        displayed += f" ({entry.values[row]:.6g})"
    return f"{position}: {entry.name}{label} is {displayed}"


def in_words(position: FilePosition) -> str:
    """A position in the files of a case: "curve.csv, line 3, column price", "model.volatility"."""
    if isinstance(position, Copies):
        return in_words(position.positions[0])
    if isinstance(position, ConvertedNumber):
        return in_words(position.position)
    if isinstance(position, QuantityKey | KeyedUnit):
        return in_words(position.path)
    if isinstance(position, NoPosition):
        return ""
    if position is None or isinstance(position, SheetCell):
        return str(position or "")
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in position)
    return text.removeprefix(".")


def more(count: int, of: str = "") -> str:
    """The clause on further numbers; "" if there are none."""
    return "" if not count else f", as {'is' if count == 1 else 'are'} {count} more{of}"


def _unit(entry: CheckedNumbers) -> str:
    """The unit that the trade uses, in the plural: "percentage points a day"."""
    unit = entry.display_unit or entry.unit
    plural = unit if re.search("[/(]", unit) else re.sub(r"\b(point|year)\b", r"\1s", unit)
    return "" if unit == "1" else plural


def _plain(number: float) -> str:
    """A number with six significant digits and commas between thousands."""
    size = abs(number)
    return f"{number:.6g}" if not 1e3 <= size < 1e15 else f"{float(f'{number:.6g}'):,.10g}"


class Cell(NamedTuple):
    """A number in a file: its position, the terms of its key and column, the texts of its
    row, and its value (NaN if it is a text in quotation marks)."""

    position: str
    terms: frozenset[str]
    row: tuple[str, ...]
    value: float


@dataclass(frozen=True)
class CaseFiles:
    """The files of a case, which are read when the first position of a number is looked up.

    - `data`: the tables of the TOML file `file`; the CSVs that they name are in its folder.
    """

    file: Path
    data: Mapping[str, Any]

    def position(self, name: str, label: str, value: float) -> str:
        """The position of a number of the input `name`, or `name` if no file contains the number.

        Several cells may contain the number or have the key's name. The result is the cell whose
        key, column and row have the largest number of terms in common with the input's name and
        label. A cell with an annual rate also counts as its continuous rate, because some cases
        convert rates.
        """
        terms, last = _terms(name), _terms(name.rpartition(".")[2])
        written = (value, math.expm1(value) if abs(value) < 100 else value)
        best, best_score = name, (0, False, 0, 0)
        for cell in self._cells:
            equal = _equal(cell.value, written)
            if not equal and not last <= cell.terms:
                continue
            common, rows = len(terms & cell.terms), _rows(cell, label)
            score = (common + rows + equal, equal, rows, -len(cell.terms))
            if common + rows and score > best_score:
                best, best_score = cell.position, score
        return best

    @cached_property
    def _cells(self) -> list[Cell]:
        return list(self._walk(self.data, ()))

    def _walk(self, value: Any, path: tuple[str, ...]) -> Iterator[Cell]:
        if isinstance(value, Mapping):
            for key, item in value.items():
                yield from self._walk(item, (*path, str(key)))
        elif isinstance(value, list):
            for i, item in enumerate(value):
                name = item.get("name", item.get("of")) if isinstance(item, Mapping) else None
                key = f"[{i}]" if name is None else f"[{name}]"
                yield from self._walk(item, (*path[:-1], f"{path[-1]}{key}"))
        elif isinstance(value, str) and value.lower().endswith(TABLES):
            yield from self._table(value, path)
        elif isinstance(value, int | float | str) and not isinstance(value, bool):
            number = math.nan if isinstance(value, str) else float(value)
            yield Cell(".".join(path), _terms(".".join(path)), (), number)

    def _table(self, name: str, path: tuple[str, ...]) -> Iterator[Cell]:
        """The cells of a CSV that the case names; none if the file cannot be read as a CSV."""
        section = TableContext(self.file, ".".join(path[:-1]), [])
        try:
            if (self.file.parent / name).stat().st_size > LARGEST:
                yield Cell(name, _terms(".".join(path)), (), math.nan)
                return
            rows = read_rows(FileReference(section, path[-1], name), ())
        except (CaseError, OSError, ValueError):
            return
        for row in rows:
            texts = tuple(row.label(column) for column in row.cells)
            for column, text in row.cells.items():
                if NUMBER.fullmatch(text):
                    terms = _terms(".".join((*path, column)))
                    where = f"{name}, line {row.line}, column {column}"
                    yield Cell(where, terms, texts, float(text))


def _terms(text: str) -> frozenset[str]:
    """The terms of a name, in the singular: "asset_cost" has "asset" and "cost"."""
    return frozenset(
        term.removesuffix("s") for term in re.split(r"[^a-z0-9]+", text.lower()) if term
    )


def _equal(value: float, written: tuple[float, ...]) -> bool:
    return any(math.isclose(value, number, rel_tol=EXACT) for number in written)


def _rows(cell: Cell, label: str) -> int:
    """The number of texts of the cell's row, or of its key, that a number's label contains."""
    inside = _terms(label)
    return sum(
        bool(text) and (label.startswith(text) or _terms(text) <= inside or f"{text}y" == label)
        for text in cell.row
    ) + (not cell.row and bool(inside) and inside <= cell.terms)
