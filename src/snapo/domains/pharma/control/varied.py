"""The differences from batch to batch of a closed loop: which numbers, and how they are drawn."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..flowsheet.case import PharmaCase
from ..quality.records import Distribution


@dataclass(frozen=True, eq=False)
class Varied:
    """[V] the differences from batch to batch: the uncertain numbers, and after them the process
    parameters that do not hold exactly; `correlated`: [V, V] Cholesky factor of their normals."""

    inputs: tuple[str, ...]
    entries: tuple[int, ...]
    distributions: tuple[Distribution, ...]
    when: tuple[str, ...]
    correlated: np.ndarray


def varied(case: PharmaCase) -> Varied:
    """The same numbers as those of `draws.all_entries`."""
    available, moving = (
        case.uncertainty,
        [parameter for parameter in case.parameters if parameter.distribution],
    )
    size = len(available.inputs)
    factor = np.eye(size + len(moving))
    if size:
        factor[:size, :size] = np.linalg.cholesky(available.correlation)
    return Varied(
        available.inputs + tuple(item.input for item in moving),
        available.entries + tuple(entry.entry for entry in moving),
        available.distributions
        + tuple(value.distribution for value in moving if value.distribution),
        available.when + ("batch",) * len(moving),
        factor,
    )


def drawn(distribution: Distribution, centre, z) -> Array:
    """The value of a standard normal; formulas in `Distribution`."""
    if distribution.kind == "normal":
        return centre + distribution.spread * z
    if distribution.kind == "lognormal":
        return centre * jnp.exp(distribution.spread * z - distribution.spread**2 / 2)
    return centre + distribution.spread * (2 * jax.scipy.special.ndtr(z) - 1)
