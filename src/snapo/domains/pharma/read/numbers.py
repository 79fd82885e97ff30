"""From the raw value of a key to numbers in the domain's units: quantities, lists, profiles."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.table import LARGEST, TOO_LARGE, TableContext, nearest, parse

from ..time.profile import Profile
from .fields import ProfileTable
from .quantities import PURE, UnitError, check_basis, conversion, own_basis, split

ZERO_CELSIUS = 273.15
EXAMPLES = {"K": "313.15 K", "s": "3600 s", "m": "20 um", "kmol/m3": "0.33 mol/L", "m3": "60 L"}


class Location(Protocol):
    """Where a quantity stands: a key of a table, or a cell of a file."""

    def error(self, key: str, value: Any, allowed: str) -> CaseError:
        """The mistake at this place."""
        ...


class ValueRange(NamedTuple):
    """A closed or open interval in the domain's unit, and its words."""

    low: float
    high: float
    open_low: bool
    description: str

    def contains(self, number: float) -> bool:
        above = number > self.low if self.open_low else number >= self.low
        return above and number <= self.high

    @property
    def smallest(self) -> float:
        """The smallest number that the interval holds."""
        return float(np.nextafter(self.low, math.inf)) if self.open_low else self.low


ANY = ValueRange(-math.inf, math.inf, False, "a finite number")
POSITIVE = ValueRange(0.0, math.inf, True, "above 0")
NOT_NEGATIVE = ValueRange(0.0, math.inf, False, "at least 0")
# Processes in liquids run at no other temperatures; a number beyond was typed in another unit.
TEMPERATURE = ValueRange(100.0, 1000.0, False, "from 100 K to 1000 K (25 degC is 298.15 K)")
LIQUID = ValueRange(0.0, 3000.0, False, "from 0 to 3000 kg/m^3")  # mass per volume of a liquid
DENSITY = ValueRange(300.0, 10_000.0, False, "from 300 to 10000 kg/m^3")  # of crystals
POROSITY = ValueRange(0.1, 0.95, False, "from 0.1 to 0.95")  # of a cake of crystals
SHARE = ValueRange(0.0, 1.0, False, "a share from 0 to 1")
INSIDE = ValueRange(0.0, float(np.nextafter(1.0, 0.0)), True, "between 0 and 1, without either")


def quantity(
    section: Location,
    key: str,
    raw: Any,
    unit: str,
    bounds: ValueRange = ANY,
    difference: bool = False,
    basis: str | None = None,
) -> float:
    """The number under `key` in the domain's `unit`; see `conversion` for a `difference`. `basis`:
    of a share, by default that of the key's name."""
    number, name = _split(section, key, raw, unit)
    try:
        if unit in PURE:
            check_basis(name, own_basis(key) if basis is None else basis)
        value = conversion(name, unit, difference)(number)
    except UnitError as error:
        raise section.error(key, raw, str(error)) from None
    if not math.isfinite(value) or not bounds.contains(value):
        raise section.error(key, raw, f"allowed is {bounds.description}")
    if abs(value) > LARGEST:
        raise section.error(key, raw, f"allowed is {bounds.description}; {TOO_LARGE}")
    if unit == "K" and not difference and not TEMPERATURE.contains(value):
        raise section.error(key, raw, f"allowed is {TEMPERATURE.description}")
    return value


def unit_of(section: Location, key: str, raw: Any, unit: str) -> str:
    """The unit that the owner wrote under `key`, for a quantity in the domain's `unit`."""
    return _split(section, key, raw, unit)[1] or "1"


