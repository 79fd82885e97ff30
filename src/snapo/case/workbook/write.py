"""A case of TOML and CSV files as one workbook, with native numbers and dates."""

import csv
import datetime
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..csv import DAY, NUMBER
from ..dialect import separator
from ..error import CaseError
from .flat import is_kept, lines

TOP, HEAD = "case", ("key", "value", "as", "note")
NEEDED = "workbooks need the package openpyxl: pip install 'snapo[xlsx]'"
NOTE = re.compile(r"(?:# )?([\w-]+) = [^#]*# (.+)")


def write_workbook(folder: Path, data: Mapping[str, Any], file: Path) -> None:
    """Writes the tables `data` of a case, and the CSV files in its folder, to a workbook.

    Keys at the top are on the sheet "case", each table has a sheet of its own name, and each CSV
    one of its file's name. Comments of case.toml are notes beside the keys.

    **Raises:** `CaseError` where openpyxl is missing.
    """
    try:
        from openpyxl import Workbook
        from openpyxl.styles import Font
    except ModuleNotFoundError:
        raise CaseError(str(file), "", None, NEEDED) from None
    book = Workbook()
    first = book.active
    assert first is not None
    first.title = TOP
    notes = _notes(folder / "case.toml")
    nested = {key: entry for key, entry in data.items() if isinstance(entry, dict | list)}
    _sheet(first, {key: value for key, value in data.items() if key not in nested}, notes)
    for key, item in nested.items():
        _sheet(book.create_sheet(_name(key, book.sheetnames)), {key: item}, notes)
    for item in sorted(folder.glob("*.csv")):
        sheet = book.create_sheet(_name(item.name, book.sheetnames))
        for row in _rows(item):
            sheet.append(row)
    for sheet in book:
        sheet.freeze_panes = "A2"
        for cell in sheet[1]:
            cell.font = Font(bold=True)
        for column, width in zip("ABCD", (34, 22, 8, 80)):
            sheet.column_dimensions[column].width = width if sheet.title[-4:] != ".csv" else 18
    book.save(file)


def _name(requested: str, taken: list[str]) -> str:
    if (
        len(requested) > 31
        or re.search(r"[\[\]:*?/\\']", requested)
        or requested.lower() in map(str.lower, taken)
    ):
        message = (
            "a sheet cannot have this name; rename the table or the file, at most 31 characters"
        )
        raise CaseError(requested, "", None, message)
    return requested


def _sheet(sheet: Any, data: Mapping[str, Any], notes: Mapping[str, str]) -> None:
    sheet.append(HEAD)
    for key, value, kind in lines(data):
        sheet.append([key, None, kind or None, notes.get(key.split(".")[-1])])
        _fill(sheet.cell(sheet.max_row, 2), value)


def _fill(cell: Any, value: Any) -> None:
    cell.value = value
    if isinstance(value, str):
        cell.data_type = "s"  # never a formula, whatever it begins with
        cell.number_format = "@"
    elif isinstance(value, datetime.date):
        cell.number_format = "yyyy-mm-dd"


def _notes(file: Path) -> dict[str, str]:
    """The comment behind each key of a TOML file, by the key's last word."""
    if not file.is_file():
        return {}
    result = map(NOTE.match, file.read_text(encoding="utf-8").splitlines())
    return {item[1]: item[2] for item in result if item}


def _rows(file: Path) -> list[list[Any]]:
    text = file.read_bytes().decode("utf-8-sig")
    selected = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    mark = separator(selected[0]) if selected else ","
    head, *rows = list(csv.reader(selected, delimiter=mark)) or [[]]
    plain = mark == ","  # other dialects keep their texts, which are read as they stand
    return [head, *([_native(cell.strip()) if plain else cell for cell in row] for row in rows)]


def _native(cell: str) -> Any:
    """A number or a day where the text is exactly one; else the text."""
    if DAY.fullmatch(cell) and cell >= "1901":
        try:
            return datetime.date.fromisoformat(cell)
        except ValueError:
            return cell
    if NUMBER.fullmatch(cell):
        number = float(cell)
        complete = number.is_integer() and abs(number) < 1e15
        if is_kept(number):
            return int(number) if complete else number
    return cell or None
