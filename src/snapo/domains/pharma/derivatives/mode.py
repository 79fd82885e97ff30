"""The two modes of differentiation of a traceable function without paths.

Adjoint mode needs one backward pass for each number that the function returns, forward mode one
tangent for each number that it takes. Both functions have the arguments `argnums` and `has_aux`, as
in JAX.
"""

from collections.abc import Callable
from typing import Literal

import jax

Mode = Literal["adjoint", "forward"]

DERIVATIVES: dict[Mode, Callable] = {"adjoint": jax.jacrev, "forward": jax.jacfwd}


def of_method(method: Literal["mesh", "adaptive"]) -> Callable:
    """The derivative of a few numbers with respect to a few others, in the mode that this method of
    integration allows: error control has only an adjoint."""
    return DERIVATIVES["adjoint" if method == "adaptive" else "forward"]
