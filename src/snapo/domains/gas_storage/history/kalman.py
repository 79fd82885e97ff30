"""The Kalman filter of a Gaussian price model, one scalar price at a time, in plain JAX.

The prices of a date are conditionally independent, so that the state is updated with one price
after another. Only a scalar variance is inverted. A measurement error may therefore be exactly
zero, and a missing price is skipped. Source: Durbin and Koopman (2012), "Time Series Analysis by
State Space Methods", 6.4.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .model import HistoryModel


class History(NamedTuple):
    """N dates with up to M prices each.

    - `gap` [N]: years since the date before, 0 for the first.
    - `value` [N, M]: X of each price; `present` [N, M]: whether there is a price.
    - `years` [N, M]: years to delivery; `phase` [N, M]: time of delivery as a share of its year.
    - `column` [N, M]: the series of each price, which determines the measurement error.
    - `first` []: the value of X at which the long-term level begins on average.
    """

    gap: Float[Array, " N"]
    value: Float[Array, "N M"]
    present: Bool[Array, "N M"]
    years: Float[Array, "N M"]
    phase: Float[Array, "N M"]
    column: Int[Array, "N M"]
    first: Float[Array, ""]


class Filtered(NamedTuple):
    """`log_likelihood` []; `mean` [N, F] and `covariance` [N, F, F] of the state on each date,
    with the prices of that date."""

    log_likelihood: Float[Array, ""]
    mean: Float[Array, "N F"]
    covariance: Float[Array, "N F F"]


def filtered(
    model: HistoryModel,
    numbers: Float[Array, " P"],
    history: History,
    initial: tuple[Array, Array] | None = None,
) -> Filtered:
    """The log-likelihood and the states; the log-likelihood includes the constant -ln(2 pi) / 2 of
    every price.

    `initial`: mean [F] and covariance [F, F] of the state before the first price; by default those
    of the model, which depend on its parameters.
    """
    deviations = model.deviations(numbers)

    def update(state, price):
        mean, covariance, total = state
        value, present, years, phase, column = price
        constant, loading = model.observed(numbers, years, phase)
        gain = covariance @ loading
        variance = loading @ gain + deviations[column] ** 2
        variance = jnp.where(present, variance, 1.0)
        error = jnp.where(present, value - constant - loading @ mean, 0.0)
        gain = jnp.where(present, gain, 0.0)
        mean = mean + gain * (error / variance)
        covariance = covariance - jnp.outer(gain, gain) / variance
        term = jnp.log(2 * jnp.pi * variance) + error**2 / variance
        return (mean, covariance, total - jnp.where(present, term, 0.0) / 2), None

    def date(state, row):
        mean, covariance, total = state
        gap, prices = row
        decay, drift, noise = model.transition(numbers, gap)
        later = gap > 0
        covariance = jnp.where(later, jnp.outer(decay, decay) * covariance + noise, covariance)
        mean = jnp.where(later, decay * mean + drift, mean)
        state, _ = jax.lax.scan(update, (mean, covariance, total), prices)
        return state, state[:2]

    initial = model.initial(numbers, history.first) if initial is None else initial
    start = (*initial, jnp.zeros(()))
    prices = (history.value, history.present, history.years, history.phase, history.column)
    (_, _, total), (mean, covariance) = jax.lax.scan(date, start, (history.gap, prices))
    return Filtered(total, mean, covariance)


def log_likelihood(model: HistoryModel, numbers: Float[Array, " P"], history: History):
    """The natural logarithm of the density of all prices of a history, []."""
    return filtered(model, numbers, history).log_likelihood
