"""Tables that are no text: Parquet files and data frames, as the cells that a CSV would have.

A table is read the same whether it comes as CSV, Parquet or a frame: dates become 2024-12-31,
numbers keep all their digits, and what is missing is an empty cell.
"""

import csv
import datetime
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .error import CaseError

if TYPE_CHECKING:
    from .csv import FileReference

PARQUET = "Parquet needs the package pyarrow: pip install 'snapo[parquet]'"
FRAMES = "data frames need the package narwhals: pip install 'snapo[frames]'"


def parquet_lines(reference: "FileReference", path: Path) -> list[tuple[int, list[str]]]:
    """Line number and cells of a Parquet file, its column names first, as of a CSV.

    **Raises:** `CaseError` where pyarrow is missing, or the file is damaged or nested.
    """
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise reference.error(f"{PARQUET}; or use a CSV file") from None
    try:
        table = parquet.read_table(path)
        columns = [column.to_pylist() for column in table.columns]
    except Exception as error:  # of Arrow, whatever is wrong with the file
        message = f"this is not a Parquet file ({str(error).strip().splitlines()[0]})"
        raise CaseError(reference.name, "", None, message) from None
    return list(enumerate(_lines(table.column_names, zip(*columns)), start=1))


def _lines(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> Iterable[list[str]]:
    yield [str(name).strip() for name in names]
    for row in rows:
        yield [cell(value) for value in row]


def cell(value: Any) -> str:
    """A value as a CSV of a case has it; "" for nothing."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, datetime.datetime):
        day = value.time() == datetime.time() and value.tzinfo is None
        return value.date().isoformat() if day else value.isoformat(" ")
    if isinstance(value, datetime.date):
        return value.isoformat()
    return repr(value) if isinstance(value, float) else str(value).strip()


def write_table(frame: Any, file: Path | str) -> Path:
    """Writes a data frame (pandas, polars, pyarrow …) as a file that a case can name.

    The file's ending says how: `.csv` or `.parquet`. Column names are those of the file; an index
    is left out. Returns the path.

    **Raises:** `ModuleNotFoundError` where narwhals or pyarrow is missing, `ValueError` for
    another ending, `TypeError` for an object that is no frame.

    >>> snapo.write_table({"month": ["2025-01"]}, "curve.csv")
    Traceback (most recent call last):
    TypeError: write_table: a dict is no data frame; give one of pandas, polars or pyarrow.
    """
    try:
        import narwhals as nw
    except ModuleNotFoundError:
        raise ModuleNotFoundError(f"write_table: {FRAMES}") from None
    file = Path(file)
    try:
        table = nw.from_native(frame, eager_only=True)
    except TypeError:
        message = (
            f"a {type(frame).__name__} is no data frame; give one of pandas, polars or pyarrow."
        )
        raise TypeError(f"write_table: {message}") from None
    match file.suffix.lower():
        case ".csv":
            with file.open("w", newline="", encoding="utf-8") as stream:
                writer = csv.writer(stream, lineterminator="\n")
                writer.writerows(_lines(table.columns, table.iter_rows()))
        case ".parquet":
            try:
                import pyarrow.parquet as parquet
            except ImportError:
                raise ModuleNotFoundError(f"write_table: {PARQUET}") from None
            parquet.write_table(table.to_arrow(), file)
        case other:
            raise ValueError(f"write_table: the ending {other!r}; allowed are .csv and .parquet.")
    return file
