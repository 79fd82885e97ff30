"""A case from its files: a TOML file, a folder with `case.toml`, or a workbook."""

import re
import tomllib
from pathlib import Path
from typing import Any

from .error import CaseError
from .table import not_utf8
from .workbook import unpacked

DEEPEST = 20  # levels of tables and lists
TOO_DEEP = "the tables of this file are nested too deeply; no case needs more than a few levels"


def load(path: Path) -> tuple[Path, dict[str, Any]]:
    """Reads the case at `path`, a TOML file or a folder with `case.toml`; returns file and data."""
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
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _not_toml(file, text, str(error)) from None
    except RecursionError:
        raise CaseError(str(file), "", None, TOO_DEEP) from None
    if is_deep(data):
        raise CaseError(str(file), "", None, TOO_DEEP)
    return file, data


def is_deep(data: Any) -> bool:
    """Whether tables and lists are nested in more levels than any case needs."""
    level = [data]
    for _ in range(DEEPEST):
        inner = (item.values() if isinstance(item, dict) else item for item in level)
        level = [x for entry in inner for x in entry if isinstance(x, dict | list)]
    return bool(level)


def _not_toml(file: Path, text: str, message: str) -> CaseError:
    """The parser's complaint, with the line that it is about."""
    result = re.search(r"line (\d+)", message)
    number = int(result[1]) if result else len(text.rstrip().splitlines())  # "at end of document"
    got = text.splitlines()[number - 1].strip()
    subject = f"this is not valid TOML ({message.partition(' (at ')[0]})"
    return CaseError(str(file), f"line {number}", got, subject)
