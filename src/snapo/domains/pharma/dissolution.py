"""The product's dissolution test: spheres of the surface-mean size that shrink in a film."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .inputs import use
from .population import mean_sizes
from .records_units import Dissolution
from .stream import Stream


def dissolved(unit: Dissolution, product: Stream, inputs: dict[str, Any]) -> Float[Array, ""]:
    """1 - (1 - D Cs t / (rho h r))^3 with r = d32 / 2; 1 once the sphere is gone.

    The cube makes it twice differentiable at full dissolution.
    """
    radius = mean_sizes(product.moments)["d32"] / 2
    reach = use(inputs, unit.diffusivity) * use(inputs, unit.solubility) * use(inputs, unit.time)
    left = 1 - reach / (product.density * use(inputs, unit.film) * radius)
    return 1 - jnp.where(left > 0, left, 0.0) ** 3
