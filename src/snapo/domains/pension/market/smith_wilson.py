"""The Smith-Wilson curve: it fits every quote, and its forward rates converge to an ultimate one.

With w the ultimate forward rate (continuous), H the heart of Wilson's function and u the m dates of
the quotes' cash flows, the price of a bond that pays 1 at t is

    P(t) = exp(-w t) (1 + H(t, u) Q b),   H(t, u) = (a (t + u) + exp(-a (t + u)) - a |t - u|
                                                     - exp(-a |t - u|)) / 2

Each quote is an instrument of price 1 whose cash flows, times exp(-w u), are a column of Q [m, n];
b solves Q' H Q b = 1 - Q' 1. The speed a is specified, or the smallest from 0.05 to 1 at which the
forward rate at the convergence point T is within one basis point of w:

    |f(T) - w| = a / |1 - k exp(a T)|,   k = (1 + a u' Q b) / (sinh(a u)' Q b)

EIOPA, Technical documentation of the methodology to derive EIOPA's risk-free interest rate term
structures, 12 September 2019, sections 7 and 8 (a rounded up to six decimals there, here not).
"""

from collections.abc import Callable
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float, jax
from snapo.problem.record.either import derivative, fixed, in_use, over, repeated, xp

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
    """ln P(0, t) at times `years` [times] >= 0. If the speed is computed, derivatives include its
    change."""
    result = fit(curve, rate, ultimate)
    added = heart(years, result.dates, result.speed) @ result.weights
    return xp.log1p(added) - ultimate * years


def fit(curve: MarketCurve, rate: Array, ultimate: Array) -> CurveFit:
    """The weights that fit the quotes `rate` [n]."""
    if in_use():
        weights, speed = _fitted(curve, rate, ultimate)
    else:
        form = jax.tree.map(lambda leaf: None, curve)
        weights, speed = _compiled()(form, rate, ultimate)
    return CurveFit(_dates(curve), weights, speed)


@cache
def _compiled() -> Callable[..., tuple[Array, Array]]:
    """The fit, compiled once for each form, since the search for a speed takes a second in a
    trace."""
    return jax.jit(_fitted, static_argnums=0)


def _fitted(curve: MarketCurve, rate: Array, ultimate: Array) -> tuple[Array, Array]:
    dates, flows = cash_flows(curve, rate)
    local = xp.exp(-ultimate * dates)[:, None] * flows.T
    if curve.speed is not None:
        speed = xp.asarray(curve.speed)
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
        return dates, xp.diag(xp.exp(rate * dates))
    coupon, last = dates <= curve.tenor[:, None], dates == curve.tenor[:, None]
    return dates, rate[:, None] * coupon + last


def heart(times: np.ndarray, dates: np.ndarray, speed: Array) -> Float[Array, "times m"]:
    """H(t, u)."""
    total, apart = times[:, None] + dates, np.abs(times[:, None] - dates)
    return (speed * (total - apart) + xp.exp(-speed * total) - xp.exp(-speed * apart)) / 2


def distance(dates: np.ndarray, local: Array, speed: Array, convergence: float) -> Array:
    """The logarithm of |f(T) - w| divided by the largest distance allowed; it is at most 0 if the
    curve has converged."""
    weights = _weights(dates, local, speed)
    k = (1 + speed * dates @ weights) / (xp.sinh(speed * dates) @ weights)
    gap = speed / xp.abs(1 - k * xp.exp(speed * convergence))
    return xp.log(gap / NEAR)


def _weights(dates: np.ndarray, local: Array, speed: Array) -> Float[Array, " m"]:
    matrix = local.T @ heart(dates, dates, speed) @ local
    return local @ xp.linalg.solve(matrix, 1 - local.sum(0))


def _found_speed(dates: np.ndarray, local: Array, convergence: float) -> Array:
    """The smallest speed that converges, differentiated by the implicit function theorem."""
    held = fixed(local)

    def missed(speed, custom=held):
        return distance(dates, custom, speed, convergence)

    if in_use():
        speed = _remembered(tuple(dates), held.shape, held.tobytes(), convergence)
    else:
        speed = _search(dates, held, convergence)
    # One step of Newton's method leaves no error, and its derivative is that of the root.
    moved = speed - missed(speed, local) / fixed(derivative(missed)(speed))
    return xp.where(missed(xp.asarray(MINIMUM)) > 0, moved, MINIMUM)


def _search(dates: np.ndarray, local: Any, convergence: float) -> Any:
    """The middle of the last interval in which the speed lies."""

    def missed(speed):
        return distance(dates, local, speed, convergence)

    def closer(_, position):
        low, width = position
        grid = low + width * SHARES
        first = xp.argmax(over(missed)(grid) <= 0)
        return xp.maximum(grid[first] - width * SHARES[1], MINIMUM), width * SHARES[1]

    start = xp.asarray(MINIMUM), xp.asarray(MAXIMUM - MINIMUM)
    low, width = repeated(ROUNDS, closer, start)
    return low + width / 2


@lru_cache(maxsize=4)  # derivatives with respect to all quotes need one search
def _remembered(
    dates: tuple[float, ...], shape: tuple[int, ...], local: bytes, convergence: float
) -> Any:
    """`_search` in NumPy, of `local` as bytes."""
    return _search(np.array(dates), np.frombuffer(local).reshape(shape), convergence)
