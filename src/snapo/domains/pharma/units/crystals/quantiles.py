"""Sizes below which shares of the crystals' volume lie, and the span between them."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...given import fixed
from .population import SIZE

SHARES = {"d10": 0.1, "d50": 0.5, "d90": 0.9}
QUANTILES = dict.fromkeys(SHARES, "m")  # by volume


def size_states(volume: Float[Array, " N"], edges: np.ndarray) -> dict[str, Array]:
    """d10, d50 and d90 in m, of crystals with this volume in each cell; `edges` in `SIZE`."""
    result = quantiles(volume, edges, tuple(SHARES.values()))
    return {name: SIZE * size for name, size in zip(SHARES, result)}


def size_measures(volume: Float[Array, " N"], edges: np.ndarray) -> dict[str, Array]:
    """These, the span (d90 - d10) / d50, and the share of the volume in the largest cell."""
    result, total = size_states(volume, edges), jnp.sum(volume)
    empty = total <= 0
    wide = result["d90"] - result["d10"]
    result["span"] = jnp.where(empty, 0.0, wide / jnp.where(empty, 1.0, result["d50"]))
    result["at_largest"] = jnp.where(empty, 0.0, volume[-1] / jnp.where(empty, 1.0, total))
    return result


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
    inverses = []
    for requested in shares:
        cell = jnp.clip(jnp.sum(share <= requested) - 1, 0, len(edges) - 2)
        h = width[cell]
        endpoints = share[cell], share[cell + 1], h * slope[cell], h * slope[cell + 1]
        inverses.append(grid[cell] + h * _inverse(endpoints, requested))
    return jnp.where(empty, 0.0, jnp.stack(inverses))


def _inverse(endpoints, requested: float) -> Float[Array, ""]:
    """Where in 0 to 1 a rising cubic, of values and slopes at its `ends`, is as `requested`.

    By bisection without derivatives, then two Newton steps, which carry them.
    """

    def cubic(s, bounds):
        low, high, first, last = bounds
        rise = s * s * (3 - 2 * s)
        bend = s * (1 - s) * ((1 - s) * first - s * last)
        return low + (high - low) * rise + bend

    still = jax.lax.stop_gradient(endpoints)
    below, above = jnp.zeros_like(still[0]), jnp.ones_like(still[0])
    for _ in range(24):
        middle = (below + above) / 2
        under = cubic(middle, still) < requested
        below, above = jnp.where(under, middle, below), jnp.where(under, above, middle)
    s = jax.lax.stop_gradient((below + above) / 2)
    for _ in range(2):
        gap, slope = jax.jvp(lambda s: cubic(s, endpoints), (s,), (jnp.ones_like(s),))
        s = s - (gap - requested) / jnp.where(slope > 0, slope, 1.0)
    return s