def _split(section: Location, key: str, raw: Any, unit: str) -> tuple[float, str]:
    if isinstance(raw, bool) or not isinstance(raw, str | int | float):
        raise section.error(key, raw, f"allowed is {_example(unit)}")
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
    index: np.ndarray | None = None, meaning: str = "", local: str = "", bounds: ValueRange = ANY,
) -> CaseInput:  # fmt: skip
    """Numbers of a case with all that is said about them; used in order unless `index` says else.

    `local`: the owner's unit. Temperatures are moved by a kelvin, all else by a share of itself.
    """
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
        low=TEMPERATURE.low if unit == "K" else bounds.smallest,
        high=TEMPERATURE.high if unit == "K" else bounds.high,
    )


def single(
    section: TableContext, name: str, key: str, raw: Any, unit: str, bounds: ValueRange = ANY,
    text: str = "",
) -> CaseInput:  # fmt: skip
    """One number, index [], called `name` in tables of sensitivities."""
    value = quantity(section, key, raw, unit, bounds)
    local = unit_of(section, key, raw, unit)
    return case_input(name, np.array([value]), ("",), unit, np.array(0), text, local, bounds)


def listed(
    section: TableContext, key: str, raw: Any, unit: str, bounds: ValueRange = ANY
) -> list[float]:
    """The numbers of ["308 K", "295 K"], or of { value = [308, 295], unit = "K" }."""
    if isinstance(raw, dict):
        if set(raw) != {"value", "unit"} or not isinstance(raw["unit"], str):
            message = f"allowed is {{ value = [1.0, 2.0], unit = {_example(unit)[8:]} }}"
            raise section.error(key, raw, message)
        value = raw["value"]
        numbers = isinstance(value, list) and all(
            isinstance(item, int | float) and not isinstance(item, bool) for item in value
        )
        if not numbers:
            raise section.error(f"{key}.value", value, "allowed is a list of numbers")
        raw = [f"{entry!r} {raw['unit']}" for entry in value]
    if not isinstance(raw, list) or not raw:
        message = f"allowed is a list of quantities, each {_example(unit)}"
        raise section.error(key, raw, message)
    return [quantity(section, f"{key}[{i}]", each, unit, bounds) for i, each in enumerate(raw)]


def several(
    section: TableContext, name: str, key: str, raw: Any, unit: str,
    labels: Sequence[str] | str = "",
    bounds: ValueRange = ANY, text: str = "",
) -> CaseInput:  # fmt: skip
    """A list of numbers, index [n]; labels are `labels`, or that text with the entry's number."""
    values = np.array(listed(section, key, raw, unit, bounds))
    if isinstance(labels, str):
        labels = tuple(f"{labels}{i}" for i in range(len(values)))
    return case_input(name, values, labels, unit, meaning=text, bounds=bounds)


def absent(name: str, unit: str) -> CaseInput:
    """A number that the case does not have: no values, index [0]."""
    return CaseInput(name, np.zeros(0), (), unit, np.zeros(0, np.int64))


def profile(
    section: TableContext, name: str, key: str, raw: Any, unit: str, bounds: ValueRange = ANY,
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
    numbers = case_input(name, np.array(values), labels, unit, meaning=meaning, bounds=bounds)
    ramp = None
    if table.ramp is not None:
        ramp = quantity(inner, "ramp", table.ramp, f"{unit}/s", POSITIVE, difference=True)
    return Profile(table.kind, shares, numbers, ramp)


def _shares(section: TableContext, raw: Any, count: int) -> np.ndarray:
    shares = np.array(listed(section, "at", raw, "1", SHARE))
    if len(shares) != count:
        raise section.error("at", raw, f"allowed are {count} shares of the unit's duration")
    if shares[0] != 0 or shares[-1] != 1 or (np.diff(shares) <= 0).any():
        raise section.error("at", raw, "the shares must rise from 0 to 1")
    return shares


def suggest(name: str, available, noun: str) -> str:
    """The known name nearest to one that is not known, or all that are."""
    plural = noun if noun.endswith("s") else f"{noun}s"
    return (
        nearest(name, available)
        .replace("known keys", f"known {plural}", 1)
        .replace("known key", f"known {noun}", 1)
    )
