"""Reads a workbook as a case: its sheets become TOML and CSV files in a folder next to it.

Formulas are read as the values that the spreadsheet program stored, and never evaluated.
"""

import csv
import datetime
import io
import math
import re
import shutil
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from .csv import DAY, NUMBER
from .csv import cell as as_text
from .dialect import separator
from .error import CaseError
from .toml import one_value, to_toml

PART = re.compile(r'([A-Za-z0-9_-]+|"(?:[^"\\]|\\.)*")((?:\[\d+\])*)(\.|$)', re.ASCII)
PLAIN = re.compile(r"[^\x00-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]+")
LARGEST_NUMBER = 1e15  # whole numbers beyond lose digits in a spreadsheet
TEXT = "TOML"  # the word next to a value that is written as TOML


class Unreadable(ValueError):
    """A key or a value of a sheet that is not possible in a case; the message is the reason."""


def lines(data: Mapping[str, Any]) -> Iterator[tuple[str, Any, str]]:
    """(key, value, "" or "TOML") of all values; a value that is not plain, such as a list, is TOML
    text."""
    for key, value in data.items():
        yield from _lines(_quoted(key), value)


def _lines(position: str, value: Any) -> Iterator[tuple[str, Any, str]]:
    if isinstance(value, Mapping) and value:
        for key, item in value.items():
            yield from _lines(f"{position}.{_quoted(key)}", item)
    elif isinstance(value, list) and value and all(isinstance(x, Mapping) and x for x in value):
        for i, item in enumerate(value):
            yield from _lines(f"{position}[{i}]", item)
    elif _is_plain(value):
        yield position, value, ""
    else:
        yield position, one_value(value), TEXT


def _quoted(key: str) -> str:
    return to_toml({key: 0}).partition(" = 0")[0]


def is_kept(number: float) -> bool:
    """Whether sixteen digits, the number that openpyxl writes, represent a number exactly."""
    return float(f"{number:.16g}") == number


def _is_plain(value: Any) -> bool:
    """Whether a cell of a spreadsheet can hold this value unchanged."""
    if isinstance(value, bool):
        return True
    if isinstance(value, int | float):
        return math.isfinite(value) and abs(value) < LARGEST_NUMBER and is_kept(value)
    if isinstance(value, str):
        odd = "_x" in value or value != value.strip()
        return bool(PLAIN.fullmatch(value)) and not odd and len(value) < 30_000
    day = isinstance(value, datetime.date) and not isinstance(value, datetime.datetime)
    return day and value.year >= 1901


def tables(result: Iterable[tuple[str, Any, str]]) -> dict[str, Any]:
    """The inverse of `lines`.

    **Raises:** `Unreadable` for a key that is invalid, occurs twice, or contradicts another key.
    """
    data: dict[str, Any] = {}
    for key, value, kind in result:
        if kind:
            try:
                (value,) = tomllib.loads(f"x = [{value}]")["x"]
            except (tomllib.TOMLDecodeError, ValueError, RecursionError):
                message = f"{str(value)[:60]!r} is not a valid value in TOML"
                raise Unreadable(f"{key}: {message}") from None
        _put(data, key, value)
    return data


def _steps(key: str) -> list[str | int]:
    steps: list[str | int] = []
    position = 0
    while position < len(key):
        match = PART.match(key, position)
        if not match or (match[3] == "." and match.end() == len(key)):
            raise Unreadable(
                f"{key!r} is not a key; write it like indexation.cap or reactions[0].name"
            )
        steps.append(next(iter(tomllib.loads(f"{match[1]} = 0"))))
        steps += [int(item) for item in re.findall(r"\d+", match[2])]
        position = match.end()
    return steps


def _put(data: dict[str, Any], key: str, value: Any) -> None:
    steps = _steps(key)
    here: Any = data
    for i, step in enumerate(steps):
        last = i == len(steps) - 1
        empty: Any = value if last else [] if isinstance(steps[i + 1], int) else {}
        if isinstance(step, int):
            if not isinstance(here, list) or step > len(here):
                raise Unreadable(
                    f"{key}: there is no entry {step} yet; entries are counted from 0, without gaps"
                )
            if step == len(here):
                here.append(empty)
            elif last:
                raise Unreadable(f"{key} appears twice")
        else:
            if not isinstance(here, dict):
                raise Unreadable(
                    f"{key}: this key is a list; write the number of an entry after it, such as [0]"
                )
            if last and step in here:
                raise Unreadable(f"{key} appears twice")
            here.setdefault(step, empty)
        here = here[step]  # pyright: ignore
        if not last and not isinstance(here, dict | list):
            raise Unreadable(
                f"{key}: a part of this key already has a value, so it cannot be a table"
            )


