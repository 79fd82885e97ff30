"""The drug that a tablet, or loose crystals, have dissolved by a time."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...flowsheet.stream import Stream
from ...given import use
from ..crystals.population import mean_sizes


def inside(product: Stream) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """d32 in m and density in kg/m3 of the drug's crystals, loose or in granules."""
    granules = product.inner_size > 0
    size = jnp.where(granules, product.inner_size, mean_sizes(product.moments)["d32"])
    return size, jnp.where(granules, product.inner_density, product.density)


def lasting(unit: Any, product: Stream, inputs: dict[str, Any]) -> Float[Array, ""]:
    """The seconds that the drug's crystals last: rho h r / (D Cs), r = d32 / 2.

    `unit` has `diffusivity`, `solubility` and `film`."""
    size, density = inside(product)
    reach = use(inputs, unit.diffusivity) * use(inputs, unit.solubility)
    return density * use(inputs, unit.film) * size / 2 / reach


def gone(time, whole) -> Float[Array, ""]:
    """The share of shrinking spheres that is dissolved after `time`, of which they take `whole` s:
    1 - (1 - t/T)^3 (Hixson and Crowell, "Dependence of Reaction Velocity upon Surface and
    Agitation", Industrial and Engineering Chemistry 23, 923-931, 1931)."""
    left = 1 - time / whole
    # The cube makes it twice differentiable at full dissolution.
    return 1 - jnp.where(left > 0, left, 0.0) ** 3


def released(time, whole, mean) -> Float[Array, ""]:
    """The share dissolved after `time` where particles leave the tablet at random times, 1 -
    exp(-s / mean) of them by s, and each then shrinks as in `gone`.

    The integral of exp(-s/mean)/mean gone(t - s) over s from 0 to t, in closed form: with x = u/T,
    a = mean/T and the antiderivative e^(x/a) (a (1-x)^2 + 2 a^2 (1-x) + 2 a^3) of e^(x/a) (1-x)^2.
    """
    last = jnp.minimum(time, whole)
    a, x = mean / whole, last / whole

    def part(x):
        return a * (1 - x) ** 2 + 2 * a**2 * (1 - x) + 2 * a**3

    late = jnp.exp((last - time) / mean) * part(x) - jnp.exp(-time / mean) * part(jnp.zeros(()))
    return gone(time, whole) - 3 * late
