"""The share of the drug in a tablet, or in loose crystals, that has dissolved by a certain time."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float, jnp

from ...flowsheet.stream import NO_CRYSTALS, Stream
from ...given import fixed, use
from ..crystals.population import mean_sizes

BY_MEAN = (
    "Crystals described by their moments dissolve as spheres of one size, d₃₂: if their sizes "
    "differ the dissolved share is too optimistic."
)


class Lasting(NamedTuple):
    """`lifetime`: [K] s until crystals of K sizes are dissolved; `share`: [K] their share of the
    volume."""

    lifetime: Float[Array, " K"]
    share: Float[Array, " K"]


@cache
def _within_a_cell() -> tuple[np.ndarray, np.ndarray]:
    """Points from 0 to 1 and their weights, exact for polynomials to degree 5."""
    points, weights = np.polynomial.legendre.leggauss(3)
    return points / 2 + 0.5, weights / 2


def inside(product: Stream) -> tuple[Float[Array, " K"], Float[Array, " K"], Float[Array, ""]]:
    """Sizes in m of the drug's crystals, loose or in granules, with their shares of the volume, and
    their density in kg/m3.

    If crystals are counted on a grid, these are points within its cells, each with a constant
    density by number; otherwise the only size is d32.
    """
    granules = product.inner_size > 0
    density = jnp.where(granules, product.inner_density, product.density)
    counted = product.inner_grid or product.grid
    if counted is None or counted == NO_CRYSTALS:
        size = jnp.where(granules, product.inner_size, mean_sizes(product.moments)["d32"])
        return size[None], jnp.ones(1), density
    numbers = product.inner_numbers if product.inner_grid else product.numbers
    low, width = counted.array[:-1, None], np.diff(counted.array)[:, None]
    points, weights = _within_a_cell()
    sizes = low + points * width
    volume = numbers[:, None] * fixed(weights * sizes**3)
    total = jnp.sum(volume)
    empty = total <= 0
    return fixed(sizes.ravel()), volume.ravel() / jnp.where(empty, 1.0, total), density


def lasting(unit: Any, product: Stream, inputs: dict[str, Any]) -> Lasting:
    """The lifetime of the drug's crystals in s: rho h r / (D Cs), where r is half of their size.

    `unit` has `diffusivity`, `solubility` and `film`."""
    sizes, share, density = inside(product)
    reach = use(inputs, unit.diffusivity) * use(inputs, unit.solubility)
    return Lasting(density * use(inputs, unit.film) * sizes / 2 / reach, share)


def over_sizes(dissolved: Callable[[Array], Array], crystals: Lasting) -> Float[Array, ""]:
    """The mean by volume of the share `dissolved`, a function of the lifetime of a crystal in s."""
    return jnp.sum(crystals.share * dissolved(crystals.lifetime))


def gone(time, lifetime) -> Float[Array, ""]:
    """The dissolved share of shrinking spheres after `time`, if they need `lifetime` s to dissolve:
    1 - (1 - t/T)^3 (Hixson and Crowell, "Dependence of Reaction Velocity upon Surface and
    Agitation", Industrial and Engineering Chemistry 23, 923-931, 1931)."""
    left = 1 - time / lifetime
    # The cube makes it twice differentiable at full dissolution.
    return 1 - jnp.where(left > 0, left, 0.0) ** 3


def released(time, lifetime, mean) -> Float[Array, ""]:
    """The share dissolved after `time` if particles leave the tablet at random times, 1 - exp(-s /
    mean) of them by time s, and each then shrinks as in `gone`. It is the integral of
    exp(-s/mean)/mean gone(t - s) over s from 0 to t, in closed form: with x = u/T, a = mean/T and
    the antiderivative e^(x/a) (a (1-x)^2 + 2 a^2 (1-x) + 2 a^3) of e^(x/a) (1-x)^2.
    """
    last = jnp.minimum(time, lifetime)
    a, x = mean / lifetime, last / lifetime

    def part(x):
        return a * (1 - x) ** 2 + 2 * a**2 * (1 - x) + 2 * a**3

    late = jnp.exp((last - time) / mean) * part(x) - jnp.exp(-time / mean) * part(jnp.zeros(()))
    return gone(time, lifetime) - 3 * late
