"""Files that are taken away: what is shown as CSV, a case as TOML files or as a workbook."""

import csv
import io
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

HEADER = ("what", "input", "label", "number", "standard_error", "low", "high")


def csv_of(rows: Iterable[Sequence[Any]]) -> str:
    """Rows as CSV; a text that a spreadsheet would take for a formula is marked as text."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    for row in rows:
        writer.writerow([_cell(item) for item in row])
    return out.getvalue()


def _cell(value: Any) -> Any:
    if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r"):
        return "'" + value
    return value


def page_rows(tables: Mapping[str, Any]) -> Iterator[Sequence[Any]]:
    """Everything that the page shows, one number in each row, under `HEADER`.

    `tables`: those of `Moves.stages` by name, with the moved "values" and "chosen". A derivative
    has the limits of its interval in place of a standard error.
    """
    yield HEADER
    for row in _numbers(tables):
        yield (*row, *(None,) * (len(HEADER) - len(row)))


def _numbers(tables: Mapping[str, Any]) -> Iterator[Sequence[Any]]:
    """The rows, without the columns that end them empty."""
    table = tables.get("value") or {}
    yield ("value", "", "", table.get("value"), table.get("standard_error"))
    yield ("change", "", "", table.get("change"), table.get("change_error"))
    for name, value in (tables.get("chosen") or {}).items():
        yield ("chosen", name, str(value), None, None)
    for name, numbers in (tables.get("values") or {}).items():
        for i, number in enumerate(numbers):
            yield ("moved", name, str(i + 1), number, None)
    yield from _sections(tables)
    for item in tables.get("deltas") or []:
        of = f"{item['of']} by {item['input']}" if "of" in item else item["input"]
        yield ("move", of, "", item["effect"], None, item["low"], item["high"])
        for row in item["rows"]:
            yield ("delta", of, row["label"], row["value"], None, row["low"], row["high"])
    for item in tables.get("fans") or []:
        for key in ("mean", "p05", "p25", "p75", "p95"):
            for i, number in enumerate(item[key]):
                yield (f"{key} over time", item["name"], str(i), number, None)


def _sections(tables: Mapping[str, Any]) -> Iterator[Sequence[Any]]:
    """Today's decision and the domain's own sections: every number with its column's name."""
    today = tables.get("today") or {}
    for name, number, unit in today.get("facts", ()):
        yield ("today", name, unit, number, None)
    for item in tables.get("sections") or []:
        names = [f"{name}, {unit}" if unit else name for name, unit in item["columns"]]
        for row in item["rows"]:
            for name, cell in zip(names[1:], row[1:], strict=True):
                number = cell if isinstance(cell, int | float) else None
                label = name if number is not None or cell is None else f"{name}: {cell}"
                yield (item["title"], str(row[0]), label, number, None)


def zipped(folder: Path, name: str) -> bytes:
    """The files of a folder in a zip, in a folder `name`; links are left out."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed:
        for file in sorted(folder.iterdir()):
            if file.is_file() and not file.is_symlink():
                packed.write(file, f"{name}/{file.name}")
    return out.getvalue()
