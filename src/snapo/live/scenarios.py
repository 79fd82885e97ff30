"""Named scenarios, kept in the run folder, and their export as CSV, TOML or a workbook.

scenarios/NAME/scenario.json    the moved inputs, and their values
scenarios/NAME/case/            the case for `snapo solve`, and policy.npz if the policy
                                was trained on the page
page.json                       the inputs that a page showed last
"""

import csv
import datetime
import io
import json
import math
import re
import shutil
import unicodedata
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from snapo.report.record import EMPTY, entries_of
from snapo.solver.tables import write_text

HEADER = ("what", "input", "label", "number", "standard_error", "low", "high")


class MovedValue(NamedTuple):
    """The value at the moved inputs, and its change from the run, with standard errors."""

    value: float | None = None
    standard_error: float | None = None
    change: float | None = None
    change_error: float | None = None


class PageTables(NamedTuple):
    """The tables of a page or a scenario; a missing table is None.

    - `values`, `chosen`: the moved inputs and choices by name; `policy`: the number or file of the
      policy.
    - `value`, `deltas`, `fans`, `today`, `sections`: the tables of `Moves.stages`.
    """

    id: str | None = None
    values: dict[str, Any] | None = None
    chosen: dict[str, Any] | None = None
    policy: int | str = 0
    value: Mapping[str, Any] | None = None
    deltas: Sequence[Mapping[str, Any]] | None = None
    fans: Sequence[Mapping[str, Any]] | None = None
    today: Mapping[str, Any] | None = None
    sections: Sequence[Mapping[str, Any]] | None = None

    @property
    def choices(self) -> dict[str, Any]:
        """The moved choices; empty if they are missing."""
        return self.chosen or {}


def csv_of(rows: Iterable[Sequence[Any]]) -> str:
    """The rows as CSV; text that a spreadsheet would read as a formula is marked as text."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    for row in rows:
        writer.writerow([_cell(item) for item in row])
    return out.getvalue()


def _cell(value: Any) -> Any:
    if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r"):
        return "'" + value
    return value


def page_rows(tables: Mapping[str, Any]) -> Iterator[Sequence[Any]]:
    """Everything that the page shows, one number in each row, under `HEADER`.

    `tables`: the tables of `Moves.stages` by name, with the moved "values" and "chosen". A
    derivative has the limits of its interval instead of a standard error.
    """
    yield HEADER
    for row in _numbers(entries_of(PageTables, tables)):
        yield (*row, *(None,) * (len(HEADER) - len(row)))


def _numbers(tables: PageTables) -> Iterator[Sequence[Any]]:
    """The rows without the empty columns at their end."""
    table = entries_of(MovedValue, tables.value)
    yield ("value", "", "", table.value, table.standard_error)
    yield ("change", "", "", table.change, table.change_error)
    for name, value in tables.choices.items():
        yield ("chosen", name, str(value), None, None)
    for name, numbers in (tables.values or {}).items():
        for i, number in enumerate(numbers):
            yield ("moved", name, str(i + 1), number, None)
    yield from _sections(tables)
    for item in tables.deltas or []:
        of = f"{item['of']} by {item['input']}" if "of" in item else item["input"]
        yield ("move", of, "", item["effect"], None, item["low"], item["high"])
        for row in item["rows"]:
            yield ("delta", of, row["label"], row["value"], None, row["low"], row["high"])
    for item in tables.fans or []:
        for key in ("mean", "p05", "p25", "p75", "p95"):
            for i, number in enumerate(item[key]):
                yield (f"{key} over time", item["name"], str(i), number, None)


def _sections(tables: PageTables) -> Iterator[Sequence[Any]]:
    """Today's decision and the domain's sections, every number with the name of its column."""
    for name, number, unit in (tables.today or {}).get("facts", ()):
        yield ("today", name, unit, number, None)
    for item in tables.sections or []:
        names = [f"{name}, {unit}" if unit else name for name, unit in item["columns"]]
        for row in item["rows"]:
            for name, cell in zip(names[1:], row[1:], strict=True):
                number = cell if isinstance(cell, int | float) else None
                label = name if number is not None or cell is None else f"{name}: {cell}"
                yield (item["title"], str(row[0]), label, number, None)


def zipped(folder: Path, name: str) -> bytes:
    """The files of a folder as a zip with a folder `name`; links are omitted."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed:
        for file in sorted(folder.iterdir()):
            if file.is_file() and not file.is_symlink():
                packed.write(file, f"{name}/{file.name}")
    return out.getvalue()


FOLDER, FILE, CASE, LAST = "scenarios", "scenario.json", "case", "page.json"
LONGEST, MAXIMUM = 60, 200  # letters of a name; scenarios of a run
MAX_NUMBERS, MAX_CHOICES = 100_000, 100  # of a move
KEPT = ("chosen", "policy", "value", "sections", "deltas", "today", "fans")


class Refused(ValueError):
    """A request of the page that is refused; the message has the reason."""


class PageOrder(NamedTuple):
    """An unchecked request of a page to `do` something for its move number `n`. - `values`,
    `chosen`, `policy`: the values, choices and policy of the move, as in `PageTables`; `name`,
    `id`: the name and id of a scenario.
    """

    do: Any = None
    n: Any = -1
    values: Any = None
    chosen: Any = EMPTY
    policy: Any = 0
    name: Any = ""
    id: Any = ""


