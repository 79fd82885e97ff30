"""The two modes of differentiation of a traceable function without paths.

Adjoint: one pass back for each number that the function returns. Forward: one tangent for each
number that it takes. Both take `argnums` and `has_aux` as JAX does.
"""

from collections.abc import Callable
from typing import Literal

import jax

Mode = Literal["adjoint", "forward"]

DERIVATIVES: dict[Mode, Callable] = {"adjoint": jax.jacrev, "forward": jax.jacfwd}


def of_method(method: Literal["mesh", "adaptive"]) -> Callable:
    """The derivative of a few numbers by a few, through this method of integration: error control
    has only an adjoint."""
    return DERIVATIVES["adjoint" if method == "adaptive" else "forward"]
