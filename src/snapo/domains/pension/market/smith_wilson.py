"""The Smith-Wilson curve: it meets every quote, and its forward rates go to an ultimate one.

With w the ultimate forward rate (continuous), H the heart of Wilson's function and u the m dates
of the quotes' cash flows, a bond that pays 1 at t costs

    P(t) = exp(-w t) (1 + H(t, u) Q b),   H(t, u) = (a (t + u) + exp(-a (t + u)) - a |t - u|
                                                     - exp(-a |t - u|)) / 2

Each quote is an instrument of price 1 whose cash flows, times exp(-w u), are a column of Q [m, n];
b solves Q' H Q b = 1 - Q' 1. The speed a is specified, or the smallest from 0.05 to 1 at which the
forward rate at the convergence point T is within one basis point of w:

    |f(T) - w| = a / |1 - k exp(a T)|,   k = (1 + a u' Q b) / (sinh(a u)' Q b)

EIOPA, Technical documentation of the methodology to derive EIOPA's risk-free interest rate term
structures, 12 September 2019, sections 7 and 8 (a rounded up to six decimals there, here not).
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..records.market import MarketCurve

MINIMUM, MAXIMUM = 0.05, 1.0  # of the speed
NEAR = 1e-4  # the distance of the forward rate at the convergence point
# The speed is looked for in 95 parts of its range, then in 95 of the part where it lies, and so on.
SHARES, ROUNDS = np.linspace(0.0, 1.0, 96), 5


class CurveFit(NamedTuple):
    """A fitted curve: `dates` [m] of the cash flows, `weights` Q b [m], `speed` a."""

    dates: np.ndarray
    weights: Array
    speed: Array


def log_bond(
    curve: MarketCurve, rate: Array, ultimate: Array, years: np.ndarray
) -> Float[Array, " times"]:
    """ln P(0, t) at times `years` [times] >= 0; derivatives take a computed speed into account."""
    result = fit(curve, rate, ultimate)
    added = heart(years, result.dates, result.speed) @ result.weights
    return jnp.log1p(added) - ultimate * years


def fit(curve: MarketCurve, rate: Array, ultimate: Array) -> CurveFit:
    """The weights that meet the quotes `rate` [n]."""
    form = jax.tree.map(lambda leaf: None, curve)
    weights, speed = _fitted(form, rate, ultimate)
    return CurveFit(_dates(curve), weights, speed)


@partial(jax.jit, static_argnums=0)  # once for each form: the search for a speed takes a second
def _fitted(curve: MarketCurve, rate: Array, ultimate: Array) -> tuple[Array, Array]:
    dates, flows = cash_flows(curve, rate)
    local = jnp.exp(-ultimate * dates)[:, None] * flows.T
    if curve.speed is not None:
        speed = jnp.asarray(curve.speed)
    else:
        speed = _found_speed(dates, local, curve.convergence)
    return _weights(dates, local, speed), speed


def _dates(curve: MarketCurve) -> np.ndarray:
    if curve.quote == "zero":
        return curve.tenor
    return np.arange(1.0, curve.tenor[-1] + 0.5)


def cash_flows(curve: MarketCurve, rate: Array) -> tuple[np.ndarray, Float[Array, "n m"]]:
    """Dates [m] and payments of n instruments of price 1: zero-coupon bonds, or par bonds that
    pay the swap rate every year."""
    dates = _dates(curve)
    if curve.quote == "zero":
        return dates, jnp.diag(jnp.exp(rate * dates))
    coupon, last = dates <= curve.tenor[:, None], dates == curve.tenor[:, None]
    return dates, rate[:, None] * coupon + last


def heart(times: np.ndarray, dates: np.ndarray, speed: Array) -> Float[Array, "times m"]:
    """H(t, u)."""
    total, apart = times[:, None] + dates, np.abs(times[:, None] - dates)
    return (speed * (total - apart) + jnp.exp(-speed * total) - jnp.exp(-speed * apart)) / 2


def distance(dates: np.ndarray, local: Array, speed: Array, convergence: float) -> Array:
    """ln of |f(T) - w| over the required one; 0 or less where it is met."""
    weights = _weights(dates, local, speed)
    k = (1 + speed * dates @ weights) / (jnp.sinh(speed * dates) @ weights)
    gap = speed / jnp.abs(1 - k * jnp.exp(speed * convergence))
    return jnp.log(gap / NEAR)


def _weights(dates: np.ndarray, local: Array, speed: Array) -> Float[Array, " m"]:
    matrix = local.T @ heart(dates, dates, speed) @ local
    return local @ jnp.linalg.solve(matrix, 1 - local.sum(0))


def _found_speed(dates: np.ndarray, local: Array, convergence: float) -> Array:
    """The least speed that converges, differentiated by the implicit function theorem."""
    held = jax.lax.stop_gradient(local)

    def missed(speed, custom=held):
        return distance(dates, custom, speed, convergence)

    def closer(_, position):
        low, width = position
        grid = low + width * SHARES
        first = jnp.argmax(jax.vmap(missed)(grid) <= 0)
        return jnp.maximum(grid[first] - width * SHARES[1], MINIMUM), width * SHARES[1]

    start = jnp.asarray(MINIMUM), jnp.asarray(MAXIMUM - MINIMUM)
    low, width = jax.lax.fori_loop(0, ROUNDS, closer, start)
    speed = low + width / 2
    # One step of Newton's method leaves no error, and its derivative is that of the root.
    moved = speed - missed(speed, local) / jax.lax.stop_gradient(jax.grad(missed)(speed))
    return jnp.where(missed(jnp.asarray(MINIMUM)) > 0, moved, MINIMUM)
