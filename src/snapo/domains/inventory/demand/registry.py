"""Collects the kinds of demand in this folder, and reads `[demand]` as the kind that it names."""

import pkgutil
from collections.abc import Mapping
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from snapo.case.given import CaseInput
from snapo.case.table import TableContext, parse, record_kinds

from .base import KINDS, Demand

for _file in pkgutil.iter_modules([str(Path(__file__).parent)]):
    if _file.name != Path(__file__).stem:
        import_module(f"{__package__}.{_file.name}")


def kinds() -> dict[str, type[Demand]]:
    """{name in `[demand]`: kind of demand}, for all kinds."""
    return dict(sorted(KINDS.items()))


def read_demand(
    section: TableContext, data: Mapping[str, Any], unit: str, maximum: float
) -> Demand:
    """The demand of the table `[demand]`, in `unit`; `maximum`: the largest factor of a period."""
    kind = data.get("kind")
    record_kinds(data, section.name, "kind", KINDS)
    if not isinstance(kind, str) or kind not in KINDS:
        available = ", ".join(f'"{item}"' for item in sorted(KINDS))
        raise section.error("kind", kind, f"it must be one of {available}")
    table = parse(KINDS[kind].table, data, str(section.file), section.name)
    demand = KINDS[kind].read(section, table, maximum)
    parts = {item.name: getattr(demand, item.name) for item in fields(demand)}
    numbers = {name: x for name, x in parts.items() if isinstance(x, CaseInput)}
    return replace(demand, **{name: replace(x, unit=unit) for name, x in numbers.items()})
