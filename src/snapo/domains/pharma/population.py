"""What a crystalliser is told of its crystals, whichever way their sizes are followed."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .inputs import use
from .records_units import Seed
from .stream import MOMENTS

# Sizes are counted in units of SIZE m and crystals in NUMBER per m3, so that both are of order one.
SIZE, NUMBER = 1e-4, 1e10
UNITS = NUMBER * SIZE ** np.arange(MOMENTS)


class Population(NamedTuple):
    """Crystals per first volume, as m numbers in SIZE and NUMBER.

    - `start`: [m]; `seed`: mu3 of the seed that was added, scaled.
    - `moments`: from [m] to the scaled moments 0 to 5 of all crystals.
    - `slope`: from [m], growth in SIZE/s and births in NUMBER/m3/s to [m] per s.
    - `states`, `measures`: from [m] to what is known of the sizes beside the moments, over time
      and at the end, in the domain's units.
    """

    start: Float[Array, " m"]
    seed: Float[Array, ""]
    moments: Callable[[Array], Array]
    slope: Callable[[Array, Array, Array], Array]
    states: Callable[[Array], dict[str, Array]]
    measures: Callable[[Array], dict[str, Array]]


def seed_moments(seed: Seed, inputs: dict[str, Any], shape, density) -> Float[Array, " 6"]:
    """m^k/m3 of the seed: as given, or of `loading` kg/m3 crystals of mean `size`.

    Lognormal with standard deviation `spread` times the mean: mu_k = N size^k s^(k (k - 1) / 2),
    s = 1 + spread^2. Without spread all are of one size.
    """
    if seed.moments is not None:
        return use(inputs, seed.moments)
    assert seed.loading is not None and seed.size is not None
    size, wider = use(inputs, seed.size), jnp.ones(())
    if seed.spread is not None:
        wider = 1 + use(inputs, seed.spread) ** 2
    number = use(inputs, seed.loading) / (density * shape * size**3 * wider**3)
    return number * jnp.stack([size**k * wider ** (k * (k - 1) / 2) for k in range(MOMENTS)])


def mean_sizes(moments: Float[Array, "... 6"]) -> dict[str, Array]:
    """d32 = mu3 / mu2 and d43 = mu4 / mu3 in m; 0 without crystals."""
    found = {}
    for name, upper in (("d32", 3), ("d43", 4)):
        above, below = moments[..., upper], moments[..., upper - 1]
        empty = below <= 0
        found[name] = jnp.where(empty, 0.0, above / jnp.where(empty, 1.0, below))
    return found
