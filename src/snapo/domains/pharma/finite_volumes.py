"""Crystals by finite volumes over their size: the population balance itself.

n_t + (G n)_L = 0 with births B at the smallest size, n(L, t) crystals per m3 and m. What is
followed is the number of crystals in each cell of a fixed grid; between cells they pass at
n G, n being the density on the side from which they come, by slopes with a limiter: of second
order where n is smooth, and (almost) without new extremes where it is not. Crystals that dissolve
shrink, and below the smallest size they are gone. None grows out of the largest cell: what
gathers there is reported, and is a grid too short.

Moments take n constant within a cell, so the solute follows from the cells' own third moment, and
mass closes whatever the grid.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float

from .inputs import fixed, use
from .population import NUMBER, SIZE, Population
from .records_units import Crystalliser, Seed
from .stream import MOMENTS

FLAT = 1e-16  # square of a gain so small that it counts as none; without it 0/0 in empty cells
NEGATIVE = 0.05  # of the largest density: so far below zero a time step was unstable
SHARES = {"d10": 0.1, "d50": 0.5, "d90": 0.9}


def by_finite_volumes(unit: Crystalliser, inputs: dict[str, Any], shape, density) -> Population:
    """The state: crystals in each cell, NUMBER per m3."""
    assert unit.edges is not None
    edges = unit.edges / SIZE
    powers = fixed(cell_powers(edges))
    width = fixed(np.diff(edges))
    start = seed_numbers(unit.seed, inputs, shape, density, edges)

    def slope(y, growth, born):
        n = y / width
        # The limiter bounds what too long a time step makes grow: waves about zero, no overflow.
        n = jnp.where(jnp.min(n) > -NEGATIVE * jnp.max(n), n, jnp.nan)
        step = limited_steps(n, edges) / 2
        larger = jnp.where(growth > 0, growth, 0.0)
        smaller = growth - larger
        between = larger * (n + step)[:-1] + smaller * (n - step)[1:]
        first = born + smaller * n[0]
        flux = jnp.concatenate([first[None], between, jnp.zeros(1)])
        return flux[:-1] - flux[1:]

    def states(y):
        volume = y * powers[3]
        found = quantiles(volume, edges, tuple(SHARES.values()))
        return {name: SIZE * size for name, size in zip(SHARES, found)}

    def measures(y):
        found, volume = states(y), y * powers[3]
        total = jnp.sum(volume)
        empty = total <= 0
        wide = found["d90"] - found["d10"]
        found["span"] = jnp.where(empty, 0.0, wide / jnp.where(empty, 1.0, found["d50"]))
        found["at_largest"] = jnp.where(empty, 0.0, volume[-1] / jnp.where(empty, 1.0, total))
        return found

    def moments(y):
        return powers @ y

    return Population(start, moments(start)[3], moments, slope, states, measures)


def cell_powers(edges: np.ndarray) -> Float[np.ndarray, "6 N"]:
    """The mean of L^k over each cell, k = 0 to 5."""
    k = np.arange(1, MOMENTS + 1)[:, None]
    return np.diff(edges**k, axis=1) / (k * np.diff(edges))


def seed_numbers(seed: Seed, inputs, shape, density, edges: np.ndarray) -> Float[Array, " N"]:
    """Crystals of a lognormal seed in each cell; together they weigh its loading.

    `size` is the mean by number, `spread` the standard deviation in units of it.
    """
    assert seed.loading is not None and seed.size is not None and seed.spread is not None
    variance = jnp.log1p(use(inputs, seed.spread) ** 2)
    median = jnp.log(use(inputs, seed.size) / SIZE) - variance / 2
    # The logarithm of an edge at 0 would be infinite, and its derivative undefined.
    share = ndtr((fixed(np.log(np.maximum(edges, 1e-9))) - median) / jnp.sqrt(variance))
    numbers = jnp.diff(share)
    weight = density * shape * NUMBER * SIZE**3
    mass = weight * jnp.sum(fixed(cell_powers(edges)[3]) * numbers)
    return numbers * (use(inputs, seed.loading) / mass)


def limited_steps(n: Float[Array, " N"], edges: np.ndarray) -> Float[Array, " N"]:
    """What a density gains across each cell, limited; 0 in the first and in the last.

    With F and B what it would gain by the forward and the backward difference:
    F B (F + B) / (F^2 + B^2), the limiter of van Albada, van Leer and Roberts (Astronomy and
    Astrophysics 108, 1982). It is the difference where both agree, at most 1.21 times the smaller
    one where they agree in sign, and at most a fifth of it where they do not. Van Leer's has a
    kink where F or B changes its sign: with it, central differences over 0.02 K of a cooling
    crystalliser were 0.7 % off its derivative, and with this one 4e-5.
    """
    centre, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    difference, inner = jnp.diff(n) / fixed(np.diff(centre)), fixed(width[1:-1])
    forward, backward = inner * difference[1:], inner * difference[:-1]
    f, b = forward**2 + FLAT, backward**2 + FLAT
    return jnp.pad((forward * b + backward * f) / (f + b), 1)


def quantiles(
    volume: Float[Array, " N"], edges: np.ndarray, shares: tuple[float, ...]
) -> Float[Array, " S"]:
    """Sizes below which these shares of the volume lie; 0 without crystals.

    Between edges the volume rises along the monotone cubic of Fritsch and Carlson (1980), so
    that a quantile's derivative does not jump where it passes an edge.
    """
    total = jnp.sum(volume)
    empty = total <= 0
    share = jnp.concatenate([jnp.zeros(1), jnp.cumsum(volume)]) / jnp.where(empty, 1.0, total)
    width, grid = fixed(np.diff(edges)), fixed(edges)
    secant = jnp.diff(share) / width
    left, right = secant[:-1], secant[1:]
    both = left * right > jnp.finfo(left.dtype).tiny ** 0.25
    mean = jnp.where(both, 2 * left * right / jnp.where(both, left + right, 1.0), 0.0)
    slope = jnp.pad(mean, 1)
    found = []
    for wanted in shares:
        cell = jnp.clip(jnp.sum(share <= wanted) - 1, 0, len(edges) - 2)
        h = width[cell]
        ends = share[cell], share[cell + 1], h * slope[cell], h * slope[cell + 1]
        found.append(grid[cell] + h * _inverse(ends, wanted))
    return jnp.where(empty, 0.0, jnp.stack(found))


def _inverse(ends, wanted: float) -> Float[Array, ""]:
    """Where in 0 to 1 a rising cubic, of values and slopes at its `ends`, is as `wanted`.

    By bisection without derivatives, then two Newton steps, which carry them.
    """

    def cubic(s, ends):
        low, high, first, last = ends
        rise = s * s * (3 - 2 * s)
        bend = s * (1 - s) * ((1 - s) * first - s * last)
        return low + (high - low) * rise + bend

    still = jax.lax.stop_gradient(ends)
    below, above = jnp.zeros_like(still[0]), jnp.ones_like(still[0])
    for _ in range(24):
        middle = (below + above) / 2
        under = cubic(middle, still) < wanted
        below, above = jnp.where(under, middle, below), jnp.where(under, above, middle)
    s = jax.lax.stop_gradient((below + above) / 2)
    for _ in range(2):
        gap, slope = jax.jvp(lambda s: cubic(s, ends), (s,), (jnp.ones_like(s),))
        s = s - (gap - wanted) / jnp.where(slope > 0, slope, 1.0)
    return s
