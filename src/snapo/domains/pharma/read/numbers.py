"""Raw values of keys become numbers in the domain's units: quantities, lists and profiles. Also
checks the names of species, feeds, units and ports.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, Protocol

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput, FilePosition, KeyedUnit, QuantityKey
from snapo.case.quantity import Range
from snapo.case.table import (
    LARGEST,
    TOO_LARGE,
    CaseTable,
    TableContext,
    doc,
    keys_of,
    nearest,
    parse,
)

from ..time.profile import Profile
from .quantities import PURE, Conversion, UnitError, check_basis, conversion, own_basis, split

ZERO_CELSIUS = 273.15
EXAMPLES = {"K": "313.15 K", "s": "3600 s", "m": "20 um", "kmol/m3": "0.33 mol/L", "m3": "60 L"}


class Location(Protocol):
    """The position of a quantity: a key of a table, or a cell of a file."""

    def error(self, key: str, value: Any, allowed: str) -> CaseError:
        """The mistake at this position."""
        ...


class ProfileTable(CaseTable):
    """{ nodes = ["313.15 K", "278.15 K"], at = [0, 1], kind = "linear", ramp = "0.5 K/min" }"""

    nodes: Any = doc(
        "values at the nodes of the profile",
        allowed='a list of quantities, such as ["313 K", "278 K"]',
    )
    at: Any = doc(
        "times of the nodes, by default evenly spaced",
        None,
        "shares of the unit's duration, rising from 0 to 1",
    )
    kind: Literal["linear", "constant"] = doc("values between the nodes", "linear")
    ramp: Any = doc(
        "fastest change, if limited", None, 'a quantity in quotation marks, such as "0.5 K/min"'
    )


ANY, NOT_NEGATIVE, POSITIVE = Range(), Range(0.0), Range(0.0, endpoints="(]")
# Processes in liquids run at no other temperatures; a number beyond was typed in another unit.
TEMPERATURE = Range(100.0, 1000.0, note=" (25 degC is 298.15 K)")
LIQUID = Range(0.0, 3000.0)  # mass per volume of a liquid
DENSITY = Range(300.0, 10_000.0)  # of crystals
POROSITY = Range(0.1, 0.95)  # of a cake of crystals
SHARE = Range(0.0, 1.0, noun="a share")
INSIDE = Range(0.0, 1.0, "()", noun="a share")


def range_text(bounds: Range, unit: str) -> str:
    """The numbers of a range, with the unit of its ends."""
    if unit in PURE:
        return str(bounds)
    note = f" {unit}{bounds.note}" if math.isfinite(bounds.high) else bounds.note
    return str(bounds._replace(noun="a quantity", note=note))


def quantity(
    section: Location,
    key: str,
    raw: Any,
    unit: str,
    bounds: Range = ANY,
    difference: bool = False,
    basis: str | None = None,
) -> float:
    """The number under `key` in the domain's `unit`; see `conversion` for a `difference`. `basis`:
    the basis of a share, by default the basis that belongs to the name of the key."""
    number, name = _split(section, key, raw, unit)
    try:
        if unit in PURE:
            check_basis(name, own_basis(key) if basis is None else basis)
        value = conversion(name, unit, difference)(number)
    except UnitError as error:
        raise section.error(key, raw, str(error)) from None
    allowed = f"it must be {range_text(bounds, unit)}"
    if not math.isfinite(value):
        raise section.error(key, raw, f"{allowed}, and finite")
    if not bounds.contains(value):
        raise section.error(key, raw, allowed)
    if abs(value) > LARGEST:
        raise section.error(key, raw, f"{allowed}; {TOO_LARGE}")
    if unit == "K" and not difference and not TEMPERATURE.contains(value):
        raise section.error(key, raw, f"it must be {range_text(TEMPERATURE, unit)}")
    return value


def unit_of(section: Location, key: str, raw: Any, unit: str) -> str:
    """The unit that the user wrote under `key`, for a quantity in the domain's `unit`."""
    return _split(section, key, raw, unit)[1] or "1"


