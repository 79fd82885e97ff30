"""Names that a user gives: of species, feeds, units and ports."""

import re
from typing import Any

from snapo.case.table import TableContext

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


RESERVED = ("process", "kinetics")


def check_name(section: TableContext, key: str, name: Any) -> str:
    """A name of letters, digits, - and _, so that "unit.measure" can be taken apart."""
    if not isinstance(name, str) or NAME.fullmatch(name) is None or name in RESERVED:
        message = "a name has letters, digits, - and _, and begins with a letter"
        reserved = " and ".join(f'"{item}"' for item in RESERVED)
        raise section.error(key, name, f"{message}; {reserved} are taken")
    return name
