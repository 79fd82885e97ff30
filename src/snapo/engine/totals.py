"""How an output's total over a path is made from its steps."""

import jax.numpy as jnp


def add(kind: str, total, value):
    """The total after one more number: "sum", "max" or "last"."""
    if total is None or kind == "last":
        return value
    return jnp.maximum(total, value) if kind == "max" else total + value


def zero(kind: str, dtype):
    """The total before the first step."""
    return jnp.asarray(-jnp.inf if kind == "max" else 0.0, dtype)
