"""A workbook as the case that it holds: its sheets as TOML and CSV files in a folder beside it.

Formulas are read as the values that the spreadsheet program stored, and never evaluated.
"""

import csv
import datetime
import io
import re
import shutil
from pathlib import Path
from typing import Any

from ..columns import cell as as_text
from ..error import CaseError
from ..toml import to_toml
from .flat import Unreadable, tables
from .write import HEAD, NEEDED

LARGEST = 100 << 20  # bytes of a workbook
CSV = re.compile(r"[A-Za-z0-9_][\w .-]*\.csv", re.ASCII)
BESIDE = (".npy", ".parquet", ".py")  # files of a case that no sheet can hold


def unpacked(file: Path) -> Path:
    """The folder with case.toml and the CSVs of a workbook, written beside it under its name.

    **Raises:** `CaseError` where openpyxl is missing, the file is no workbook, or a sheet cannot be
    read; it names sheet and line.
    """
    book = _book(file)
    data: dict[str, Any] = {}
    results: list[tuple[str, Any, str]] = []
    texts: dict[str, str] = {}
    for sheet in book:
        if sheet.title.lower().endswith(".csv"):
            name = _plain_name(file, sheet.title)
            texts[name] = _csv(file, sheet)
        else:
            results += _keys(file, sheet)
    try:
        data = tables(results)
    except Unreadable as error:
        raise CaseError(str(file), "", None, str(error)) from None
    folder = file.with_suffix("")
    try:
        folder.mkdir(exist_ok=True)
        (folder / "case.toml").write_text(to_toml(data), encoding="utf-8")
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        for item in file.parent.iterdir():
            if item.is_file() and item.suffix.lower() in BESIDE:
                shutil.copyfile(item, folder / item.name)
    except OSError as error:
        message = f"its tables cannot be written to {folder} ({error.strerror})"
        raise CaseError(str(file), "", None, message) from None
    return folder


def _book(file: Path) -> Any:
    try:
        from openpyxl import load_workbook
    except ModuleNotFoundError:
        raise CaseError(str(file), "", None, NEEDED) from None
    try:
        if file.stat().st_size > LARGEST:
            raise ValueError("it is larger than 100 MB")
        values, written = (load_workbook(file, data_only=item) for item in (True, False))
    except Exception as error:  # a damaged archive can be anything
        message = f"this is not a workbook that can be read ({type(error).__name__}: {error})"
        raise CaseError(str(file), "", None, message) from None
    for sheet in written:
        for row in sheet.iter_rows():
            for cell in row:
                if cell.data_type == "f" and values[sheet.title][cell.coordinate].value is None:
                    where = f"sheet {sheet.title}, cell {cell.coordinate}"
                    message = (
                        "this formula has no stored value; save the file in a spreadsheet program"
                    )
                    raise CaseError(str(file), where, str(cell.value), message)
    return values


def _plain_name(file: Path, title: str) -> str:
    if not CSV.fullmatch(title):
        message = "a CSV's sheet is named as the file: letters, digits, - and _, such as curve.csv"
        raise CaseError(str(file), f"sheet {title}", None, message)
    return title


def _keys(file: Path, sheet: Any) -> list[tuple[str, Any, str]]:
    """The lines of a sheet of keys."""
    rows = list(sheet.iter_rows(values_only=True))
    head = [str(item or "").strip().lower() for item in (rows[0] if rows else ())]
    if head[:2] != list(HEAD[:2]):
        message = f"a sheet of keys has the columns {', '.join(HEAD)}; one of a CSV ends with .csv"
        raise CaseError(str(file), f"sheet {sheet.title}", None, message)
    keys = []
    for number, (key, value, *rest) in enumerate(rows[1:], start=2):
        kind = str((rest or [None])[0] or "")
        if key is None and value is None:
            continue
        if key is None or value is None or kind not in ("", "TOML"):
            message = 'a line has a key, a value, and "TOML" or nothing in the third column'
            raise CaseError(str(file), f"sheet {sheet.title}, line {number}", None, message)
        keys.append((str(key).strip(), _value(value), kind))
    return keys


def _value(value: Any) -> Any:
    if isinstance(value, datetime.datetime) and value.time() == datetime.time():
        return value.date()
    return value


def _csv(file: Path, sheet: Any) -> str:
    rows = [list(row) for row in sheet.iter_rows(values_only=True)]
    rows = [row for row in rows if any(item is not None for item in row)]
    if not rows:
        raise CaseError(str(file), f"sheet {sheet.title}", None, "the sheet is empty")
    width = max(i + 1 for row in rows for i, entry in enumerate(row) if entry is not None)
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(
        [as_text(x) for x in row[:width]] for row in rows
    )
    return text.getvalue()
