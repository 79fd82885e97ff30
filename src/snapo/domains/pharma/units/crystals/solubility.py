"""Solubility by temperature and anti-solvent."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field

from snapo.case.given import CaseInput
from snapo.case.table import CaseTable

from ...flowsheet.network import GAS_CONSTANT
from ...given import use
from ...read.fields import TextKey, quantity, word
from ...read.numbers import POSITIVE, TEMPERATURE, ZERO_CELSIUS, absent, case_input, several
from ...read.quantities import UnitError, conversion
from ...read.reader import Reader
from .nrtl import Mixture, NrtlTable, dissolved, read_mixture

SolubilityKind = Literal["polynomial", "exponential", "van-t-hoff", "nrtl"]


@dataclass(frozen=True, eq=False)
class Solubility:
    """c*(T, w) in kg/m3.

    - "polynomial": sum_k a_k t^k; "exponential": exp(sum_k a_k t^k); t is T in K less `zero`
      (273.15 for coefficients in Celsius). `coefficients`: a_k, index [n], labels "t^0", ….
    - "van-t-hoff": `value` exp(-`enthalpy` / R (1/T - 1/`reference`)), of kg/m3, J/mol and K.
    - "nrtl": of a `mixture` in equilibrium with the pure crystal.
    - `antisolvent`: (b1, b2), index [2] or [0]: ln c* gains b1 w + b2 w^2, w the anti-solvent's
      mass fraction of the solute-free liquid.
    """

    kind: SolubilityKind
    coefficients: CaseInput
    zero: float
    antisolvent: CaseInput
    value: CaseInput | None = None
    enthalpy: CaseInput | None = None
    reference: float = 298.15
    mixture: Mixture | None = None


class SolubilityTable(CaseTable):
    """`[units.NAME.solubility]`"""

    kind: SolubilityKind = word(
        "polynomial", "exponential", "van-t-hoff", "nrtl", default="polynomial"
    )
    coefficients: Annotated[list[float], Field(min_length=1)] | None = Field(
        None, description="a list of numbers, of rising powers of the temperature"
    )
    value: Any = quantity('"20 kg/m^3"', None, meaning="solubility at the reference")
    enthalpy: Any = quantity('"25 kJ/mol"', None, meaning="enthalpy of dissolution")
    reference: Any = quantity('"298.15 K"', None, meaning="temperature of the reference")
    nrtl: dict | None = Field(None, description="the table nrtl")
    unit: TextKey = Field("kg/m^3", description='a unit such as "kg/m^3"')
    scale: Literal["K", "degC"] = word("K", "degC", default="K")
    antisolvent: Annotated[list[float], Field(min_length=2, max_length=2)] | None = Field(
        None, description="two numbers"
    )


def read_solubility(read: Reader) -> Solubility:
    """Coefficients for kg/m3, from those of the case's unit."""
    table = read.table
    read.only(("polynomial", "exponential"), ("coefficients",), needed=True)
    read.only(("van-t-hoff",), ("value", "enthalpy", "reference"), needed=True)
    read.only(("nrtl",), ("nrtl",), needed=True)
    extra = absent(f"{read.name}.antisolvent", "1")
    if table.antisolvent is not None:
        extra = several(
            read.section, extra.name, "antisolvent", table.antisolvent, "1", ("w", "w^2")
        )
    if table.kind == "van-t-hoff":
        return Solubility(
            kind=table.kind,
            coefficients=absent(read.name, "1"),
            zero=0.0,
            antisolvent=extra,
            value=read.number("value", "kg/m3", POSITIVE),
            enthalpy=read.number("enthalpy", "J/mol"),
            reference=read.plain("reference", "K", TEMPERATURE),
        )
    if table.kind == "nrtl":
        mixture = read_mixture(read.inner("nrtl", NrtlTable))
        return Solubility(table.kind, absent(read.name, "1"), 0.0, extra, mixture=mixture)
    try:
        scale = conversion(table.unit, "kg/m3").scale
    except UnitError as error:
        raise read.section.error("unit", table.unit, str(error)) from None
    values = np.array(table.coefficients)
    if table.kind == "polynomial":
        values = values * scale
    else:  # the unit is a factor of the whole, which the logarithm adds
        values[0] += np.log(scale)
    unit = "kg/m3/K^k" if table.kind == "polynomial" else "1/K^k"
    labels = tuple(f"t^{k}" for k in range(len(values)))
    return Solubility(
        kind=table.kind,
        coefficients=case_input(
            read.name, values, labels, unit, meaning="coefficient of solubility"
        ),
        zero=0.0 if table.scale == "K" else ZERO_CELSIUS,
        antisolvent=extra,
    )


def solubility(record: Solubility, inputs: dict[str, Any], temperature) -> Float[Array, "..."]:
    """c*(T) in kg/m3 without anti-solvent."""
    if record.value is not None and record.enthalpy is not None:
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
    """c*(T) in kg/m3 of the case's own coefficients, without anti-solvent."""
    if record.value is not None and record.enthalpy is not None:
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