def values_of(inputs: Any) -> dict[str, list[float]]:
    """{input: numbers} of a message; the reader of the case decides whether they are allowed."""
    if not isinstance(inputs, dict):
        raise Refused("values must be a table of inputs")
    values, size = {}, 0
    for name, numbers in inputs.items():
        if not isinstance(numbers, list):
            raise Refused(f"{name}: an input is a list of numbers")
        size += len(numbers)
        if size > MAX_NUMBERS:
            raise Refused(f"a move may have at most {MAX_NUMBERS} numbers")
        for number in numbers:
            if isinstance(number, bool) or not isinstance(number, int | float):
                raise Refused(f"{name}: an input is a list of numbers")
            if not math.isfinite(number):
                raise Refused(f"{name}: every number must be finite")
        values[name] = [float(number) for number in numbers]
    return values


def chosen_of(values: Any) -> dict[str, str | bool]:
    """{key: new value} of a message; the reader of the case decides whether it is allowed."""
    if not isinstance(values, Mapping) or len(values) > MAX_CHOICES:
        raise Refused("choices must be a table of texts and booleans")
    for name, value in values.items():
        if not isinstance(value, str | bool) or len(str(value)) > 100:
            raise Refused(f"{name[:60]}: a choice must be a text, true or false")
    return dict(values)


class SavedScenarios:
    """The scenarios of a run."""

    def __init__(self, run: Path):
        self.folder = run / FOLDER

    def all(self) -> list[dict[str, Any]]:
        """All scenarios that can be read, in the order in which they were saved."""
        results = [_read(file / FILE) for file in sorted(self.folder.glob("*/"))]
        return sorted((item for item in results if item), key=lambda entry: entry["made"])

    def keep(self, name: str, values: Mapping[str, Any], tables: Mapping[str, Any]) -> str:
        """Saves a scenario by name, replacing one of the same name; returns its id.

        **Raises:** `Refused` for an invalid name.
        """
        metadata = " ".join(str(name).split())[:LONGEST]
        if not metadata:
            raise Refused("a scenario needs a name")
        result = slug(metadata)
        if not (self.folder / result).exists() and len(self.all()) >= MAXIMUM:
            raise Refused(f"a run can have at most {MAXIMUM} scenarios; delete one first")
        made = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        record = {"id": result, "name": metadata, "made": made, "values": dict(values)}
        record |= {key: tables[key] for key in KEPT if key in tables}
        (self.folder / result).mkdir(parents=True, exist_ok=True)
        write_text(self.folder / result / FILE, json.dumps(record, allow_nan=False))
        return result

    def remember(self, shown: Mapping[str, Any]) -> None:
        """Saves the inputs that a page shows, for the next start of the server."""
        with suppress(OSError):  # a run that cannot be written is looked at all the same
            write_text(self.folder.parent / LAST, json.dumps(shown, allow_nan=False))

    def last(self) -> dict[str, Any] | None:
        """The inputs that the last page of an earlier server showed; None if there are none."""
        try:
            shown = json.loads((self.folder.parent / LAST).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        parts = entries_of(PageTables, shown)
        both = isinstance(parts.values, dict) and isinstance(parts.chosen, dict)
        return shown if both else None

    def forget(self, result: str) -> None:
        """Removes a scenario and its case."""
        shutil.rmtree(self.folder_of(result), ignore_errors=True)

    def folder_of(self, result: str) -> Path:
        """The folder of an existing scenario. **Raises:** `Refused` for an invalid id, so that no
        path is outside the run.
        """
        if result != slug(result) or not (self.folder / result / FILE).is_file():
            raise Refused("there is no such scenario")
        return self.folder / result

    def zipped(self, result: str) -> bytes:
        """The case of a scenario as a zip of its files."""
        case = self.folder_of(result) / CASE
        if not case.is_dir():
            raise Refused("this scenario has no case")
        return zipped(case, result)

    def one(self, result: str) -> str:
        """A scenario as CSV: value, moved inputs and derivatives, with one number in each row."""
        record = _read(self.folder_of(result) / FILE)
        if record is None:
            raise Refused("this scenario cannot be read")
        return csv_of(page_rows(record))

    def table(self) -> str:
        """All scenarios side by side as CSV: values, changes, and the moved inputs."""
        return csv_of(_compared(self.all()))


def slug(name: str) -> str:
    """The name of a folder for a scenario's name: small letters, digits and single hyphens."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    text = re.sub(r"[^a-z0-9]+", "-", plain).strip("-")[:LONGEST]
    return text or "s-" + "-".join(f"{ord(item):x}" for item in name.strip()[:8])


def _read(file: Path) -> dict[str, Any] | None:
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    tables = entries_of(PageTables, record)
    valid = tables.id == file.parent.name and isinstance(tables.values, dict)
    return record if valid else None


def _compared(records: Sequence[Mapping[str, Any]]) -> Iterator[Sequence[Any]]:
    yield ("scenario", "value", "standard_error", "change", "change_error", "inputs_moved", "made")
    for record in records:
        tables = entries_of(PageTables, record)
        moved = " ".join(sorted([*record["values"], *tables.choices]))
        yield (record["name"], *entries_of(MovedValue, tables.value), moved, record["made"])
