"""Crystals by the moments 0 to 5 of their sizes: exact where growth does not depend on size.

mu_0' = B, mu_k' = k G mu_(k-1) + B L0^k, per m3 of slurry. Where crystals dissolve they shrink,
and none disappears: for that they have to be followed by finite volumes.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...flowsheet.stream import MOMENTS
from ...given import fixed
from .population import SIZE, UNITS, Population


def by_moments(
    shape: Array,
    nuclei_size: Array | None,
    separate: bool,
    seed: Float[Array, " 6"],
    fed: Float[Array, " 6"],
) -> Population:
    """`seed` and the `fed` crystals as moments, m^k/m3; `nuclei_size` in m, None where it is 0.
    The state: scaled moments of all crystals, or with `separate` those of seed and feed, then those
    of nuclei. `shape`: kv."""
    units = fixed(UNITS)

    def grow(moments, growth, source) -> list[Array]:
        slope = [jnp.zeros(()) if source is None else source]
        for k in range(1, MOMENTS):
            change = k * growth * moments[k - 1]
            if source is not None and nuclei_size is not None:
                change = change + source * (nuclei_size / SIZE) ** k
            slope.append(change)
        return slope

    def slope(y, growth, born):
        result = grow(y[:MOMENTS], growth, None if separate else born)
        if separate:
            result += grow(y[MOMENTS:], growth, born)
        return jnp.stack(result)

    def measures(y):
        if not separate:
            return {}
        volume = shape * units[3]
        return {"seed_volume": volume * y[3], "nuclei_volume": volume * y[MOMENTS + 3]}

    start = (seed + fed) / units
    return Population(
        start=jnp.concatenate([start, jnp.zeros(MOMENTS)]) if separate else start,
        seed=seed[3] / units[3],
        moments=lambda y: y[:MOMENTS] + y[MOMENTS:] if separate else y,
        slope=slope,
        numbers=lambda y: jnp.zeros(0),
        states=lambda y: {},
        measures=measures,
    )
