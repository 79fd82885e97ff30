"""Mass action: how fast every reaction goes at a temperature and composition."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .inputs import use
from .records import Network

GAS_CONSTANT = 8.314  # J/mol/K, as the published kinetics use it


def rate_constants(network: Network, inputs: dict[str, Any], temperature) -> Float[Array, "... R"]:
    """k_i exp(-E_i / R (1/T - 1/T_ref)), in (m3/kmol)^(n-1)/s; 1/T_ref is 0 for plain Arrhenius."""
    inverse = 1 / jnp.asarray(temperature)[..., None]
    if network.reference is not None:
        inverse = inverse - 1 / network.reference
    energy = use(inputs, network.activation) / GAS_CONSTANT
    return use(inputs, network.prefactor) * jnp.exp(-energy * inverse)


def rates(network: Network, constants: Array, concentration: Sequence[Array]) -> list[Array]:
    """[R] rates in kmol/m3/s from `constants` [..., R] and kmol/m3 of each species.

    Written out reaction by reaction: species of order 0 do not appear, so 0^0 never does.
    """
    found = []
    for i in range(len(network.reactions)):
        rate = constants[..., i]
        for s, order in enumerate(network.order[i]):
            if order:
                rate = rate * _power(concentration[s], float(order))
        found.append(rate)
    return found


def _power(c: Array, order: float) -> Array:
    """c^order; a fractional power of what round-off made negative is 0."""
    if order.is_integer():
        return c ** int(order)
    present = c > 0
    return jnp.where(present, jnp.where(present, c, 1.0) ** order, 0.0)
