"""Solubility by temperature and anti-solvent."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field

from snapo.case.given import CaseInput
from snapo.case.quantity import choice

from ...flowsheet.network import GAS_CONSTANT
from ...given import use
from ...read.declared import ABSOLUTE, CONCENTRATION, ENERGY, TableRecord, inner, values
from ...read.fields import TextKey
from ...read.numbers import ZERO_CELSIUS, absent, case_input, several, with_units
from ...read.quantities import UnitError, conversion
from ...read.reader import Reader
from .nrtl import Mixture, dissolved

SolubilityKind = Literal["polynomial", "exponential", "van-t-hoff", "nrtl"]


@dataclass(frozen=True, eq=False)
class Solubility(TableRecord):
    """c*(T, w) in kg/m3.

    - "polynomial": sum_k a_k t^k; "exponential": exp(sum_k a_k t^k); t is T in K less `zero`
      (273.15 for coefficients in Celsius). `coefficients`: a_k, index [n], labels "t^0", ….
    - "van-t-hoff": `value` exp(-`enthalpy` / R (1/T - 1/`reference`)).
    - "nrtl": of a `mixture` in equilibrium with the pure crystal.
    - `antisolvent`: (b1, b2), index [2] or [0]: ln c* gains b1 w + b2 w^2, w the anti-solvent's
      mass fraction of the solute-free liquid.
    """

    kind: SolubilityKind
    coefficients: CaseInput
    zero: float
    antisolvent: CaseInput
    value: CaseInput | None = CONCENTRATION("solubility at the reference", None)
    enthalpy: CaseInput | None = ENERGY("enthalpy of dissolution", None, example="25 kJ/mol")
    reference: float | None = ABSOLUTE.number("temperature of the reference", None)
    mixture: Mixture | None = inner(Mixture, None, "nrtl")

    heading = "`[units.NAME.solubility]`"
    more_keys: ClassVar = {
        "kind": (SolubilityKind, choice("polynomial", "exponential", "van-t-hoff", "nrtl")),
        "coefficients": (
            list[float] | None,
            Field(
                None,
                min_length=1,
                description="a list of numbers, of rising powers of the temperature",
            ),
        ),
        "unit": (TextKey, Field("kg/m^3", description='a unit such as "kg/m^3"')),
        "scale": (Literal["K", "degC"], choice("K", "degC")),
        "antisolvent": (
            list[float] | None,
            Field(None, min_length=2, max_length=2, description="two numbers"),
        ),
    }

    @classmethod
    def read(cls, read):
        """Coefficients for kg/m3, from those of the case's unit."""
        table = read.table
        read.only(("polynomial", "exponential"), ("coefficients",), needed=True)
        read.only(("van-t-hoff",), ("value", "enthalpy", "reference"), needed=True)
        read.only(("nrtl",), ("nrtl",), needed=True)
        coefficients = absent(read.name, "1")
        if table.coefficients is not None:
            coefficients = _read_coefficients(read)
        extra = absent(f"{read.name}.antisolvent", "1")
        if table.antisolvent is not None:
            extra = several(
                read.section, extra.name, "antisolvent", table.antisolvent, "1", ("w", "w^2")
            )
        zero = 0.0 if table.scale == "K" or table.coefficients is None else ZERO_CELSIUS
        return cls(table.kind, coefficients, zero, extra, **values(cls, read))


def _read_coefficients(read: Reader) -> CaseInput:
    table = read.table
    try:
        scale = conversion(table.unit, "kg/m3").scale
    except UnitError as error:
        raise read.section.error("unit", table.unit, str(error)) from None
    numbers = np.array(table.coefficients)
    if table.kind == "polynomial":
        numbers = numbers * scale
    else:  # the unit is a factor of the whole, which the logarithm adds
        numbers[0] += np.log(scale)
    units = {} if scale == 1 else {"unit": "kg/m^3"}
    where = with_units(read.section, "coefficients", len(numbers), units)
    unit = "kg/m3/K^k" if table.kind == "polynomial" else "1/K^k"
    labels = tuple(f"t^{k}" for k in range(len(numbers)))
    text = "coefficient of solubility"
    return case_input(read.name, numbers, labels, unit, meaning=text, positions=where)


def solubility(record: Solubility, inputs: dict[str, Any], temperature) -> Float[Array, "..."]:
    """c*(T) in kg/m3 without anti-solvent."""
    if record.kind == "van-t-hoff":
        assert record.value and record.enthalpy and record.reference
        inverse = 1 / jnp.asarray(temperature) - 1 / record.reference
        energy = use(inputs, record.enthalpy) / GAS_CONSTANT
        return use(inputs, record.value) * jnp.exp(-energy * inverse)
    if record.mixture is not None:
        return dissolved(record.mixture, inputs, temperature)
    t = jnp.asarray(temperature) - record.zero
    coefficients = use(inputs, record.coefficients)
    total = jnp.broadcast_to(coefficients[-1], jnp.shape(t))
    for k in range(coefficients.shape[0] - 2, -1, -1):
        total = total * t + coefficients[k]
    return jnp.exp(total) if record.kind == "exponential" else total


def nominal_solubility(record: Solubility, temperature: np.ndarray) -> np.ndarray:
    """c*(T) in kg/m3 of the case's coefficients, without anti-solvent."""
    if record.kind == "van-t-hoff":
        assert record.value and record.enthalpy and record.reference
        energy = record.enthalpy.used() / GAS_CONSTANT
        return record.value.used() * np.exp(-energy * (1 / temperature - 1 / record.reference))
    if record.mixture is not None:
        with jax.enable_x64(True):
            return np.asarray(dissolved(record.mixture, {}, temperature))
    polyval = np.polyval(record.coefficients.values[::-1], temperature - record.zero)
    return np.exp(polyval) if record.kind == "exponential" else polyval


def antisolvent_factor(record: Solubility, inputs: dict[str, Any], fraction) -> Array:
    """exp(b1 w + b2 w^2) at the anti-solvent's mass fraction w of the solute-free liquid."""
    b1, b2 = use(inputs, record.antisolvent)
    return jnp.exp(b1 * fraction + b2 * fraction**2)
