"""The list of unit operations, and the reading of `[units.NAME]`."""

import inspect
from collections.abc import Iterable
from typing import Any

from snapo.case.table import TableContext, parse, record_kinds

from ..read.numbers import check_name, suggest
from ..read.reader import Reader
from .crystalliser import Crystalliser
from .dissolution import Dissolution
from .dryer import Dryer
from .filter import Filter
from .filter_dryer import FilterDryer
from .hydrogenation import Hydrogenation
from .msmpr import Msmpr
from .operation import Unit
from .reactor import Reactor
from .solids.granulation import Granulation
from .solids.tablet_press import TabletPress
from .splitter import Splitter
from .tank import Tank
from .thickener import Thickener
from .tray_dryer import TrayDryer
from .wet_mill import WetMill

OPERATIONS = (
    Reactor,
    Hydrogenation,
    Crystalliser,
    Msmpr,
    WetMill,
    Filter,
    FilterDryer,
    Dryer,
    TrayDryer,
    Granulation,
    TabletPress,
    Dissolution,
    Tank,
    Splitter,
    Thickener,
)

MEMBERS = ("type", "variant", "title", "table", "reacts", "symbols", "assumptions")
Variants = dict[str, type[Unit]]


def catalogue(operations: Iterable[type[Unit]]) -> dict[str, Variants]:
    """The unit operations, {type: {variant: class}}; the first variant is the default.

    **Raises:** `TypeError` if a class is not complete, or two have the same name.
    """
    table: dict[str, Variants] = {}
    for operation in operations:
        missing = sorted(getattr(operation, "__abstractmethods__", ()))
        missing += [name for name in MEMBERS if not hasattr(operation, name)]
        if missing or inspect.isabstract(operation):
            raise TypeError(f"The unit operation {operation.__name__} has no {', '.join(missing)}.")
        variants = table.setdefault(operation.type, {})
        if operation.variant in variants or (variants and "" in (operation.variant, *variants)):
            raise TypeError(
                f'Two unit operations are of type "{operation.type}", {operation.variant!r}.'
            )
        variants[operation.variant] = operation
    return table


TYPES = catalogue(OPERATIONS)


def read_units(file, units: dict, species: tuple[str, ...], notes: list[str]) -> tuple[Unit, ...]:
    """All units, in the order of the file."""
    return tuple(_unit(file, name, raw, species, notes) for name, raw in units.items())


def _unit(file, name: str, raw: Any, species: tuple[str, ...], notes: list[str]) -> Unit:
    check_name(TableContext(file, "units", notes), name, name)
    section = TableContext(file, f"units.{name}", notes)
    kind = raw.get("type") if isinstance(raw, dict) else None
    if not isinstance(kind, str) or kind not in TYPES:
        text = ", ".join(f'"{item}"' for item in TYPES)
        if kind is None:
            raise section.error("type", None, f"this key is missing; it is one of {text}")
        hint = suggest(str(kind), TYPES, "type")
        raise section.error("type", kind, f"it must be one of {text}; {hint}")
    selected = _variant(section, raw, TYPES[kind])
    table = parse(selected.table, raw, str(file), section.name, notes)
    return selected.read(Reader(section, name, table, raw), species)


def _variant(section: TableContext, raw: dict, variants: Variants) -> type[Unit]:
    """The class that `kind` selects; a key of another class is reported with the kinds to which it
    belongs."""
    first, *others = variants
    if not others:
        return variants[first]
    kind = raw.get("kind", first)
    record_kinds(raw, section.name, "kind", variants)
    if not isinstance(kind, str) or kind not in variants:
        text = " or ".join(f'"{variant}"' for variant in variants)
        raise section.error("kind", kind, f"it must be {text}")
    selected = variants[kind]
    for key, value in raw.items():
        owners = [k for k, item in variants.items() if key in item.table.model_fields]
        if owners and kind not in owners:
            text = " or ".join(f'"{user}"' for user in owners)
            message = f'kind "{kind}" has no such key; it belongs to {text}'
            raise section.error(key, value, message)
    shared = set.intersection(*(set(entry.table.model_fields) for entry in variants.values()))
    if set(raw) <= set(selected.table.model_fields):
        for key, field in selected.table.model_fields.items():
            if field.is_required() and key not in shared and key not in raw:
                raise section.error(key, None, f'kind "{kind}" needs this key')
    return selected
