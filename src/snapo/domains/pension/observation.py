"""What the policy sees of a pension fund: named numbers of order one, in the order of the case."""

from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .records import PensionCase

if TYPE_CHECKING:
    from .schedule import Period, Terms
    from .simulator import State

NAMES = (
    "time",
    "funding_ratio",
    "relative_funding",
    "rates",
    "long_rate",
    "short_rate",
    "inflation",
    "realised_inflation",
    "spreads",
    "mortality",
    "weights",
    "overlay",
    "accrued",
)
# These move with the initial curve; a policy without them meets the curve identity.
CURVE_DEPENDENT = frozenset({"funding_ratio", "long_rate", "short_rate"})

RATIO = 0.2  # of ln F: a number of order one is a fifth of the funding ratio
RATE = 0.02
LEAST_RATIO = 1e-3  # the logarithm's argument stays above this where assets are gone


def sizes(case: PensionCase) -> dict[str, int]:
    """How many numbers each name stands for."""
    factors = len(case.rates.mean_reversion.index)
    if case.scenarios is not None:
        factors = len(case.scenarios.tenor)
    several = {
        "rates": factors,
        "spreads": len(case.credit.names) if case.scenarios is None else 0,
        "weights": len(case.assets.classes),
        "overlay": case.buckets,
        "inflation": 1 if case.scenarios is None else 0,
    }
    return {name: several.get(name, 1) for name in NAMES}


def slots(case: PensionCase) -> dict[str, slice]:
    """Where each observed name stands in the observation."""
    found, start, size = {}, 0, sizes(case)
    for name in case.observation:
        found[name] = slice(start, start + size[name])
        start += size[name]
    return found


def observe(
    case: PensionCase, terms: "Terms", now: "Period", state: "State", ratio: Array
) -> Float[Array, " features"]:
    """The observation of one path at the start of a step; `ratio` is the funding ratio F.

    Logs of ratios are divided by `RATIO`, rates by `RATE`, the generator's factors by their
    standard deviation over ten years (`scales`).
    """
    market = state.market
    ratio = jnp.where(ratio > LEAST_RATIO, ratio, LEAST_RATIO)
    now_ratio = terms.assets / terms.liability
    levels = (now.market.rate_level + terms.market.rate_slope @ market.factors) / RATE
    seen = {
        "time": lambda: 2 * now.time - 1,
        "funding_ratio": lambda: jnp.log(ratio) / RATIO,
        "relative_funding": lambda: jnp.log(ratio / now_ratio) / RATIO,
        "rates": lambda: _rates(case, market.factors),
        "long_rate": lambda: levels[0],
        "short_rate": lambda: levels[1],
        "inflation": lambda: market.factors[-1] / scales(case)[-1],
        "realised_inflation": lambda: (market.log_price - state.log_price_last) / RATE,
        "spreads": lambda: market.spread / spread_scales(case),
        "mortality": lambda: market.mortality / mortality_scale(case),
        "weights": lambda: state.weights,
        "overlay": lambda: state.overlay,
        "accrued": lambda: jnp.log(state.theta) / RATIO,
    }
    size = sizes(case)
    parts = [jnp.reshape(seen[name](), (-1,)) for name in case.observation if size[name]]
    return jnp.concatenate(parts)


def _rates(case: PensionCase, factors: Array) -> Array:
    if case.scenarios is not None:
        return factors / RATE
    return factors[:-1] / scales(case)[:-1]


def scales(case: PensionCase) -> np.ndarray:
    """[g] standard deviation of each factor after ten years, from the case's own numbers."""
    rates, inflation = case.rates, case.inflation
    a = np.append(rates.mean_reversion.used(), inflation.mean_reversion.used())
    used = np.column_stack([rates.volatility.used(), inflation.volatility.used()]).mean(axis=0)
    deviation = used * np.sqrt(-np.expm1(-20 * a) / (2 * a))
    return np.where(deviation > 0, deviation, 1.0)


def spread_scales(case: PensionCase) -> np.ndarray:
    """[R] the same of ln(s / mean)."""
    a, credit = case.credit.mean_reversion.used(), case.credit
    volatility = credit.volatility.used() if credit.volatility.values.size else np.zeros(len(a))
    deviation = volatility * np.sqrt(-np.expm1(-20 * a) / (2 * a))
    return np.where(deviation > 0, deviation, 1.0)


def mortality_scale(case: PensionCase) -> float:
    """The same of Lee-Carter's k."""
    if case.lee_carter is None:
        return 1.0
    return max(float(case.lee_carter.volatility.used()) * 10**0.5, 1e-9)
