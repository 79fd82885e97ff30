"""The folder of a book: the results of its jobs, and the tables made from them.

book.json           the book: its contracts, stresses and tasks, and versions
answers/            the results by the hash of their jobs, each written whole or not at all
values/, deltas/, shares/, outputs/, exposure/   Parquet, a file for each contract, or for 32
policies/           the trained policies, as `policy.save` writes them
points.csv          the points of the axes with their values, if the book has axes
result.json         sums, risk, failures and cost
report.html
"""

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from snapo.case.error import CaseError
from snapo.case.table import not_utf8
from snapo.problem.carry.arrays import replacing
from snapo.report.record import EMPTY
from snapo.solver.tables import write_text
from snapo.study.run_folder import BOOK

from .job import Cost, JobResult, opened

RESULT, REPORT = "result.json", "report.html"
ANSWERS, POLICIES = "answers", "policies"
TABLES = ("values", "deltas", "shares", "outputs", "exposure")
POINTS = "points.csv"
LAYOUT = 1


class BookRecord(NamedTuple):
    """Tables of book.json: the axes of a sweep (other books have none), and the versions."""

    axes: Sequence[Mapping[str, str]] = ()
    versions: Mapping[str, str] = EMPTY


class BookResult(NamedTuple):
    """Tables of result.json that not every book has: the points of the axes, the outputs by day,
    and the number of policies that were trained."""

    points: Sequence[Mapping[str, Any]] = ()
    exposure: Any = None
    policies: int = 1


class StressSum(NamedTuple):
    """The sum of the book under a stress, its change, and the part of the change that derivatives
    explain."""

    stress: str = ""
    value: float | None = None
    standard_error: float | None = None
    change: float | None = None
    change_error: float | None = None
    explained: float | None = None
    unexplained: float | None = None


class JsonTable(BaseModel):
    """A table of a file that the report reads; other keys are ignored."""

    model_config = ConfigDict(strict=True)


class SumForm(JsonTable):
    """A row of `sums` in result.json."""

    stress: str
    value: float | None
    standard_error: float | None
    change: float | None = None
    change_error: float | None = None
    explained: float | None = None
    unexplained: float | None = None


class RiskForm(JsonTable):
    """A row of `risk`."""

    level: float
    var: float
    var_error: float | None
    shortfall: float
    shortfall_error: float | None


class OutputForm(JsonTable):
    """An output of a point of the axes."""

    name: str
    unit: str
    value: float | None
    standard_error: float | None
    nominal: float | None


class PointForm(JsonTable):
    """A row of `points`."""

    at: dict[str, str]
    value: float | None
    standard_error: float | None
    change: float | None
    change_error: float | None
    outputs: list[OutputForm]
    note: str


class ExposureForm(JsonTable):
    """A row of `exposure`."""

    output: str
    market: str
    unit: str
    by: str
    label: str
    days: list[str]
    value: list[float]


class DeltaForm(JsonTable):
    """A row of `deltas`."""

    market: str
    input: str
    label: str
    held: float
    held_error: float | None


class LossForm(JsonTable):
    """A test of a shared policy: the loss of one contract."""

    case: str
    value: float
    loss: float
    loss_error: float | None


class SharedPolicyForm(JsonTable):
    """A row of `shared_policies`."""

    leader: str
    contracts: int
    is_shared: bool
    losses: list[LossForm]


class ResultForm(JsonTable):
    """The part of result.json that the report needs."""

    title: str
    cases: dict[Literal["ok", "failed"], int]
    sums: Annotated[list[SumForm], Field(min_length=1)]
    by: dict[str, dict[str, list[SumForm]]]
    risk: list[RiskForm]
    deltas: list[DeltaForm]
    exposure: list[ExposureForm] = []
    points: list[PointForm] = []
    notes: list[str]
    failures: list[dict[Literal["case", "stress", "status", "note"], str]]
    shared_policies: list[SharedPolicyForm]
    orders: dict[str, int]
    seconds: dict[str, float]
    workers: int
    cpu_seconds: float
    peak_mb: float
    shapes: int


class TasksForm(JsonTable):
    """`tasks` in book.json."""

    policy: str
    paths: int


class RecordForm(JsonTable):
    """The part of book.json that the report needs."""

    cases: list[Any]
    stresses: list[Any]
    tasks: TasksForm
    axes: list[dict[Literal["key", "label"], str]] = []


AGAIN = "snapo book BOOK --resume rebuilds it from the saved results"


