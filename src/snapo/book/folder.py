"""The folder of a book: answers, and the tables that are made from them.

book.json           the book: its contracts, stresses and tasks, and versions
answers/            the answers by the hash of their orders, each written whole or not at all
values/, deltas/, shares/, outputs/, exposure/   Parquet, a file for each contract, or for 32
policies/           the trained policies, as `policy.save` writes them
points.csv          the points of the axes with their values, where the book has axes
result.json         sums, risk, failures and cost
report.html
"""

import json
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from snapo.case.error import CaseError
from snapo.report.record import EMPTY
from snapo.solver.tables import write_text

from .order import Cost, OrderAnswer, opened

BOOK, RESULT, REPORT = "book.json", "result.json", "report.html"
ANSWERS, POLICIES = "answers", "policies"
TABLES = ("values", "deltas", "shares", "outputs", "exposure")
POINTS = "points.csv"
LAYOUT = 1


class BookRecord(NamedTuple):
    """Tables of book.json: the axes of a sweep, none of a book, and the versions."""

    axes: Sequence[Mapping[str, str]] = ()
    versions: Mapping[str, str] = EMPTY


class BookResult(NamedTuple):
    """Tables of result.json that not every book has: the points of the axes, the outputs by day,
    and the number of policies that were trained."""

    points: Sequence[Mapping[str, Any]] = ()
    exposure: Any = None
    policies: int = 1


class StressSum(NamedTuple):
    """The sum of the book under a stress, and its change, in part explained by derivatives."""

    stress: str = ""
    value: float | None = None
    standard_error: float | None = None
    change: float | None = None
    change_error: float | None = None
    explained: float | None = None
    unexplained: float | None = None


class BookFolder:
    """The folder of a book, written by one driver, or by the drivers of its shards."""

    def __init__(self, path: Path):
        self.path = path

    def prepare(self, record: Mapping[str, Any], keep: bool) -> None:
        """Makes the folder ready; `keep`: with the answers that it has.

        **Raises:** `CaseError` where it cannot be written, or holds something else.
        """
        if self.path.exists() and not (self.path / BOOK).exists() and any(self.path.iterdir()):
            message = "this folder has other files; allowed is an empty one, or that of a book"
            raise CaseError(str(self.path), "", None, message)
        if not keep:
            for name in (ANSWERS, POLICIES, *TABLES):
                shutil.rmtree(self.path / name, ignore_errors=True)
        for name in (RESULT, REPORT, POINTS):
            (self.path / name).unlink(missing_ok=True)
        (self.path / ANSWERS).mkdir(parents=True, exist_ok=True)
        table = {"layout": LAYOUT, "kind": "book", **record}
        write_text(self.path / BOOK, json.dumps(table, indent=1, default=str))

    def record(self) -> dict[str, Any]:
        """The content of book.json. **Raises:** `CaseError` where there is none."""
        try:
            table = json.loads((self.path / BOOK).read_text(encoding="utf-8"))
            if table["layout"] != LAYOUT:
                raise KeyError(LAYOUT)
        except (OSError, ValueError, KeyError, TypeError):
            raise CaseError(str(self.path), "", None, "this is not the folder of a book") from None
        return table

    def _answer(self, name: str) -> Path:
        return self.path / ANSWERS / name[:2] / name

    def write(self, name: str, data: bytes) -> None:
        """Writes the answer to the order of this name. **Raises:** `OSError`, on a full disk."""
        file = self._answer(name)
        file.parent.mkdir(exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=file.parent, prefix=".")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            os.replace(temporary, file)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise

    def read(self, name: str) -> tuple[OrderAnswer, Cost] | None:
        """The answer to the order of this name; None where there is no whole one."""
        try:
            data, cost = opened(self._answer(name).read_bytes())
            return OrderAnswer.unpack(data), cost
        except (OSError, ValueError):
            return None
