"""Quantities with units: a text such as "40 degC" becomes a number in the domain's unit.

A text is split here, and only the name of its unit is passed to pint, so nothing in a case is ever
evaluated. The domain's units are written as in `records`: "kmol/m3", "1/s", "1".
"""

import re
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import pint

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
# Factors of usual units to those of the domain, as pint computes them.
USUAL: dict[str, dict[str, float]] = {
    "1": {"": 1.0, "1": 1.0, "%": 0.01, "% w/w": 0.01, "ppm": 1e-06},
    "K": {"K": 1.0},
    "K/s": {"K/s": 1.0, "K/min": 0.01666666666666667},
    "s": {"s": 1.0, "min": 60.0, "h": 3600.0},
    "1/s": {"1/s": 1.0, "1/min": 0.01666666666666667, "1/h": 0.0002777777777777778},
    "m": {"m": 1.0, "cm": 0.01, "mm": 0.001, "um": 1e-06},
    "m2": {"m2": 1.0, "m^2": 1.0, "cm^2": 0.0001},
    "m3": {"m3": 1.0, "m^3": 1.0, "L": 0.001, "mL": 1e-06},
    "1/m": {"1/m": 1.0},
    "1/m3/s": {"1/m3/s": 1.0, "1/m^3/s": 1.0},
    "m/s": {"m/s": 1.0, "um/s": 1e-06},
    "m2/s": {"m2/s": 1.0, "m^2/s": 1.0},
    "kg": {"kg": 1.0, "g": 0.001, "mg": 1e-06},
    "kg/m3": {"kg/m3": 1.0, "kg/m^3": 1.0},
    "kg/kmol": {"kg/kmol": 1.0, "g/mol": 1.0},
    "kmol/m3": {"kmol/m3": 1.0, "mol/L": 0.9999999999999999},
    "m3/kmol/s": {"m3/kmol/s": 1.0, "L/mol/s": 1.0},
    "J/mol": {"J/mol": 1.0, "kJ/mol": 1000.0},
    "Pa": {"Pa": 1.0, "kPa": 1000.0, "bar": 100000.0},
    "Pa*s": {"Pa*s": 1.0, "mPa*s": 0.001},
}
EXACT = 1e-9  # exponents of dimensions that differ only by round-off are the same


class UnitError(ValueError):
    """A unit that does not exist, or has another dimension; the message is a clause."""


class Conversion(NamedTuple):
    """domain value = `scale` * case's value + `offset`."""

    scale: float
    offset: float

    def __call__(self, number: float) -> float:
        return self.scale * number + self.offset


def split(text: str) -> tuple[float, str]:
    """Number and unit of "313.15 K"; the unit of a pure number is "".

    **Raises:** `UnitError` if there is no such number.
    """
    result = QUANTITY.fullmatch(text)
    if result is None:
        raise UnitError("a quantity must be a number with its unit")
    return float(result[1]), result[2]


@cache
def conversion(unit: str, target: str, difference: bool = False) -> Conversion:
    """From `unit` to the domain's unit `target`.

    A `difference` of temperatures (a spread, a ramp) has no offset: 2 degC are 2 K.

    **Raises:** `UnitError` if the unit is unknown, or measures something else.
    """
    if (scale := USUAL.get(target, {}).get(unit)) is not None:
        return Conversion(scale, 0.0)
    return by_pint(unit, target, difference)


def by_pint(unit: str, target: str, difference: bool = False) -> Conversion:
    """`conversion` of any unit by pint, which takes as long to load as everything else together."""
    domain = _parse(target)
    local = _exact(_parse(unit), domain)
    if _gaps(local, domain):
        requested = _dimension(domain) + ("" if target in PURE else f", {target}")
        raise UnitError(
            f"{unit_text(unit)} is {_dimension(local)}, but the quantity is {requested}"
        )
    registry = _registry()
    if local.dimensionality != domain.dimensionality:  # by round-off: pint compares it bit by bit
        factors: list[Any] = [registry.get_base_units(item)[0] for item in (local, domain)]
        return Conversion(float(f"{factors[0] / factors[1]:.16g}"), 0.0)
    start = registry.Quantity(0.0, local).to(domain).magnitude
    if difference and local == registry.degC:
        local = registry.delta_degC
    if difference and local == registry.degF:
        local = registry.delta_degF
    zero = registry.Quantity(0.0, local).to(domain).magnitude
    scale = registry.Quantity(1.0, local).to(domain).magnitude - zero
    # Factors between units have few digits; the rest is rounding on the way.
    return Conversion(float(f"{scale:.16g}"), 0.0 if difference else float(f"{start:.16g}"))