def _split(section: Location, key: str, raw: Any, unit: str) -> tuple[float, str]:
    if isinstance(raw, bool) or not isinstance(raw, str | int | float):
        raise section.error(key, raw, f"it must be {_example(unit)}")
    if not isinstance(raw, str):
        if unit not in PURE:
            raise section.error(key, raw, f"a quantity needs its unit, {_example(unit)}")
        return float(raw), ""
    try:
        number, name = split(raw)
    except UnitError as error:
        raise section.error(key, raw, f"{error}, {_example(unit)}") from None
    if not name and unit not in PURE:
        raise section.error(key, raw, f"a quantity needs its unit, {_example(unit)}")
    return number, name


def _example(unit: str) -> str:
    if unit in PURE:
        return "a number without a unit, or in %"
    return f'such as "{EXAMPLES.get(unit, f"1.5 {unit}")}"'


def case_input(
    name: str, values: np.ndarray, labels: Sequence[str], unit: str,
    index: np.ndarray | None = None, meaning: str = "", local: str = "", bounds: Range = ANY,
    positions: tuple[FilePosition, ...] = (),
) -> CaseInput:  # fmt: skip
    """Numbers of a case with their metadata; they are used in their order unless there is an
    `index`.

    `local`: the case's unit. Temperatures are moved by a kelvin, and all other numbers by a share
    of their value.
    """
    low, high = (TEMPERATURE if unit == "K" else bounds).closed
    size = float(np.max(np.abs(values), initial=0.0))
    return CaseInput(
        name,
        values,
        tuple(labels),
        unit,
        np.arange(len(values)) if index is None else index,
        bump=1e-5 * size or None,
        move=1.0 if unit == "K" else None,
        display_unit=local if local not in PURE else "",
        display_factor=1.0 if local in PURE else 1 / conversion(local, unit, difference=True).scale,
        group=name.partition(".")[0],
        meaning=meaning,
        low=low,
        high=high,
        positions=positions,
    )


def position(section: TableContext, key: str, unit: str) -> FilePosition:
    """The position of a number under a key such as "moments[0]", in the domain's `unit`."""
    path = (*section.keys, *keys_of(key))
    return path if unit in PURE else QuantityKey(path, unit)


def positions(section: TableContext, key: str, raw: Any, unit: str) -> tuple[FilePosition, ...]:
    """The positions of a list, which may have one unit for all."""
    if not isinstance(raw, dict):
        return tuple(position(section, f"{key}[{i}]", unit) for i in range(len(raw)))
    same = conversion(raw["unit"], unit) == Conversion(1.0, 0.0)
    units = {} if same else {f"{key}.unit": unit or "1"}
    return with_units(section, f"{key}.value", len(raw["value"]), units)


def with_units(
    section: TableContext, key: str, count: int, units: Mapping[str, str]
) -> tuple[FilePosition, ...]:
    """The positions of a list of numbers that are written together with the keys of their units."""
    path = *section.keys, *keys_of(key)
    written = tuple(((*section.keys, *keys_of(name)), unit) for name, unit in units.items())
    return tuple(KeyedUnit((*path, i), written) if written else (*path, i) for i in range(count))


def single(
    section: TableContext, name: str, key: str, raw: Any, unit: str, bounds: Range = ANY,
    text: str = "",
) -> CaseInput:  # fmt: skip
    """One number, index [], called `name` in tables of sensitivities."""
    value = quantity(section, key, raw, unit, bounds)
    local = unit_of(section, key, raw, unit)
    where = (position(section, key, unit),)
    return case_input(name, np.array([value]), ("",), unit, np.array(0), text, local, bounds, where)


