"""Named scenarios: kept in the run folder, so that they outlive page, worker and server.

scenarios/NAME/scenario.json    the moved inputs, and what they are worth
scenarios/NAME/case/            the case, as `snapo solve` takes it
"""

import datetime
import json
import re
import shutil
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from snapo.solver.tables import write_text

from .export import csv_of, page_rows, zipped

FOLDER, FILE, CASE = "scenarios", "scenario.json", "case"
LONGEST, MAXIMUM = 60, 200  # letters of a name; scenarios of a run
KEPT = ("chosen", "value", "sections", "deltas", "today", "fans")


class Refused(ValueError):
    """Something that the page asked for and does not get; the message says why."""


class SavedScenarios:
    """The scenarios of a run."""

    def __init__(self, run: Path):
        self.folder = run / FOLDER

    def all(self) -> list[dict[str, Any]]:
        """Every scenario that can be read, in the order in which they were kept."""
        results = [_read(file / FILE) for file in sorted(self.folder.glob("*/"))]
        return sorted((item for item in results if item), key=lambda entry: entry["made"])

    def keep(self, name: str, values: Mapping[str, Any], tables: Mapping[str, Any]) -> str:
        """Keeps a scenario under a name, in place of one of the same name; returns its id.

        **Raises:** `Refused` for a name that is none.
        """
        metadata = " ".join(str(name).split())[:LONGEST]
        if not metadata:
            raise Refused("a scenario needs a name")
        result = slug(metadata)
        if not (self.folder / result).exists() and len(self.all()) >= MAXIMUM:
            raise Refused(f"a run keeps {MAXIMUM} scenarios at most; forget one first")
        made = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        record = {"id": result, "name": metadata, "made": made, "values": dict(values)}
        record |= {key: tables[key] for key in KEPT if key in tables}
        (self.folder / result).mkdir(parents=True, exist_ok=True)
        write_text(self.folder / result / FILE, json.dumps(record, allow_nan=False))
        return result

    def forget(self, result: str) -> None:
        """Removes a scenario and its case."""
        shutil.rmtree(self.folder_of(result), ignore_errors=True)

    def folder_of(self, result: str) -> Path:
        """The folder of a scenario that exists.

        **Raises:** `Refused` for an id that is none: no path leads out of the run.
        """
        if result != slug(result) or not (self.folder / result / FILE).is_file():
            raise Refused("there is no such scenario")
        return self.folder / result

    def zipped(self, result: str) -> bytes:
        """The case of a scenario, as a zip of its files."""
        case = self.folder_of(result) / CASE
        if not case.is_dir():
            raise Refused("this scenario has no case of its own")
        return zipped(case, result)

    def one(self, result: str) -> str:
        """A scenario as CSV: value, moved inputs and derivatives, a number in each row."""
        record = _read(self.folder_of(result) / FILE)
        if record is None:
            raise Refused("this scenario cannot be read")
        return csv_of(page_rows(record))

    def table(self) -> str:
        """All scenarios side by side as CSV: values, changes, and what was moved."""
        return csv_of(_compared(self.all()))


def slug(name: str) -> str:
    """A name of a folder from a name: small letters, digits and single hyphens."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    text = re.sub(r"[^a-z0-9]+", "-", plain).strip("-")[:LONGEST]
    return text or "s-" + "-".join(f"{ord(item):x}" for item in name.strip()[:8])


def _read(file: Path) -> dict[str, Any] | None:
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    valid = isinstance(record, dict) and record.get("id") == file.parent.name
    return record if valid and isinstance(record.get("values"), dict) else None


def _compared(records: Sequence[Mapping[str, Any]]) -> Iterator[Sequence[Any]]:
    yield ("scenario", "value", "standard_error", "change", "change_error", "inputs_moved", "made")
    keys = ("value", "standard_error", "change", "change_error")
    for record in records:
        result = record.get("value") or {}
        moved = " ".join(sorted([*record["values"], *(record.get("chosen") or {})]))
        yield (record["name"], *(result.get(key) for key in keys), moved, record["made"])
