"""The files of a run folder, as a report reads them; missing files are None."""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from .checksums import changed_files
from .quantity import array, finite, money, plus_minus, readable
from .record import PartState, RunRecord, StepTimes, entries_of

RESULT = "result.json"
NUMBERS = (
    "value", "standard_error", "smoothing_gap", "policy_gradient_norm", "policy_gradient_noise",
)  # fmt: skip
PLANNED, LEFT_OUT = "planned", "left_out"  # names of parts, in the `about` of a run
NAMES = "names"  # of states, decisions and outputs, there too; an empty one is not shown
SENSITIVITIES = (
    "input", "label", "unit", "source", "value", "low", "high", "sampling", "policy", "held",
    "held_error", "smooth", "smooth_error", "moved", "moved_error",
)  # fmt: skip


@dataclass(frozen=True)
class Sensitivity:
    """One line of sensitivities.csv: the derivative of the value with respect to an input, per unit
    of the input.

    - `value`, `low`, `high`: the reported derivative and its 95 % interval, None if it is not
      known; `sampling`, `policy`: the parts of the half-width of this interval; `source`: "held",
      "through the policy", "range" or "not known".
    - `held`, `held_error`: the derivative with the decisions held fixed; `smooth`, `smooth_error`:
      the derivative that includes the policy's reaction; `moved`, `moved_error`: the change of the
      held derivative in the second half of training. They are None if they were not requested.
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
class RunResult:
    """The entries of result.json that every kind of run may have; a missing entry is empty.

    - `value`, `standard_error`, `smoothing_gap`, `policy_gradient_norm`, `policy_gradient_noise`:
      None if they are missing or not finite.
    - `references`: {name: value}; `limits`: entries with the fields of a `LimitFound`; `notes`:
      sentences.
    - `window`, `clip`, `keep`: the settings of backpropagation at the end of training.
    - `seconds`: times by name, in seconds; `engine`, `paths`, `seed`: the settings that reproduce
      these numbers.
    """

    value: float | None = None
    standard_error: float | None = None
    smoothing_gap: float | None = None
    policy_gradient_norm: float | None = None
    policy_gradient_noise: float | None = None
    status: str = ""
    verdict: str = ""
    convergence: str = ""
    notes: Sequence[str] = ()
    references: Mapping[str, float | None] = field(default_factory=dict)
    limits: Sequence[dict[str, Any]] = ()
    window: int | None = None
    clip: float | None = None
    keep: float | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    engine: Any = None
    paths: Mapping[str, int] = field(default_factory=dict)
    seed: int | None = None

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> "RunResult":
        """The record from the object of result.json."""
        names = [x.name for x in fields(cls) if table.get(x.name) is not None]
        entries: dict[str, Any] = {name: table[name] for name in names}
        entries |= {name: finite(entries.get(name)) for name in NUMBERS}
        return cls(**entries)

    @classmethod
    def read(cls, folder: Path) -> "RunResult":
        """The result of the run in `folder`; an empty result if the file is missing or damaged."""
        return cls.of(read_table(folder / RESULT) or {})


@dataclass(frozen=True)
class RunFiles:
    """The contents of a run folder; a domain's subclass adds the units of its numbers.

    **Attributes:**

    - `result`: result.json.
    - `details`: the `about` of run.json and the tables of all completed parts; read them with `get`
      and `numbers`, since any key may be missing.
    - `parts`: the parts in run.json by name.
    - `sensitivities`: the lines of sensitivities.csv.
    - `profile`, `history`, `adjoints`: columns of these CSV files by name, as text.
    """

    result: RunResult
    details: dict[str, Any]
    parts: dict[str, PartState]
    sensitivities: tuple[Sensitivity, ...]
    profile: dict[str, list[str]]
    history: dict[str, list[str]]
    adjoints: dict[str, list[str]] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path):
        """Reads the run in `folder`; a missing file counts as empty."""
        record = entries_of(RunRecord, read_table(folder / "run.json"))
        details = dict(record.about)
        parts = {name: record.part(name) for name in record.parts}
        spoilt = _spoilt(folder, record)
        for name, files in spoilt.items():
            if name in parts:
                note = (
                    f"{files[0]} was changed or damaged since it was written; run snapo solve "
                    f"with --resume"
                )
                parts[name] = parts[name]._replace(state="failed", note=note)
        invalid = {file for files in spoilt.values() for file in files}
        for file in sorted(folder.glob("parts/*.json")):
            details |= {} if f"parts/{file.name}" in invalid else read_table(file) or {}

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
            RunResult() if RESULT in invalid else RunResult.read(folder),
            details,
            parts,
            sensitivities,
            columns("profile.csv"),
            columns("history.csv"),
            columns("adjoints.csv"),
        )

    @property
    def step_times(self) -> StepTimes:
        """The times of the steps, if the run has any."""
        return entries_of(StepTimes, self.details)

    def get(self, path: str, default: Any = None) -> Any:
        """The entry "today.spot" of the parts' tables, or `default` if it is missing or null."""
        return lookup(self.details, path, default)

    def numbers(self, path: str, column: str = "") -> np.ndarray | None:
        """The numbers of this name as float64, from the tables of the parts or else from a column
        of profile.csv; None if there are none."""
        result = array(self.get(path))
        return self.column("profile", column) if result is None and column else result

    def column(self, table: str, name: str) -> np.ndarray | None:
        """A column of numbers of `profile`, `history` or `adjoints`; an empty cell is NaN."""
        cells = getattr(self, table).get(name)
        return None if cells is None else array([_number(cell) for cell in cells])

    def left_out(self, *parts: str) -> bool:
        """Whether none of these parts was requested or exists from an earlier run."""
        missing = self.get(LEFT_OUT, [])
        return all(part in missing and part not in self.parts for part in parts)

    @property
    def currency(self) -> str:
        return str(self.get("currency", ""))

    @property
    def unit(self) -> str:
        """The unit of the value, or the currency."""
        return str(self.get("unit", self.currency))

    def title_of(self, name: str) -> str:
        """The name of a state, decision or output as text; empty for one that is not shown."""
        return str(self.get(NAMES, {}).get(name, readable(name)))

    def money(self, value: Any, digits: int | None = None, sign: bool = False) -> str:
        return money(value, self.currency, digits, sign)

    def value_text(self, value: Any, error: Any, digits: int) -> str:
        """A value with half of its 95 % interval, "EUR 78,312 ± 41", from its standard error."""
        return f"{self.money(value, digits)} {plus_minus(error, digits)}".rstrip()


def lookup(table: Any, path: str, default: Any = None) -> Any:
    """The entry "a.b" of nested tables, or `default` if it is missing or null."""
    for key in path.split("."):
        table = table.get(key) if isinstance(table, dict) else None
    return default if table is None else table


def _spoilt(folder: Path, record: RunRecord) -> dict[str, list[str]]:
    """{part: its changed files}; result.json has a separate entry."""
    states: dict[str, Any] = {name: record.part(name).files for name in record.parts}
    if record.result is not None:
        states[RESULT] = {RESULT: record.result}
    table = {name: changed_files(folder, files) for name, files in states.items()}
    return {name: files for name, files in table.items() if files}


def read_table(file: Path) -> dict[str, Any] | None:
    """The object in a JSON file; None if the file is missing or damaged."""
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) else None


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
    """A cell as a number: yes and no are 1 and 0, an empty cell is None."""
    if cell.strip().lower() in ("true", "false"):
        return float(cell.strip().lower() == "true")
    try:
        return finite(float(cell))
    except ValueError:
        return None
