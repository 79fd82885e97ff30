"""Quotes of a curve as continuous zero rates, and back."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..records.market import Curve
from .smith_wilson import log_bond

ROUNDS = 8  # of Newton's method; the zero rates of swaps are nearly linear in their rates


def zero_rates(curve: Curve) -> np.ndarray:
    """[n] continuous zero rates at the nodes, whatever is quoted."""
    if curve.quote == "zero":
        return curve.rate.used()
    if curve.quote == "swap":
        with jax.enable_x64(True):
            return np.asarray(_of_swaps(curve, jnp.asarray(curve.rate.used())))
    return np.cumsum(curve.rate.used() * np.diff(curve.tenor, prepend=0.0)) / curve.tenor


def from_zero_rates(curve: Curve, zero: np.ndarray) -> np.ndarray:
    """The quotes of these zero rates: the inverse of `zero_rates`."""
    if curve.quote == "zero":
        return zero
    if curve.quote == "swap":
        return _to_swaps(curve, zero)
    return np.diff(zero * curve.tenor, prepend=0.0) / np.diff(curve.tenor, prepend=0.0)


@partial(jax.jit, static_argnums=0)
def _of_swaps(curve: Curve, rate: Array) -> Array:
    return -log_bond(curve, rate, jnp.asarray(curve.ultimate.used()), curve.tenor) / curve.tenor


@partial(jax.jit, static_argnums=0)
def _closer(curve: Curve, rate: Array, zero: Array) -> Array:
    """The swap rates after a step of Newton's method."""
    missed = _of_swaps(curve, rate) - zero
    return rate - jnp.linalg.solve(jax.jacfwd(_of_swaps, 1)(curve, rate), missed)


def _to_swaps(curve: Curve, zero: np.ndarray) -> np.ndarray:
    with jax.enable_x64(True):
        rate = jnp.asarray(curve.rate.used())
        for _ in range(ROUNDS):
            rate = _closer(curve, rate, jnp.asarray(zero))
        return np.asarray(rate)
