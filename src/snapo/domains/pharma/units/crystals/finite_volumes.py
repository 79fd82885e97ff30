"""Crystals by finite volumes over their size: the population balance itself.

n_t + (G n)_L = 0 with births B at the smallest size, n(L, t) crystals per m3 and m. The state is
the number of crystals in each cell of a fixed grid; between cells they pass at n G, n being the
density on the side from which they come, by slopes with a limiter: of second order where n is
smooth, and (almost) without new extremes where it is not. Crystals that dissolve shrink, and vanish
below the smallest size. None grows out of the largest cell: crystals that accumulate there are
reported, since the grid is too short.

Moments take n constant within a cell, so the solute follows from the cells' third moment, and mass
is conserved on any grid.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...given import fixed
from .population import SIZE, Population, cell_powers
from .quantiles import size_measures, size_states

FLAT = 1e-16  # square of a gain so small that it counts as none; without it 0/0 in empty cells
NEGATIVE = 0.05  # of the largest density: so far below zero a time step was unstable


def by_finite_volumes(
    edges: np.ndarray, seed: Float[Array, " N"], fed: Float[Array, " N"] | None = None
) -> Population:
    """The state: crystals in each cell, NUMBER per m3. `edges`: [N + 1] m; `seed`, `fed`: initial
    ones."""
    edges = edges / SIZE
    powers = fixed(cell_powers(edges))
    width = fixed(np.diff(edges))

    def slope(y, growth, born):
        n = y / width
        # The limiter bounds waves that grow by too long a time step: they stay about zero.
        n = jnp.where(jnp.min(n) > -NEGATIVE * jnp.max(n), n, jnp.nan)
        step = limited_steps(n, edges) / 2
        larger = jnp.where(growth > 0, growth, 0.0)
        smaller = growth - larger
        between = larger * (n + step)[:-1] + smaller * (n - step)[1:]
        first = born + smaller * n[0]
        flux = jnp.concatenate([first[None], between, jnp.zeros(1)])
        return flux[:-1] - flux[1:]

    return Population(
        start=seed if fed is None else seed + fed,
        seed=(powers @ seed)[3],
        moments=lambda y: powers @ y,
        slope=slope,
        numbers=lambda y: y,
        states=lambda y: size_states(y * powers[3], edges),
        measures=lambda y: size_measures(y * powers[3], edges),
    )


def limited_steps(n: Float[Array, " N"], edges: np.ndarray) -> Float[Array, " N"]:
    """What a density gains across each cell, limited; 0 in the first and in the last.

    With F and B its gain by the forward and the backward difference:
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
