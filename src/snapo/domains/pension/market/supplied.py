"""A market from a file of ready-made scenarios: returns, inflation, wages and zero rates."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..records.case import PensionModel
from ..records.market import SuppliedScenarios
from .assets.swaps import fixed_legs
from .bonds.strips import gain
from .curve import log_bond
from .state import LONG, Market, MarketSteps, MarketTerms, Move, at_start


def supplied_schedule(
    case: PensionModel, scenarios: SuppliedScenarios, inputs: dict[str, Any], nodes: np.ndarray
) -> tuple[MarketTerms, MarketSteps, Array]:
    """Zero rates of the file take the factors' place: ln P(t, t+u) = -u z(u), linear in them."""

    def slopes(years: np.ndarray) -> np.ndarray:
        linear = [np.interp(years, scenarios.tenor, row) for row in np.eye(len(scenarios.tenor))]
        return years[:, None] * np.stack(linear, axis=1)

    start = -log_bond(case.curve, inputs, scenarios.tenor) / scenarios.tenor
    fixed = case.liability.basis == "fixed"
    short = np.array([case.step])
    terms = MarketTerms(
        start=at_start(start),
        slope=jnp.asarray(slopes(nodes * case.step) * (not fixed)),
        rate_slope=jnp.asarray(
            np.concatenate([slopes(np.array([LONG])) / LONG, slopes(short) / short])
        ),
        swap_slope=None if case.overlay is None else _swap_slope(case, slopes),
    )
    steps = MarketSteps(rate_level=jnp.zeros((case.steps, 2)))
    return terms, steps, jnp.zeros((case.steps + 1, len(nodes)))


def _swap_slope(case: PensionModel, slopes: Callable) -> Array:
    """[2, J, k] slopes of the swaps' payments before and after a step."""
    due = fixed_legs(case).steps
    both = [slopes(steps * case.step) for steps in (due, due - 1)]
    return jnp.asarray(np.stack(both))


def supplied_move(case: PensionModel, terms: MarketTerms, market: Market, noise: Array) -> Move:
    """A step of a scenario file: returns, inflation, wage growth, zero rates at its end."""
    count = len(case.assets.classes)
    gross, zeros = 1 + noise[:count], noise[count + 2 :]
    cash = jnp.log(gross[case.assets.cash])
    swaps = None
    if terms.swap_slope is not None:
        before, later = terms.swap_slope[0] @ market.factors, terms.swap_slope[1] @ zeros
        growth = jnp.expm1(before - later - cash)
        swaps = jnp.log1p(gain(fixed_legs(case), jnp.exp(-before), growth))
    after = market._replace(
        factors=zeros,
        log_price=market.log_price + noise[count],
        log_wage=market.log_wage + noise[count + 1],
        log_discount=market.log_discount - cash,
    )
    return Move(cash, gross, swaps, after)
