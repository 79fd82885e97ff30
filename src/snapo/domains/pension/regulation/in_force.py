"""The state of the law at a date, from a file of dated rules."""

import datetime
import tomllib
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any, TypeVar

from ..read.cells import TableReader

AnyRules = TypeVar("AnyRules")


def in_force(
    section: TableReader,
    name: str,
    local: Mapping[str, str],
    day: datetime.date,
    made: Callable[[dict[str, Any]], AnyRules],
) -> AnyRules:
    """`made` of the newest version on `day` of the rules `name`, those of the package or a file.

    **Arguments:**

    - `local`: {name: file} of the rules that come with the package.

    **Raises:** `CaseError` where the file is missing or incomplete, or holds nothing for the day.
    """
    try:
        if name in local:
            text = (files(__package__ or "") / local[name]).read_text(encoding="utf-8")
        else:
            text = (section.file.parent / name).read_text(encoding="utf-8")
        versions = tomllib.loads(text)["version"]
        available = [(version["from"], version) for version in versions if version["from"] <= day]
    except FileNotFoundError:
        message = f"there is no such file, nor rules of this name ({', '.join(local)})"
        raise section.error("rules", name, message) from None
    except (tomllib.TOMLDecodeError, KeyError, TypeError, UnicodeDecodeError) as error:
        message = f"a TOML file with tables [[version]], each with a date from, is needed ({error})"
        raise section.error("rules", name, message) from None
    if not available:
        raise section.error("rules", name, f"no version holds on {day}")
    try:
        return made(max(available, key=lambda pair: pair[0])[1])
    except (KeyError, TypeError, ValueError) as error:
        message = f"its version for {day} has a missing or an invalid number: {error}"
        raise section.error("rules", name, message) from None
