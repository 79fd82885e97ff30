"""Quantities with units: an owner's text, "40 degC", becomes a number in the domain's unit.

A text is taken apart here and only the name of its unit goes to pint, so nothing that stands in a
case is ever evaluated. The domain's own units are written as in `records`: "kmol/m3", "1/s", "1".
"""

import re
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pint
from pint.util import UnitsContainer

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
QUANTITY = re.compile(rf"\s*({NUMBER})\s*(.*?)\s*", re.ASCII | re.DOTALL)
UNIT = re.compile(
    r"\(?[A-Za-zµμ°Ω%_][A-Za-zµμ°Ω%_0-9*/^.() ·-]{0,60}|1(?:/[A-Za-z0-9*/^.() -]{1,60})?"
)
# Shares may name their basis; quantities of one dimension say it by their ratio, "mg/kg".
BASIS = re.compile(r"\s*(?<![A-Za-z])\(?(w/w|v/v|m/m|n/n|a/a)\)?$")
BASES = {
    "w/w": "mass per mass", "v/v": "volume per volume", "n/n": "moles per mole",
    "a/a": "area per area of a chromatogram",
}  # fmt: skip
RATIOS = {"[mass]": "w/w", "[length] ** 3": "v/v", "[substance]": "n/n"}
OWN = {
    "w/w": (
        "impurity", "solvent", "loss_on_drying", "assay", "dissolved", "critical",
        "excipient_ratio", "liquid_ratio",
    ),
    "v/v": (
        "porosity", "least_porosity", "reference_porosity", "saturation", "packing", "wash_ratio",
        "rearrangement", "at_largest",
    ),
    "n/n": ("yield", "composition"),
}  # fmt: skip
PURE = ("", "1")
# A fraction as an exponent may be written to three digits, of a length three times: (cm^3)^0.333.
DIGITS = 3 * 5e-4
EXACT = 1e-9  # exponents of dimensions that differ by round-off alone are the same


class UnitError(ValueError):
    """A unit that does not exist, or of another dimension; the message is a clause."""


class Conversion(NamedTuple):
    """domain value = `scale` * owner's value + `offset`."""

    scale: float
    offset: float

    def __call__(self, number: float) -> float:
        return self.scale * number + self.offset


def split(text: str) -> tuple[float, str]:
    """Number and unit of "313.15 K"; the unit of a pure number is "".

    **Raises:** `UnitError` where there is no such number.
    """
    found = QUANTITY.fullmatch(text)
    if found is None:
        raise UnitError("a quantity is a number and its unit")
    return float(found[1]), found[2]


@cache
def conversion(unit: str, target: str, difference: bool = False) -> Conversion:
    """From `unit` to the domain's unit `target`.

    A `difference` of temperatures (a spread, a ramp) has no offset: 2 degC are 2 K.

    **Raises:** `UnitError` where the unit is unknown, or measures something else.
    """
    domain = _parse(target)
    own = _exact(_parse(unit), domain)
    if _gaps(own, domain):
        wanted = _dimension(domain) + ("" if target in PURE else f", {target}")
        raise UnitError(f"{shown(unit)} is {_dimension(own)}, and this is {wanted}")
    registry = _registry()
    if own.dimensionality != domain.dimensionality:  # by round-off: pint compares it bit by bit
        factors: list[Any] = [registry.get_base_units(each)[0] for each in (own, domain)]
        return Conversion(float(f"{factors[0] / factors[1]:.16g}"), 0.0)
    start = registry.Quantity(0.0, own).to(domain).magnitude
    if difference and own == registry.degC:
        own = registry.delta_degC
    if difference and own == registry.degF:
        own = registry.delta_degF
    zero = registry.Quantity(0.0, own).to(domain).magnitude
    scale = registry.Quantity(1.0, own).to(domain).magnitude - zero
    # Factors between units have few digits; the rest is rounding on the way.
    return Conversion(float(f"{scale:.16g}"), 0.0 if difference else float(f"{start:.16g}"))


