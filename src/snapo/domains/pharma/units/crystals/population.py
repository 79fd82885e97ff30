"""Crystals as a crystalliser sees them, whichever way their sizes are followed."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...flowsheet.stream import MOMENTS

# Sizes are counted in units of SIZE m and crystals in NUMBER per m3, so that both are of order one.
SIZE, NUMBER = 1e-4, 1e10
UNITS = NUMBER * SIZE ** np.arange(MOMENTS)


class Population(NamedTuple):
    """Crystals per first volume, as m numbers in SIZE and NUMBER.

    - `start`: [m]; `seed`: mu3 of the seed that was added, scaled.
    - `moments`: from [m] to the scaled moments 0 to 5 of all crystals.
    - `slope`: from [m], growth in SIZE/s and births in NUMBER/m3/s to [m] per s.
    - `numbers`: from [m] to the crystals in each cell, in NUMBER; [0] where they are not counted.
    - `states`, `measures`: from [m] to further figures of the sizes, over time
      and at the end, in the domain's units.
    """

    start: Float[Array, " m"]
    seed: Float[Array, ""]
    moments: Callable[[Array], Array]
    slope: Callable[[Array, Array, Array], Array]
    numbers: Callable[[Array], Array]
    states: Callable[[Array], dict[str, Array]]
    measures: Callable[[Array], dict[str, Array]]


def mean_sizes(moments: Float[Array, "... 6"]) -> dict[str, Array]:
    """d32 = mu3 / mu2 and d43 = mu4 / mu3 in m; 0 without crystals."""
    table = {}
    for name, upper in (("d32", 3), ("d43", 4)):
        above, below = moments[..., upper], moments[..., upper - 1]
        empty = below <= 0
        table[name] = jnp.where(empty, 0.0, above / jnp.where(empty, 1.0, below))
    return table


def cell_powers(edges: np.ndarray) -> Float[np.ndarray, "6 N"]:
    """The mean of L^k over each cell, k = 0 to 5."""
    k = np.arange(1, MOMENTS + 1)[:, None]
    return np.diff(edges**k, axis=1) / (k * np.diff(edges))