def listed(
    section: TableContext, key: str, raw: Any, unit: str, bounds: Range = ANY
) -> list[float]:
    """The numbers of ["308 K", "295 K"], or of { value = [308, 295], unit = "K" }."""
    if isinstance(raw, dict):
        if set(raw) != {"value", "unit"} or not isinstance(raw["unit"], str):
            message = f"it must be {{ value = [1.0, 2.0], unit = {_example(unit)[8:]} }}"
            raise section.error(key, raw, message)
        value = raw["value"]
        numbers = isinstance(value, list) and all(
            isinstance(item, int | float) and not isinstance(item, bool) for item in value
        )
        if not numbers:
            raise section.error(f"{key}.value", value, "it must be a list of numbers")
        raw = [f"{entry!r} {raw['unit']}" for entry in value]
    if not isinstance(raw, list) or not raw:
        message = f"it must be a list of quantities, each {_example(unit)}"
        raise section.error(key, raw, message)
    return [quantity(section, f"{key}[{i}]", each, unit, bounds) for i, each in enumerate(raw)]


def several(
    section: TableContext, name: str, key: str, raw: Any, unit: str,
    labels: Sequence[str] | str = "",
    bounds: Range = ANY, text: str = "",
) -> CaseInput:  # fmt: skip
    """A list of numbers, index [n]; labels are `labels`, or that text with the entry's number."""
    values = np.array(listed(section, key, raw, unit, bounds))
    if isinstance(labels, str):
        labels = tuple(f"{labels}{i}" for i in range(len(values)))
    where = positions(section, key, raw, unit)
    return case_input(name, values, labels, unit, None, text, "", bounds, where)


def absent(name: str, unit: str) -> CaseInput:
    """A number that the case does not have: no values, index [0]."""
    return CaseInput(name, np.zeros(0), (), unit, np.zeros(0, np.int64))


def profile(
    section: TableContext, name: str, key: str, raw: Any, unit: str, bounds: Range = ANY,
    meaning: str = "",
) -> Profile:  # fmt: skip
    """A control over a unit's time: one quantity, or a table with nodes."""
    if not isinstance(raw, dict):
        value = single(section, name, key, raw, unit, bounds, meaning)
        return Profile("constant", np.array([0.0, 1.0]), replace(value, index=np.arange(1)), None)
    table = parse(ProfileTable, raw, str(section.file), f"{section.name}.{key}")
    inner = TableContext(section.file, f"{section.name}.{key}", section.notes)
    values = listed(inner, "nodes", table.nodes, unit, bounds)
    if table.kind == "linear" and len(values) < 2:
        raise inner.error("nodes", table.nodes, 'kind "linear" needs two nodes or more')
    edges = len(values) if table.kind == "linear" else len(values) + 1
    shares = np.linspace(0.0, 1.0, edges) if table.at is None else _shares(inner, table.at, edges)
    labels = tuple(f"node {i}" for i in range(len(values)))
    where = positions(inner, "nodes", table.nodes, unit)
    numbers = case_input(name, np.array(values), labels, unit, None, meaning, "", bounds, where)
    ramp = None
    if table.ramp is not None:
        ramp = quantity(inner, "ramp", table.ramp, f"{unit}/s", POSITIVE, difference=True)
    return Profile(table.kind, shares, numbers, ramp)


def _shares(section: TableContext, raw: Any, count: int) -> np.ndarray:
    shares = np.array(listed(section, "at", raw, "1", SHARE))
    if len(shares) != count:
        raise section.error("at", raw, f"it must be {count} shares of the unit's duration")
    if shares[0] != 0 or shares[-1] != 1 or (np.diff(shares) <= 0).any():
        raise section.error("at", raw, "the shares must increase from 0 to 1")
    return shares


def suggest(name: str, available, noun: str) -> str:
    """The known name nearest to an unknown one, or all known names."""
    plural = noun if noun.endswith("s") else f"{noun}s"
    return (
        nearest(name, available)
        .replace("known keys", f"known {plural}", 1)
        .replace("known key", f"known {noun}", 1)
    )


NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


RESERVED = ("process", "kinetics")


def check_name(section: TableContext, key: str, name: Any) -> str:
    """A name of letters, digits, - and _, so that "unit.measure" can be taken apart."""
    if not isinstance(name, str) or NAME.fullmatch(name) is None or name in RESERVED:
        message = "a name has letters, digits, - and _, and begins with a letter"
        reserved = " and ".join(f'"{item}"' for item in RESERVED)
        raise section.error(key, name, f"{message}; {reserved} are reserved")
    return name
