"""Spot prices of one path: correlated mean-reverting factors around the forward curve, or supplied.

S(T) = F(T) exp(sum_i s_i(T) f_i(T) - variance(T) / 2), df_i = -a_i f_i dt + dW_i, f_i = 0 on the
valuation date, dW_i dW_j = rho_ij dt, so that E[S(T)] = F(T). Covariances are exact over any
interval: Cov(f_i, f_j) = rho_ij (1 - exp(-(a_i + a_j) t)) / (a_i + a_j). A seasonal model is three
independent factors (spot, long-term, seasonal); its source is the package cmdty-storage.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.case.given import Given

from .records import FactorModel, SeasonalModel, StorageCase, SuppliedModel

YEAR = 365.0


class PriceSchedule(NamedTuple):
    """The factors' numbers per decision day; F factors, the last axis of `loading`.

    - `loading` [T, F] s_i and `variance` [T] of ln S on day t.
    - `decay` [F, …] and `shock` (lower Cholesky factor) lead INTO day t, `next_decay` and
      `next_shock` out of it to day t + 1.
    - `slow_variance` [T] of ln S without the fastest factor; `price_features` [T, F] scales the
      factors to order one.
    """

    loading: Float[Array, "T F"]
    variance: Float[Array, " T"]
    decay: Float[Array, "T F"]
    shock: Float[Array, "T F F"]
    next_decay: Float[Array, "T F"]
    next_shock: Float[Array, "T F F"]
    slow_variance: Float[Array, " T"]
    price_features: Float[Array, "T F"]


def use(inputs: dict[str, Any], given: Given):
    """The numbers of an input where they are used: its values at `given.index`."""
    if not given.values.size:
        return jnp.zeros(given.index.shape)
    return jnp.asarray(inputs[given.name])[given.index]


def factors(case: StorageCase) -> int:
    """The number of price factors."""
    model = case.model
    if isinstance(model, FactorModel):
        return len(model.mean_reversion.used())
    return 3 if isinstance(model, SeasonalModel) else 1


def fast_factor(case: StorageCase) -> int:
    """The factor that reverts fastest."""
    model = case.model
    return int(np.argmax(model.mean_reversion.used())) if isinstance(model, FactorModel) else 0


def price_schedule(
    case: StorageCase, inputs: dict[str, Any]
) -> tuple[PriceSchedule, PriceSchedule]:
    """The factors' numbers on the T decision days, and on the end date (leading axis 1)."""
    reversion, loading, correlation = _parameters(case, inputs)
    days = np.append(case.day, case.end_day).astype(float)
    years = np.maximum(days, 0) / YEAR
    pair = reversion[:, None] + reversion[None, :]
    covariance = correlation * integral(pair, years[:, None, None])
    variance = jnp.einsum("ti,tij,tj->t", loading, covariance, loading)
    # Days follow one another; only the first may lie further from the valuation date.
    step = np.diff(years, prepend=0.0)
    decay = jnp.exp(-reversion * step[:, None])
    daily = jnp.linalg.cholesky(correlation * integral(pair, 1 / YEAR))
    first = jnp.zeros_like(daily)
    if step[0] > 0:
        first = jnp.linalg.cholesky(correlation * integral(pair, step[0]))
    shock = jnp.concatenate([first[None], jnp.broadcast_to(daily, (len(days) - 1, *daily.shape))])
    slow = (np.arange(loading.shape[1]) != fast_factor(case)).astype(float)
    slow_variance = jnp.einsum("ti,tij,tj->t", loading * slow, covariance, loading * slow)
    # The spot's fast swings are told in standard deviations, the slow factors in their own size.
    deviation = jnp.sqrt(jnp.diagonal(integral(pair, 1.0)))
    features = jnp.broadcast_to(1 / deviation, loading.shape)
    rows = PriceSchedule(loading, variance, decay, shock, decay, shock, slow_variance, features)
    days = jax.tree.map(lambda leaf: leaf[:-1], rows)
    days = days._replace(next_decay=decay[1:], next_shock=shock[1:])
    return days, jax.tree.map(lambda leaf: leaf[-1:], rows)


def integral(rate, time):
    """(1 - exp(-rate time)) / rate, which is `time` at rate 0; differentiable there."""
    x = rate * time
    small = jnp.abs(x) < 1e-5
    safe = jnp.where(small, 1.0, x)
    return time * jnp.where(small, 1 - x / 2 + x * x / 6, -jnp.expm1(-safe) / safe)


def _parameters(case: StorageCase, inputs: dict[str, Any]):
    """Mean reversions [F], loadings [T + 1, F], correlation [F, F]."""
    model = case.model
    if isinstance(model, SeasonalModel):
        spot = use(inputs, model.spot_mean_reversion)
        zero = jnp.zeros_like(spot)
        season = use(inputs, model.seasonal_volatility) / 2 * model.season
        flat = jnp.ones_like(model.season)
        loading = jnp.stack(
            [
                use(inputs, model.spot_volatility) * flat,
                use(inputs, model.long_term_volatility) * flat,
                season,
            ],
            axis=1,
        )
        return jnp.stack([spot, zero, zero]), loading, jnp.eye(3)
    if isinstance(model, FactorModel):
        size = factors(case)
        lower = (
            jnp.zeros((size, size))
            .at[np.tril_indices(size, -1)]
            .set(use(inputs, model.correlation))
        )
        correlation = lower + lower.T + jnp.eye(size)
        return use(inputs, model.mean_reversion), use(inputs, model.volatility), correlation
    # Supplied prices: the one "factor" is the price, or its ratio to the forward, itself.
    return jnp.zeros(1), jnp.zeros((len(case.day) + 1, 1)), jnp.eye(1)


def spot(case: StorageCase, forward, loading, variance, price):
    """Spot from the state of the prices `price` [F]."""
    if isinstance(case.model, SuppliedModel):
        return forward * price[0] if case.model.rescaled else price[0]
    return forward * jnp.exp(jnp.sum(loading * price) - variance / 2)


def first_price(case: StorageCase, shock, noise):
    """The prices' state on the first decision day."""
    return noise if isinstance(case.model, SuppliedModel) else shock @ noise


def next_price(case: StorageCase, now, price, noise):
    """The prices' state on the day after."""
    if isinstance(case.model, SuppliedModel):
        return noise
    return now.next_decay * price + now.next_shock @ noise
