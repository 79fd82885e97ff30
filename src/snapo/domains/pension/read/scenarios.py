"""Reads `[scenarios]`: ready-made paths of returns, inflation, wages and zero rates."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError, Unquoted, show
from snapo.case.table import TableContext

from ..records.market import SuppliedScenarios
from .cells import TimeGrid
from .tables import ScenariosTable


class Columns(NamedTuple):
    """The columns of a scenario file in the order of the records, and the tenors of its zero
    rates."""

    names: tuple[str, ...]
    tenor: np.ndarray


def read_scenarios(
    section: TableContext,
    table: ScenariosTable | None,
    classes: Sequence[str],
    grid: TimeGrid,
    start: str,
    annual: bool,
) -> SuppliedScenarios | None:
    """The two sets of paths. `start` is the valuation date, which files with dates need. If zero
    rates are `annual`, they are converted to continuous ones."""
    if table is None:
        return None
    if table.training == table.evaluation:
        message = "a policy must not be valued on the paths on which it was trained"
        raise section.error("evaluation", table.evaluation, message)
    sets, available = [], None
    for key in ("training", "evaluation"):
        reference = FileReference(section, key, getattr(table, key))
        rows = read_rows(reference, ("path",))
        columns = _columns(rows, classes)
        if available is not None and columns.names != available.names:
            message = f"the columns must be the same as in {table.training}"
            raise section.error(key, reference.name, message)
        available = columns
        paths = _paths(reference, rows, columns, grid, start)
        if annual:
            zeros = slice(len(columns.names) - len(columns.tenor), None)
            paths[:, :, zeros] = np.log1p(paths[:, :, zeros])
        sets.append(paths)
    assert available is not None
    return SuppliedScenarios(sets[0], sets[1], available.names, available.tenor)


def _columns(rows: Sequence[Row], classes: Sequence[str]) -> Columns:
    present = rows[0].cells
    head = Row(rows[0].file, 1, {"header": ",".join(present)})
    needed = [*(f"return {name}" for name in classes), "inflation", "wage"]
    for name in needed:
        if name.lower() not in present:
            raise head.error("header", f"the column {show(name)} is missing")
    tenors: dict[float, str] = {}
    for name in present:
        if name.startswith("zero "):
            try:
                tenors[float(name.removeprefix("zero "))] = name
            except ValueError:
                message = "the name of a zero rate's column must have the tenor in years: zero 10"
                raise Row(head.file, 1, {name: name}).error(name, message) from None
    if len(tenors) < 2:
        message = "at least two columns of zero rates are needed, such as zero 1 and zero 10"
        raise head.error("header", message)
    tenor = sorted(tenors)
    if tenor[0] <= 0:
        raise head.error("header", "the tenors of zero rates must be above 0")
    return Columns((*needed, *(tenors[item] for item in tenor)), np.array(tenor))


def _paths(
    reference: FileReference, rows: Sequence[Row], columns: Columns, grid: TimeGrid, start: str
) -> np.ndarray:
    """The paths [paths, T, K], without a missing number."""
    numbers: dict[str, int] = {}
    for row in rows:
        numbers.setdefault(row.cells["path"], len(numbers))
    paths = np.full((len(numbers), grid.steps, len(columns.names)), np.nan)
    names = [name.lower() for name in columns.names]
    for row in rows:
        path, step = numbers[row.cells["path"]], _step(row, grid, start)
        if step >= grid.steps:
            continue
        if not np.isnan(paths[path, step, 0]):
            raise row.error("path", "an earlier row of this path has this time already")
        for k, name in enumerate(names):
            minimum = -0.999999 if name.startswith(("return ", "zero ")) else -1.0
            paths[path, step, k] = row.number(name, minimum)
    holes = np.argwhere(np.isnan(paths[:, :, 0]))
    if len(holes):
        path, step = holes[0]
        name = list(numbers)[path]
        got = Unquoted(f"no row for path {name}, step {step + 1}")
        message = f"every path needs all {grid.steps} steps; missing rows: {len(holes)}"
        raise CaseError(reference.name, "", got, message)
    if len(numbers) < 2:
        raise CaseError(reference.name, "", Unquoted("one path"), "at least two paths are needed")
    return paths


def _step(row: Row, grid: TimeGrid, start: str) -> int:
    """The step of a row, from 0: counted from 1 in the file, or by the date at its end."""
    monthly = grid.step < 1
    name = "month" if monthly else "year"
    if "date" in row.cells and name not in row.cells:
        day = row.day("date")
        year, month = int(start[:4]), int(start[5:7])
        passed = 12 * (day.year - year) + day.month - month
        passed = passed if monthly else day.year - year
        if passed < 1:
            raise row.error("date", f"it must be a date after the valuation date, {start}")
        return passed - 1
    if name not in row.cells:
        head = Row(row.file, 1, {"header": ",".join(row.cells)})
        raise head.error("header", f"a column {name} or date is needed")
    value = row.number(name, 1.0)
    if value != int(value):
        raise row.error(name, "steps must be numbered 1, 2, 3 …")
    return int(value) - 1
