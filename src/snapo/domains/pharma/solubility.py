"""Solubility by temperature and anti-solvent."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .inputs import use
from .records_units import Solubility


def solubility(record: Solubility, inputs: dict[str, Any], temperature) -> Float[Array, "..."]:
    """c*(T) in kg/m3 without anti-solvent."""
    t = jnp.asarray(temperature) - record.zero
    coefficients = use(inputs, record.coefficients)
    total = jnp.broadcast_to(coefficients[-1], jnp.shape(t))
    for k in range(coefficients.shape[0] - 2, -1, -1):
        total = total * t + coefficients[k]
    return jnp.exp(total) if record.kind == "exponential" else total


def antisolvent_factor(record: Solubility, inputs: dict[str, Any], fraction) -> Array:
    """exp(b1 w + b2 w^2) at the anti-solvent's mass fraction w of the solute-free liquid."""
    b1, b2 = use(inputs, record.antisolvent)
    return jnp.exp(b1 * fraction + b2 * fraction**2)
