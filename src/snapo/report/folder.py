"""The files of a run folder as read by a report: missing ones are None."""

import csv
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .checksums import changed_files
from .quantity import array, finite, money, plus_minus

RESULT = "result.json"
PLANNED, LEFT_OUT = "planned", "left_out"  # names of parts, in the `about` of a run
SENSITIVITIES = (
    "input", "label", "unit", "source", "value", "low", "high", "sampling", "policy", "held",
    "held_error", "smooth", "smooth_error", "moved", "moved_error",
)  # fmt: skip


@dataclass(frozen=True)
class Sensitivity:
    """One line of sensitivities.csv: d value / d input, per one unit of the input.

    - `value`, `low`, `high`: the reported derivative and its 95 % interval, None where it is not
      known; `sampling`, `policy`: the parts of its half-width; `source`: "held", "through the
      policy", "range" or "not known".
    - `held`, `held_error`: with the decisions held; `smooth`, `smooth_error`: through the policy's
      reaction; `moved`, `moved_error`: the change of the held one in the second half of training.
      None where they were not asked for.
    """

    input: str
    label: str
    unit: str
    source: str
    value: float | None
    low: float | None
    high: float | None
    sampling: float | None
    policy: float | None
    held: float | None
    held_error: float | None
    smooth: float | None
    smooth_error: float | None
    moved: float | None
    moved_error: float | None


@dataclass(frozen=True)
class RunFiles:
    """The contents of a run folder; the class of a domain adds its units.

    **Attributes:**

    - `result`: result.json.
    - `details`: run.json's `about` and the tables of all parts that are done; read with `get` and
      `numbers`, since any key may be missing.
    - `parts`: {name: {"state", "note", "seconds"}} of run.json.
    - `sensitivities`: the lines of sensitivities.csv.
    - `profile`, `history`, `adjoints`: columns of these CSV files by name, as text.
    """

    result: dict[str, Any]
    details: dict[str, Any]
    parts: dict[str, dict[str, Any]]
    sensitivities: tuple[Sensitivity, ...]
    profile: dict[str, list[str]]
    history: dict[str, list[str]]
    adjoints: dict[str, list[str]] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path):
        """Reads the run in `folder`; a file that is not there counts as empty."""
        record = _object(folder / "run.json")
        details, parts = dict(record.get("about", {})), dict(record.get("parts", {}))
        spoilt = _spoilt(folder, record)
        for name, files in spoilt.items():
            if name in parts:
                note = (
                    f"{files[0]} was changed or damaged since it was written; solve with --resume"
                )
                parts[name] = {**parts[name], "state": "failed", "note": note}
        invalid = {file for files in spoilt.values() for file in files}
        for file in sorted(folder.glob("parts/*.json")):
            details |= {} if f"parts/{file.name}" in invalid else _object(file)

        def columns(name: str) -> dict[str, list[str]]:
            return {} if name in invalid else _columns(folder / name)

        lines = columns("sensitivities.csv")
        blank = [""] * len(lines.get("input", []))
        rows = zip(*(lines.get(name, blank) for name in SENSITIVITIES), strict=True)
        sensitivities = tuple(
            Sensitivity(name, label, unit, source, *map(_number, numbers))
            for name, label, unit, source, *numbers in rows
            if source
        )
        return cls(
            {} if RESULT in invalid else _object(folder / RESULT),
            details,
            parts,
            sensitivities,
            columns("profile.csv"),
            columns("history.csv"),
            columns("adjoints.csv"),
        )

    def get(self, path: str, default: Any = None) -> Any:
        """The entry "today.spot" of the parts' tables, or `default` where it is missing or null."""
        return lookup(self.details, path, default)

    def numbers(self, path: str, column: str = "") -> np.ndarray | None:
        """A list of the parts' tables as float64, else the column of profile.csv, else None."""
        result = array(self.get(path))
        return self.column("profile", column) if result is None and column else result

    def column(self, table: str, name: str) -> np.ndarray | None:
        """A column of numbers of `profile`, `history` or `adjoints`; an empty cell is NaN."""
        cells = getattr(self, table).get(name)
        return None if cells is None else array([_number(cell) for cell in cells])

    def left_out(self, *parts: str) -> bool:
        """Whether none of these parts was requested, or exists from an earlier run."""
        missing = self.get(LEFT_OUT, [])
        return all(part in missing and part not in self.parts for part in parts)

    @property
    def currency(self) -> str:
        return str(self.get("currency", ""))

    @property
    def unit(self) -> str:
        """The unit of the value, or the currency."""
        return str(self.get("unit", self.currency))

    def money(self, value: Any, digits: int | None = None, sign: bool = False) -> str:
        return money(value, self.currency, digits, sign)

    def value_text(self, value: Any, error: Any, digits: int) -> str:
        """A value with its standard error, "EUR 78,312 ± 41"."""
        return f"{self.money(value, digits)} {plus_minus(error, digits)}".rstrip()


def lookup(table: Any, path: str, default: Any = None) -> Any:
    """The entry "a.b" of nested tables, or `default` where it is missing or null."""
    for key in path.split("."):
        table = table.get(key) if isinstance(table, dict) else None
    return default if table is None else table


def _spoilt(folder: Path, record: dict[str, Any]) -> dict[str, list[str]]:
    """{part: its files that were changed}; result.json has a separate entry."""
    states = {name: state.get("files") for name, state in record.get("parts", {}).items()}
    if "result" in record:
        states[RESULT] = {RESULT: record["result"]}
    table = {name: changed_files(folder, files) for name, files in states.items()}
    return {name: files for name, files in table.items() if files}


def _object(file: Path) -> dict[str, Any]:
    """The object in a JSON file; an empty one where it is not there, or damaged."""
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return data if isinstance(data, dict) else {}


def _columns(file: Path) -> dict[str, list[str]]:
    if not file.exists():
        return {}
    try:
        with file.open(encoding="utf-8", newline="") as stream:
            rows = [row for row in csv.reader(stream) if row]
    except (OSError, ValueError, csv.Error):
        return {}
    # The last line of a run that was killed may be cut short; it is left out.
    complete = [row for row in rows[1:] if len(row) == len(rows[0])]
    return {name: [row[i] for row in complete] for i, name in enumerate(rows[0])} if rows else {}


def _number(cell: str) -> float | None:
    """A number; a yes or no as 1 or 0; an empty cell as None."""
    if cell.strip().lower() in ("true", "false"):
        return float(cell.strip().lower() == "true")
    try:
        return finite(float(cell))
    except ValueError:
        return None
