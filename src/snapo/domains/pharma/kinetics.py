"""How fast crystals grow, dissolve and appear at a supersaturation."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.case.given import Given

from .inputs import use
from .records_units import Kinetics


class Rates(NamedTuple):
    """`growth` G in m/s (below 0 where crystals dissolve), `nucleation` B in 1/m3/s."""

    growth: Float[Array, ""]
    nucleation: Float[Array, ""]


def absent(inputs: dict[str, Any], given: Given) -> bool:
    """Whether a term can be left out: its factor is zero and no input."""
    return given.name not in inputs and not given.used().any()


def positive_and_negative(S, rounding: float) -> tuple[Array, Array]:
    """S+ = (S + sqrt(S^2 + 4 d^2)) / 2 and S- = S+ - S, both above zero without cancellation:
    their product is d^2."""
    square = 4 * rounding**2
    large = (jnp.abs(S) + jnp.sqrt(S * S + square)) / 2
    small = rounding**2 / large
    return jnp.where(S > 0, large, small), jnp.where(S > 0, small, large)


def kinetics(record: Kinetics, inputs: dict[str, Any], supersaturation, volume) -> Rates:
    """Growth and nucleation; `volume` is that of all crystals, kv mu3, in m3/m3."""
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