class BookFolder:
    """The folder of a book, written by one driver, or by the drivers of its shards."""

    def __init__(self, path: Path):
        self.path = path

    def prepare(self, record: Mapping[str, Any], keep: bool) -> None:
        """Prepares the folder; `keep`: whether its results remain.

        **Raises:** `CaseError` if it cannot be written, or contains other files.
        """
        if self.path.exists() and not (self.path / BOOK).exists() and any(self._others()):
            message = "this folder has other files; it must be empty or the folder of a book"
            raise CaseError(str(self.path), "", None, message)
        if not keep:
            for name in (ANSWERS, POLICIES, *TABLES):
                shutil.rmtree(self.path / name, ignore_errors=True)
        for name in (RESULT, REPORT, POINTS):
            (self.path / name).unlink(missing_ok=True)
        (self.path / ANSWERS).mkdir(parents=True, exist_ok=True)
        table = {"layout": LAYOUT, "kind": "book", **record}
        write_text(self.path / BOOK, json.dumps(table, indent=1, default=str), shared=True)

    def _others(self) -> Iterator[Path]:
        """The files that no book has. Another shard may be about to write book.json."""
        return (x for x in self.path.iterdir() if x.name != ANSWERS and x.name[0] != ".")

    def record(self) -> dict[str, Any]:
        """The content of book.json. **Raises:** `CaseError` if it is missing, damaged, or of
        another version.
        """
        table = self._json(BOOK, "this is not the folder of a book")
        layout = table.get("layout") if isinstance(table, dict) else None
        if layout != LAYOUT:
            message = f"it must be {LAYOUT}; this file is damaged or of another version: {AGAIN}"
            raise CaseError(str(self.path / BOOK), "layout", layout, message)
        return self._checked(BOOK, table, RecordForm)

    def result(self) -> dict[str, Any]:
        """The content of result.json. **Raises:** `CaseError` if it is missing or damaged; the
        message names the key.
        """
        message = "this book has no results yet: snapo book BOOK --resume computes them"
        table = self._checked(RESULT, self._json(RESULT, message), ResultForm)
        if not any(row["stress"] == "base" for row in table["sums"]):
            message = f"one row must have the stress base: {AGAIN}"
            raise CaseError(str(self.path / RESULT), "sums", None, message)
        return table

    def _checked(self, name: str, table: Any, form: type[JsonTable]) -> dict[str, Any]:
        """The content of a file, if it has the keys of `form`."""
        try:
            form.model_validate(table)
            return table
        except ValidationError as error:
            first = error.errors()[0]
            where = "".join(f"[{x}]" if isinstance(x, int) else f".{x}" for x in first["loc"])
            missing = first["type"] == "missing"
            text = "this key is missing" if missing else first["msg"].lower()
            text = "a table is expected" if first["type"] == "model_type" else text
            value = None if missing else first["input"]
            message = f"{text}; this file was changed after it was written: {AGAIN}"
            raise CaseError(str(self.path / name), where[1:], value, message) from None

    def _json(self, name: str, missing: str) -> Any:
        """The content of a JSON file; `missing`: the message if there is no such file."""
        file = str(self.path / name)
        try:
            return json.loads((self.path / name).read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise CaseError(file, "", None, missing) from None
        except OSError as error:
            raise CaseError(file, "", None, f"it cannot be read ({error.strerror})") from None
        except UnicodeDecodeError as error:
            raise CaseError(
                file, "", None, f"{not_utf8(error)}, or write it again: {AGAIN}"
            ) from None
        except (ValueError, RecursionError) as error:
            line = f"line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
            message = f"this is not valid JSON: the file was truncated or changed: {AGAIN}"
            raise CaseError(file, line, None, message) from None

    def _result_file(self, name: str) -> Path:
        return self.path / ANSWERS / name[:2] / name

    def write(self, name: str, data: bytes) -> None:
        """Writes the result of the job of this name. **Raises:** `OSError`, on a full disk."""
        file = self._result_file(name)
        file.parent.mkdir(exist_ok=True)
        with replacing(file, shared=True) as partial:
            partial.write_bytes(data)

    def read(self, name: str) -> tuple[JobResult, Cost] | None:
        """The result of the job of this name; None if there is no complete one."""
        try:
            data, cost = opened(self._result_file(name).read_bytes())
            return JobResult.unpack(data), cost
        except (OSError, ValueError):
            return None
