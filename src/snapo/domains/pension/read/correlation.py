"""Reads `[correlations]`: a square matrix with names, checked, and repaired only when asked."""

from collections.abc import Sequence

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import Unquoted
from snapo.case.given import Copies, FilePosition, NoPosition
from snapo.case.table import TableContext

from ..market.correlation import check_correlation, nearest
from ..quantities import NUMBER
from ..records.market import Correlation
from .cells import empty, unique
from .tables import CorrelationsTable

CORRELATION = NUMBER.of("model", meaning="a correlation; it moves together with its mirror")
SMALLEST = 1e-8  # eigenvalue that a matrix must have to count as positive definite
EQUAL = 1e-9


def read_correlations(
    section: TableContext, table: CorrelationsTable | None, available: Sequence[str]
) -> Correlation:
    """The matrix in `table`; without it, everything is independent."""
    folded = [name.lower() for name in available]
    for i, name in enumerate(folded):
        if name in folded[:i]:
            message = "ratings, currencies and classes with a separate shock need different names"
            raise section.error("file", available[i], message)
    if table is None:
        return Correlation((), empty("correlation"))
    rows = read_rows(FileReference(section, "file", table.file), ("name",))
    names = _names(rows, available, folded)
    matrix = _matrix(rows)
    smallest, change = check_correlation(matrix), 0.0
    if smallest < SMALLEST:
        if not table.repair:
            got = Unquoted(f"a matrix whose smallest eigenvalue is {smallest:.3g}")
            message = (
                "a correlation matrix is positive definite; repair = true takes the nearest one"
            )
            raise section.error("file", got, message)
        matrix, change = nearest(matrix)
        section.notes.append(
            f"{table.file} was not positive definite (smallest eigenvalue {smallest:.3g}); in the "
            f"nearest matrix that is, entries changed by {change:.3g} at most."
        )
    below = np.tril_indices(len(names), -1)
    labels = [f"{names[i]}, {names[j]}" for i, j in zip(*below)]
    columns = [name.lower() for name in names]
    positions: list[FilePosition] = [rows[i].position(columns[j]) for i, j in zip(*below)]
    for k, (i, j) in enumerate(zip(*below)):
        if rows[j].cells[columns[i]]:
            positions[k] = Copies((positions[k], rows[j].position(columns[i])))
    if change:
        reason = f"the matrix of {table.file} was repaired: the case has other numbers"
        positions = [NoPosition(reason)] * len(positions)
    located = tuple(positions)
    return Correlation(
        names, CORRELATION.input("correlation", matrix[below], labels, positions=located), change
    )


def _names(rows: Sequence[Row], available: Sequence[str], folded: Sequence[str]) -> tuple[str, ...]:
    """The names of the rows, which must be those of the columns in the same order."""
    unique(rows, "name")
    names = []
    for row in rows:
        name = row.cells["name"].lower()
        if name not in folded:
            raise row.error(
                "name", f"nothing random is called this; known are {', '.join(available)}"
            )
        names.append(available[folded.index(name)])
    columns = [column for column in rows[0].cells if column != "name"]
    if columns != [name.lower() for name in names]:
        head = Row(rows[0].file, 1, {"header": f"the columns {', '.join(columns)}"})
        message = f"the columns must be those of the rows, in their order: {', '.join(names)}"
        raise head.error("header", message)
    return tuple(names)


def _matrix(rows: Sequence[Row]) -> np.ndarray:
    """[k, k], ones on the diagonal and symmetric; cells above the diagonal may be empty."""
    columns = [row.cells["name"].lower() for row in rows]
    matrix = np.eye(len(rows))
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            if j > i and not row.cells[column]:
                continue
            value = row.number(column, -1.0, 1.0)
            if i == j and value != 1:
                raise row.error(column, "the diagonal is 1")
            if j < i:
                matrix[i, j] = matrix[j, i] = value
    for i, row in enumerate(rows):
        for j in range(i + 1, len(rows)):
            text = row.cells[columns[j]]
            if text and abs(float(text) - matrix[i, j]) > EQUAL:
                message = f"a correlation matrix is symmetric, and its mirror is {matrix[i, j]:g}"
                raise row.error(columns[j], message)
    return matrix