def prefactor_unit(order: float) -> str:
    """The domain's unit of a rate constant, by the reaction's total order."""
    power = round(float(order) - 1, 12)
    if power == 0:
        return "1/s"
    return "m3/kmol/s" if power == 1 else f"m^{3 * power:.12g}*kmol^{-power:.12g}/s"


def basis(unit: str) -> str:
    """What a share is of, "w/w", "v/v", "n/n" or "a/a"; "" where its unit does not say."""
    said = BASIS.search(unit.strip())
    if said is not None:
        return "w/w" if said[1] == "m/m" else said[1]
    above, _, below = unit.replace("%", "").strip().partition("/")
    try:
        one, other = dimension(above), dimension(below)
    except UnitError:
        return ""
    return RATIOS.get(one, "") if one == other else ""


def own_basis(name: str) -> str:
    """The basis of a number or a measure by its name, "filter.impurity.D"; "" where it has none."""
    parts = name.partition("[")[0].split(".")
    return next((each for each, names in OWN.items() if set(parts) & {*names}), "")


def check_basis(unit: str, own: str) -> None:
    """**Raises:** `UnitError` where a unit names another basis than the `own` of its number."""
    said = basis(unit)
    if not said or said == own:
        return
    if not own:
        raise UnitError(f"this number has no basis: write it without {said}")
    more = ", which needs response factors" if said == "a/a" else ""
    raise UnitError(
        f"{unit} is {BASES[said]}{more}, and this is {BASES[own]}; write it by {BASES[own]}, as in "
        f"% {own}"
    )


def dimension(unit: str) -> str:
    """What a unit measures, "[length] / [time]"."""
    return _dimension(_parse(unit))


def shown(unit: str) -> str:
    """A unit in a sentence."""
    return "a pure number" if unit.strip() in PURE else unit


@cache
def _registry() -> pint.UnitRegistry:
    return pint.UnitRegistry(cache_folder=None, autoconvert_offset_to_baseunit=False)


@cache
def _parse(unit: str) -> pint.Unit:
    text = BASIS.sub("", unit.strip())
    if text in PURE:
        return _registry().Unit("")
    if UNIT.fullmatch(text) is None:
        raise UnitError(f"{unit!r} is not the name of a unit")
    text = text.replace("·", "*").replace("°C", "degC")
    text = re.sub(r"([A-Za-zµμ]+)([23])\b", r"(\1^\2)", text)
    if re.search(r"\^\s*\(?-?\d{3}", text):
        raise UnitError(f"{unit!r} is not the name of a unit")
    try:
        return _registry().Unit(text)
    except Exception:  # pint has many ways to say that it does not understand
        raise UnitError(f"there is no unit {unit!r}") from None


def _gaps(own: pint.Unit, domain: pint.Unit) -> dict[str, float]:
    """By which exponent of each dimension two units differ; without those that agree."""
    one, other = _powers(own.dimensionality), _powers(domain.dimensionality)
    found = {name: other.get(name, 0.0) - one.get(name, 0.0) for name in {*one, *other}}
    return {name: gap for name, gap in found.items() if abs(gap) > EXACT}


def _powers(found: Any) -> dict[str, float]:
    """The exponents of units or dimensions, which pint holds as any kind of number."""
    return {str(name): float(power) for name, power in found.items()}


def _exact(own: pint.Unit, domain: pint.Unit) -> pint.Unit:
    """`own` with the exponents that `domain` asks for, where those are the same to three digits."""
    gaps = _gaps(own, domain)
    parts = _powers(own._units)
    if not gaps or not parts:
        return own
    every = [_powers(_registry().get_dimensionality(name)) for name in parts]
    names = sorted({*gaps, *(name for each in every for name in each)})
    table = np.array([[each.get(name, 0.0) for each in every] for name in names])
    moved = np.linalg.lstsq(table, [gaps.get(name, 0.0) for name in names], rcond=None)[0]
    if np.abs(moved).max() > DIGITS:
        return own
    moved = {name: power + step for (name, power), step in zip(parts.items(), moved)}
    return _registry().Unit(UnitsContainer(moved))


def _dimension(unit: pint.Unit) -> str:
    found = unit.dimensionality
    return "a pure number" if not found else str(found)
