"""Rates of growth, dissolution and nucleation at a supersaturation."""

from dataclasses import dataclass
from typing import Any, NamedTuple

from snapo.case.given import CaseInput
from snapo.problem.record.arrays import Array, Float, jnp

from ...given import absent, use
from ...read.declared import TableRecord, UnitQuantity
from ...read.numbers import NOT_NEGATIVE, POSITIVE

RATE, ORDER = UnitQuantity("m/s", NOT_NEGATIVE), UnitQuantity(range=NOT_NEGATIVE, example="1.32")
NUCLEI = UnitQuantity("1/m3/s", NOT_NEGATIVE)


@dataclass(frozen=True, eq=False)
class Kinetics(TableRecord):
    """Growth, nucleation and dissolution with S = (c - c*) / c* and its positive part S+.

    S+ = (S + sqrt(S^2 + 4 d^2)) / 2 with d = `rounding` (5e-6 gives S^2 + 1e-10); S- = S+ - S. G =
    growth S+^growth_order - dissolution S-^dissolution_order, m/s. B = primary S+^primary_order +
    secondary S+^secondary_order (kv mu3)^crystal_order, 1/m3/s, where mu3 in m3/m3 is that of all
    crystals.
    """

    growth: CaseInput = RATE("growth rate at a supersaturation of 1", example="5 um/s")
    growth_order: CaseInput = ORDER("order of growth in the supersaturation")
    dissolution: CaseInput = RATE("dissolution at undersaturation 1", "0 m/s", example="1 um/s")
    dissolution_order: CaseInput = ORDER("order of dissolution in the undersaturation", 1.0)
    primary: CaseInput = NUCLEI(
        "primary nucleation at a supersaturation of 1", "0 1/m^3/s", example="3e8 1/m^3/s"
    )
    primary_order: CaseInput = ORDER("order of primary nucleation in the supersaturation", 1.0)
    secondary: CaseInput = NUCLEI(
        "secondary nucleation at a supersaturation of 1", "0 1/m^3/s", example="4.46e10 1/m^3/s"
    )
    secondary_order: CaseInput = ORDER("order of secondary nucleation in the supersaturation", 1.0)
    crystal_order: CaseInput = ORDER("order of secondary nucleation in the volume of crystals", 1.0)
    rounding: float = ORDER.number("rounding of rates at saturation", 5e-6, range=POSITIVE)

    heading = "`[units.NAME.kinetics]`"


class Rates(NamedTuple):
    """`growth` G in m/s (below 0 if crystals dissolve), `nucleation` B in 1/m3/s."""

    growth: Float[Array, ""]
    nucleation: Float[Array, ""]


def positive_and_negative(S, rounding: float) -> tuple[Array, Array]:
    """S+ = (S + sqrt(S^2 + 4 d^2)) / 2 and S- = S+ - S, both above zero without cancellation:
    their product is d^2."""
    square = 4 * rounding**2
    large = (jnp.abs(S) + jnp.sqrt(S * S + square)) / 2
    small = rounding**2 / large
    return jnp.where(S > 0, large, small), jnp.where(S > 0, small, large)


def kinetics(record: Kinetics, inputs: dict[str, Any], supersaturation, volume) -> Rates:
    """Growth and nucleation; `volume`: kv mu3 of all crystals in m3/m3."""
    plus, minus = positive_and_negative(supersaturation, record.rounding)
    # Powers share one logarithm; a volume of zero (no crystals yet) counts as almost none.
    log_plus = jnp.log(plus)
    growth = use(inputs, record.growth) * jnp.exp(use(inputs, record.growth_order) * log_plus)
    if not absent(inputs, record.dissolution):
        order = use(inputs, record.dissolution_order)
        growth = growth - use(inputs, record.dissolution) * minus**order
    nucleation = jnp.zeros_like(growth)
    if not absent(inputs, record.primary):
        power = jnp.exp(use(inputs, record.primary_order) * log_plus)
        nucleation = nucleation + use(inputs, record.primary) * power
    if not absent(inputs, record.secondary):
        present = volume > 1e-30
        log_volume = jnp.log(jnp.where(present, volume, 1e-30))
        exponent = use(inputs, record.secondary_order) * log_plus
        exponent = exponent + use(inputs, record.crystal_order) * log_volume
        nucleation = nucleation + use(inputs, record.secondary) * jnp.exp(exponent)
    return Rates(growth, nucleation)
