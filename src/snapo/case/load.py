"""Reads a case from its files: a TOML file, a folder with `case.toml`, or a workbook."""

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .error import CaseError, Unquoted
from .table import not_utf8
from .toml import impossible_moment
from .workbook import unpacked

DEEPEST = 20  # levels of tables and lists
KEY = re.compile(r"\s*([\w.\"' -]+?)\s*=")
HEADER = re.compile(r"\s*\[\[?\s*([\w.\"' -]+?)\s*\]\]?\s*(#.*)?")
TOO_DEEP = "the tables of this file are nested too deeply; no case needs more than a few levels"


def load(path: Path) -> tuple[Path, dict[str, Any]]:
    """Reads the case at `path`, a TOML file or a folder with `case.toml`; returns the name of the
    file and its data."""
    if path.suffix.lower() == ".xlsx" and path.is_file():
        path = unpacked(path)
    file = path / "case.toml" if path.is_dir() else path
    if not file.is_file():
        message = "a case must be a TOML file, or a folder that contains case.toml"
        raise CaseError(str(path), "", None, message)
    try:
        text = file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CaseError(str(file), "", None, not_utf8(error)) from None
    except OSError as error:
        raise CaseError(str(file), "", None, f"cannot be read ({error.strerror})") from None
    if not text.strip():
        raise CaseError(str(file), "", None, "the file is empty; `snapo new` writes a case")
    return file, tables_of(file, text)


def tables_of(file: Path, text: str) -> dict[str, Any]:
    """The tables in a TOML text. **Raises:** `CaseError` with the line of a mistake."""
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _not_toml(file, text, str(error)) from None
    except RecursionError:
        raise CaseError(str(file), "", None, TOO_DEEP) from None
    if is_deep(data):
        raise CaseError(str(file), "", None, TOO_DEEP)
    return data


def is_deep(data: Any) -> bool:
    """Whether tables and lists are nested in more levels than any case needs."""
    level = [data]
    for _ in range(DEEPEST):
        inner = (item.values() if isinstance(item, dict) else item for item in level)
        level = [x for entry in inner for x in entry if isinstance(x, dict | list)]
    return bool(level)


def _not_toml(file: Path, text: str, message: str) -> CaseError:
    """The parser's message as an error with its line."""
    result = re.search(r"line (\d+)", message)
    number = int(result[1]) if result else len(text.rstrip().splitlines())  # "at end of document"
    lines = text.splitlines()[:number]
    got = lines[-1].strip()
    if moment := impossible_moment(got.partition("=")[2] if KEY.match(got) else got):
        where = ", ".join(filter(None, (f"line {number}", _key_at(lines))))
        return CaseError(str(file), where, Unquoted(moment[0]), moment[1])
    subject = f"this is not valid TOML ({message.partition(' (at ')[0]})"
    return CaseError(str(file), f"line {number}", got, subject)


def _key_at(lines: Sequence[str]) -> str:
    """The key on the last line of a text, with its table; "" if there is none."""
    keys = [(i, match[1]) for i, line in enumerate(lines) if (match := KEY.match(line))]
    if not keys:
        return ""
    headers = [match[1] for line in lines[: keys[-1][0]] if (match := HEADER.fullmatch(line))]
    return ".".join([*headers[-1:], keys[-1][1]])