def prefactor_unit(order: float) -> str:
    """The domain's unit of a rate constant, by the reaction's total order."""
    power = round(float(order) - 1, 12)
    if power == 0:
        return "1/s"
    return "m3/kmol/s" if power == 1 else f"m^{3 * power:.12g}*kmol^{-power:.12g}/s"


def basis(unit: str) -> str:
    """The basis of a share: "w/w", "v/v", "n/n" or "a/a"; "" if its unit does not state it."""
    metadata = BASIS.search(unit.strip())
    if metadata is not None:
        return "w/w" if metadata[1] == "m/m" else metadata[1]
    above, _, below = unit.replace("%", "").strip().partition("/")
    if not below:  # no ratio
        return ""
    try:
        one, other = dimension(above), dimension(below)
    except UnitError:
        return ""
    return RATIOS.get(one, "") if one == other else ""


def own_basis(name: str) -> str:
    """The basis of a number or a measure by its name, "filter.impurity.D"; "" if it has none."""
    parts = name.partition("[")[0].split(".")
    return next((item for item, names in OWN.items() if set(parts) & {*names}), "")


def check_basis(unit: str, local: str) -> None:
    """**Raises:** `UnitError` if a unit names another basis than the `local` of its number."""
    metadata = basis(unit)
    if not metadata or metadata == local:
        return
    if not local:
        raise UnitError(f"this number is not a share with a basis: write it without {metadata}")
    more = ", which needs response factors" if metadata == "a/a" else ""
    raise UnitError(
        f"{unit} means {BASES[metadata]}{more}, but this number is {BASES[local]}; write it in "
        f"% {local}"
    )


def dimension(unit: str) -> str:
    """The dimension of a unit, "[length] / [time]"."""
    return _dimension(_parse(unit))


def unit_text(unit: str) -> str:
    """A unit in a sentence."""
    return "a pure number" if unit.strip() in PURE else unit


@cache
def _registry() -> "pint.UnitRegistry":
    import pint  # late: most cases are in `USUAL` units

    return pint.UnitRegistry(cache_folder=None, autoconvert_offset_to_baseunit=False)


@cache
def _parse(unit: str) -> "pint.Unit":
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


def _gaps(unit: "pint.Unit", domain: "pint.Unit") -> dict[str, float]:
    """The difference of the exponents of each dimension in two units, without those that agree."""
    one, other = _powers(unit.dimensionality), _powers(domain.dimensionality)
    table = {name: other.get(name, 0.0) - one.get(name, 0.0) for name in {*one, *other}}
    return {name: gap for name, gap in table.items() if abs(gap) > EXACT}


def _powers(result: Any) -> dict[str, float]:
    """The exponents of units or dimensions as floats; pint stores them as numbers of any kind."""
    return {str(name): float(power) for name, power in result.items()}


def _exact(unit: "pint.Unit", domain: "pint.Unit") -> "pint.Unit":
    """`unit` with the exponents of `domain` if they are the same to three digits."""
    gaps = _gaps(unit, domain)
    parts = _powers(unit._units)
    if not gaps or not parts:
        return unit
    every = [_powers(_registry().get_dimensionality(name)) for name in parts]
    names = sorted({*gaps, *(name for item in every for name in item)})
    table = np.array([[entry.get(name, 0.0) for entry in every] for name in names])
    moved = np.linalg.lstsq(table, [gaps.get(name, 0.0) for name in names], rcond=None)[0]
    if np.abs(moved).max() > DIGITS:
        return unit
    from pint.util import UnitsContainer

    moved = {name: power + step for (name, power), step in zip(parts.items(), moved)}
    return _registry().Unit(UnitsContainer(moved))


def _dimension(unit: "pint.Unit") -> str:
    dimensionality = unit.dimensionality
    return "a pure number" if not dimensionality else str(dimensionality)