TOP, HEAD = "case", ("key", "value", "as", "note")
NEEDED = "workbooks need the package openpyxl: pip install 'snapo[xlsx]'"
NOTE = re.compile(r"(?:# )?([\w-]+) = [^#]*# (.+)")


def write_workbook(folder: Path, data: Mapping[str, Any], file: Path) -> None:
    """Writes the tables `data` of a case, and the CSV files in its folder, to a workbook.

    Keys at the top of the case are on the sheet "case", each table has a sheet with its name, and
    each CSV has a sheet with the name of its file. Comments of case.toml are notes next to the
    keys.

    **Raises:** `CaseError` if openpyxl is missing.
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
            "a sheet cannot have this name; rename the table or the file (at most 31 characters)"
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
    """The comment after each key of a TOML file, by the last part of the key."""
    if not file.is_file():
        return {}
    result = map(NOTE.match, file.read_text(encoding="utf-8").splitlines())
    return {item[1]: item[2] for item in result if item}


def _rows(file: Path) -> list[list[Any]]:
    text = file.read_bytes().decode("utf-8-sig")
    selected = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    mark = separator(selected[0]) if selected else ","
    head, *rows = list(csv.reader(selected, delimiter=mark)) or [[]]
    plain = mark == ","  # other dialects keep their texts, which are read unchanged
    return [head, *([_native(cell.strip()) if plain else cell for cell in row] for row in rows)]


def _native(cell: str) -> Any:
    """A number or a day if the text represents one exactly; otherwise the text."""
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


LARGEST = 100 << 20  # bytes of a workbook
CSV = re.compile(r"[A-Za-z0-9_][\w .-]*\.csv", re.ASCII)
BESIDE = (".npy", ".parquet", ".py")  # files of a case that no sheet can hold


def unpacked(file: Path) -> Path:
    """The folder with case.toml and the CSVs of a workbook, which is written next to the workbook
    and has its name.

    **Raises:** `CaseError` if openpyxl is missing, the file is not a workbook, or a sheet cannot be
    read; the message names sheet and line.
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
            suffixes = BESIDE if item.name == "case.toml" else (*BESIDE, ".toml")
            if item.is_file() and item.suffix.lower() in suffixes:
                shutil.copyfile(item, folder / item.name)
    except OSError as error:
        message = f"the tables of the workbook cannot be written to {folder} ({error.strerror})"
        raise CaseError(str(file), "", None, message) from None
    return folder


def _book(file: Path) -> Any:
    try:
        from openpyxl import load_workbook
    except ModuleNotFoundError:
        raise CaseError(str(file), "", None, NEEDED) from None
    try:
        if file.stat().st_size > LARGEST:
            raise ValueError("the workbook is larger than 100 MB")
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
                        "this formula has no stored value; open the file in a spreadsheet program "
                        "and save it"
                    )
                    raise CaseError(str(file), where, str(cell.value), message)
    return values


def _plain_name(file: Path, title: str) -> str:
    if not CSV.fullmatch(title):
        message = (
            "the sheet of a CSV has the name of the CSV, with letters, digits, - and _ only, such "
            "as curve.csv"
        )
        raise CaseError(str(file), f"sheet {title}", None, message)
    return title


def _keys(file: Path, sheet: Any) -> list[tuple[str, Any, str]]:
    """The lines of a sheet of keys."""
    rows = list(sheet.iter_rows(values_only=True))
    head = [str(item or "").strip().lower() for item in (rows[0] if rows else ())]
    if head[:2] != list(HEAD[:2]):
        message = (
            f"a sheet of keys must have the columns {', '.join(HEAD)}; the name of a sheet with a "
            "CSV ends in .csv"
        )
        raise CaseError(str(file), f"sheet {sheet.title}", None, message)
    keys = []
    for number, (key, value, *rest) in enumerate(rows[1:], start=2):
        kind = str((rest or [None])[0] or "")
        if key is None and value is None:
            continue
        if key is None or value is None or kind not in ("", "TOML"):
            message = 'a line must have a key, a value, and "TOML" or nothing in the third column'
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
