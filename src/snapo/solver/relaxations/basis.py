"""Functions of a state on which the worth of waiting is fitted: polynomials of what is known.

Known are the policy's observation and the gain of stopping now. Each is measured in its own
standard deviations at that step, and held within a few of them, since polynomials run away.
"""

from itertools import combinations_with_replacement
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

MOST, DEGREE = 100, 6  # functions, and the degree of a polynomial
REACH = 4.0  # standard deviations
LEAST = 1e-9  # of a number's size: a smaller deviation is none


def exponents(numbers: int) -> list[tuple[int, ...]]:
    """The factors of every monomial, by degree: (), (0,), (1,), (0, 0), …; at most `MOST`."""
    found: list[tuple[int, ...]] = []
    for degree in range(DEGREE + 1):
        more = list(combinations_with_replacement(range(numbers), degree))
        if degree > 1 and len(found) + len(more) > MOST:
            break
        found += more
    return found


class Scale(NamedTuple):
    """How the numbers [d] of one step are measured: less `centre`, times `per`."""

    centre: Float[Array, " d"]
    per: Float[Array, " d"]

    @classmethod
    def of(cls, numbers: Float[np.ndarray, "paths d"]) -> "Scale":
        """From a sample; a number that is the same on all paths counts as zero."""
        centre, deviation = numbers.mean(0), numbers.std(0)
        varies = deviation > LEAST * np.maximum(np.abs(centre), 1.0)
        per = np.where(varies, 1 / np.where(varies, deviation, 1.0), 0.0)
        return cls(jnp.asarray(centre), jnp.asarray(per))


def functions(numbers: Float[Array, " d"], scale: Scale) -> Float[Array, " functions"]:
    """The monomials of one path's numbers."""
    x = jnp.clip((numbers - scale.centre) * scale.per, -REACH, REACH)
    found: dict[tuple[int, ...], Array] = {(): jnp.ones((), x.dtype)}
    for factors in exponents(x.shape[0])[1:]:
        found[factors] = found[factors[:-1]] * x[factors[-1]]
    return jnp.stack(list(found.values()))
