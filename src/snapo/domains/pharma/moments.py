"""Crystals by the moments 0 to 5 of their sizes: exact where growth does not depend on size.

mu_0' = B, mu_k' = k G mu_(k-1) + B L0^k, per m3 of slurry. Where crystals dissolve they shrink,
and none disappears: for that they have to be followed by finite volumes.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .inputs import fixed, use
from .kinetics import absent
from .population import SIZE, UNITS, Population
from .records_units import Crystalliser
from .stream import MOMENTS


def by_moments(
    unit: Crystalliser, inputs: dict[str, Any], seed: Float[Array, " 6"], fed: Float[Array, " 6"]
) -> Population:
    """`seed` and the `fed` crystals as moments, m^k/m3. The state: scaled moments of all crystals,
    or with `separate` those of seed and feed, then those of nuclei."""
    units, separate = fixed(UNITS), unit.separate
    nuclei_size = None if absent(inputs, unit.nuclei_size) else use(inputs, unit.nuclei_size)

    def grow(moments, growth, source) -> list[Array]:
        slope = [jnp.zeros(()) if source is None else source]
        for k in range(1, MOMENTS):
            change = k * growth * moments[k - 1]
            if source is not None and nuclei_size is not None:
                change = change + source * (nuclei_size / SIZE) ** k
            slope.append(change)
        return slope

    def slope(y, growth, born):
        found = grow(y[:MOMENTS], growth, None if separate else born)
        if separate:
            found += grow(y[MOMENTS:], growth, born)
        return jnp.stack(found)

    def measures(y):
        if not separate:
            return {}
        volume = use(inputs, unit.shape) * units[3]
        return {"seed_volume": volume * y[3], "nuclei_volume": volume * y[MOMENTS + 3]}

    start = (seed + fed) / units
    return Population(
        start=jnp.concatenate([start, jnp.zeros(MOMENTS)]) if separate else start,
        seed=seed[3] / units[3],
        moments=lambda y: y[:MOMENTS] + y[MOMENTS:] if separate else y,
        slope=slope,
        states=lambda y: {},
        measures=measures,
    )
