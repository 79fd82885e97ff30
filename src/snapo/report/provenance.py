"""The origin of a report: its case with all inputs, its run, and the previous run."""

import csv
import datetime
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from snapo.case.workbook import lines

from .folder import RunFiles
from .page import Block, Section, Table, Text
from .quantity import decimals, finite, long_date, measured
from .record import LibraryVersions, PreviousRun, RunOrigin, RunRecord, entries_of

MAX_ROWS = 400  # of a file of the case; the file itself is next to the report
MAX_LETTERS = 200  # of a value


def provenance(run: RunFiles, record: RunRecord, folder: Path) -> Section:
    """The section on a run with this `record` (run.json) in `folder`; empty if an older version
    wrote the run."""
    if not isinstance(record.provenance, Mapping):
        return Section("provenance", "", "", [])
    blocks: list[Block] = [_making(run, record, folder), *_changes(run, record.origin)]
    blocks += _inputs(record, folder)
    return Section("provenance", "Provenance and inputs", "Inputs", blocks)


def _making(run: RunFiles, record: RunRecord, folder: Path) -> Table:
    seed, origin = run.get("seed", run.result.seed), record.origin
    versions = entries_of(LibraryVersions, record.settings.versions)
    rows = [
        ("Run", folder.name if origin.run is None else origin.run),
        ("Date", date(origin)),
        ("Case file", origin.case),
        ("SHA-256 of the case file", origin.sha256),
        *(("Changed with --set", text) for text in origin.assignments),
        ("Version", f"snapo {versions.snapo}, Python {versions.python}"),
        ("Seed", "" if seed is None else str(seed)),
        ("Machine", origin.machine),
    ]
    return Table([], [row for row in rows if row[1]], "Origin of this report", 2)


def date(origin: RunOrigin) -> str:
    """The day and the minute in which a run began, with the time zone."""
    try:
        moment = datetime.datetime.fromisoformat(origin.began)
    except (TypeError, ValueError):
        return ""
    return f"{long_date(moment.date())}, {moment:%H:%M} (UTC{moment:%z})"


def _changes(run: RunFiles, origin: RunOrigin) -> Iterator[Block]:
    """The value and the settings, compared with those of the previous run."""
    if not isinstance(origin.previous, Mapping):
        yield Text("There is no earlier run of this case to compare with.")
        return
    previous = entries_of(PreviousRun, origin.previous)
    error, old = run.result.standard_error, previous.standard_error
    digits = decimals([x for x in (error, old) if x] or [run.result.value], 2)
    change = previous.difference, previous.difference_error
    rows = [
        ("Value of this run", *measured(run.result.value, error, digits)),
        (f"Value of {previous.run}", *measured(previous.value, old, digits)),
    ]
    if finite(change[0]) is not None:
        name = "Difference on the same paths" if previous.paired else "Difference"
        rows.append((name, *measured(*change, digits, sign=True)))
    yield Table([], rows, "Changed since the previous run", 1)
    settings = [(str(x["name"]), _text(x["first"]), _text(x["second"])) for x in previous.changes]
    if settings:
        head = [("Setting", ""), ("Last run", ""), ("This run", "")]
        yield Table(head, settings, "Settings that differ from the previous run", 3)
    else:
        yield Text("All settings are those of the previous run.")


def _inputs(record: RunRecord, folder: Path) -> Iterator[Block]:
    """All keys of the case with the values that were used, and the files that the case names."""
    case = record.settings.case
    rows = [(key, _text(value)) for key, value, _ in lines(case)]
    caption = f"All {len(rows)} keys of the case, with the changes of --set"
    yield Table([("Key", ""), ("Value", "")], rows, "", 2, folded=caption)
    names = {str(value) for _, value, _ in lines(case)} | {str(x) for x in _texts(case)}
    for file in sorted((folder / "case").glob("*.csv")):
        if file.name in names:
            yield _file(file)


def _texts(value: Any) -> Iterator[str]:
    """All texts in nested data."""
    if isinstance(value, Mapping):
        for item in value.values():
            yield from _texts(item)
    elif isinstance(value, list):
        for item in value:
            yield from _texts(item)
    elif isinstance(value, str):
        yield value


def _file(file: Path) -> Table:
    """A CSV file of the case, with its cells as they were read."""
    text = file.read_text(encoding="utf-8-sig", errors="replace")
    rows_of_text = [line for line in text.splitlines() if line.strip() and line[0] != "#"]
    separator = next((x for x in ";\t" if rows_of_text and x in rows_of_text[0]), ",")
    cells = list(csv.reader(rows_of_text, delimiter=separator))
    head, rows = (cells[0], cells[1:]) if cells else ([], [])
    rows = [row for row in rows if len(row) == len(head)]
    more = f", the first {MAX_ROWS:,} of {len(rows):,} rows" if len(rows) > MAX_ROWS else ""
    caption = f"{file.name}{more}"
    names = [(name, "") for name in head]
    return Table(names, rows[:MAX_ROWS], "", len(head), folded=caption)


def _text(value: Any) -> str:
    text = "not given" if value is None else str(value)
    return text if len(text) <= MAX_LETTERS else text[: MAX_LETTERS - 3] + "..."
