"""Numbers that an earlier run fitted to data: their values, and their covariance as uncertainty."""

from typing import Any, NamedTuple

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError
from snapo.case.table import TableContext

from ..given import Entry
from ..quality.records import Distribution
from .entries import EntryNumbers
from .numbers import ANY, NOT_NEGATIVE, quantity
from .plausible.checks import check_drawn

COLUMNS = ("of", "value", "logarithm", "deviation", "correlation")


class FittedRows(NamedTuple):
    """`entries` with a `Distribution` each, and the correlation [F, F] of their normals."""

    entries: list[Entry]
    distributions: list[Distribution]
    correlation: np.ndarray


def read_fitted(file, name: str | None, numbers: EntryNumbers, notes: list[str]) -> FittedRows:
    """Replaces the case's numbers by the fitted values, and returns the uncertainty of these.

    The logarithm of a number that was fitted as its logarithm is normal about that of the fitted
    value; all other numbers are normal.
    """
    entries: list[Entry] = []
    distributions: list[Distribution] = []
    if name is None:
        return FittedRows(entries, distributions, np.zeros((0, 0)))
    section = TableContext(file, "case", notes)
    rows = read_rows(FileReference(section, "fitted", name), COLUMNS)
    for row in rows:
        line = _Line(row)
        entry = numbers.one(line, "of", row.cells["of"])
        if entry in entries:
            raise row.error("of", "this number appears twice")
        unit = numbers.unit(*entry)
        value = quantity(line, "value", row.cells["value"], unit, ANY)
        numbers.check(line, "value", row.cells["value"], entry, value)
        if row.cells["logarithm"] not in ("true", "false"):
            raise row.error("logarithm", "it must be true or false")
        log = row.cells["logarithm"] == "true"
        if log and value <= 0:
            raise row.error("value", "a number fitted as its logarithm must be above 0")
        text, local = row.cells["deviation"], "1" if log else unit
        spread = quantity(line, "deviation", text, local, NOT_NEGATIVE, difference=True)
        # Nothing has read the number yet: all later uses are of the fitted one.
        numbers.givens[entry[0]].values[entry[1]] = value
        distribution = Distribution("logarithm" if log else "normal", spread)
        if spread > 0:
            check_drawn(TableContext(file, "fitted", notes), text, distribution, numbers, entry)
        entries.append(entry)
        distributions.append(distribution)
    metadata = ", ".join(row.cells["of"] for row in rows)
    notes.append(f"{name} has the values and uncertainties of {metadata}, as fitted to data.")
    return FittedRows(entries, distributions, _correlation(rows))


def _correlation(rows: list[Row]) -> np.ndarray:
    result = np.eye(len(rows))
    for i, row in enumerate(rows):
        try:
            numbers = [float(part) for part in row.cells["correlation"].split()]
        except ValueError:
            numbers = []
        if len(numbers) != len(rows) or not np.isfinite(numbers).all():
            message = f"it must be {len(rows)} numbers, one for each line, with spaces between them"
            raise row.error("correlation", message)
        result[i] = numbers
    if not np.allclose(result, result.T, atol=1e-6) or (np.linalg.eigvalsh(result) <= 1e-12).any():
        message = "this is not a correlation matrix (not symmetric, or not positive definite)"
        raise rows[0].error("correlation", message)
    return (result + result.T) / 2


class _Line(NamedTuple):
    """A line of the file as the place of a mistake."""

    row: Row

    def error(self, key: str, value: Any, allowed: str) -> CaseError:
        return self.row.error(key, allowed)
