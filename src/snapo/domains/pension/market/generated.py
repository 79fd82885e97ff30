"""A market from the models: Gaussian rates, inflation, spreads, currencies and asset returns."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..records.case import PensionModel
from ..records.inputs import use
from .assets.appraisal import shown_now
from .assets.returns import asset_schedule, returns
from .curve import log_bond
from .factors import MarketFactors, factors, moments, nominal, real, shape, shift, slope
from .shocks import Slots, covariance, factor, slots
from .spreads import next_spread, spread_now, spread_terms
from .state import LONG, Market, MarketSteps, MarketTerms, Move, at_start


class PriceGrowth(NamedTuple):
    """Growth of ln I and ln W: `price` [T] the shift, `index_volatility` [T], and for wages on top
    `wage` (per step) and `wage_volatility`."""

    price: Array
    index_volatility: Array
    wage: Array
    wage_volatility: Array


def growth(
    case: PensionModel, inputs: dict[str, Any], factors: MarketFactors, shift: Array
) -> PriceGrowth:
    """`shift` [T] is that of nominal less that of real bonds: the break-even index, fitted.

    ln I' - ln I = shift + int p + s_I (dW_I + lambda_I d), where int p has its own price of risk.
    """
    inflation = case.inflation
    volatility = use(inputs, inflation.index_volatility)
    risk = use(inputs, inflation.index_price_of_risk) * (0.0 if case.risk_neutral else case.step)
    drift = factors.volatility[:, -1] * factors.price_of_risk[-1] * factors.reached[-1]
    return PriceGrowth(
        price=shift + drift + volatility * risk,
        index_volatility=volatility,
        wage=use(inputs, inflation.real_wage_growth) * case.step,
        wage_volatility=use(inputs, inflation.wage_volatility),
    )


class Grown(NamedTuple):
    """The indices after a step, in logs."""

    price: Array
    wage: Array


def grow(price: Array, wage: Array, expected: Array, now, terms, position: Slots, shock) -> Grown:
    """The next ln I and ln W; `expected` is the integral of the factor over the step, `shock` the
    Gaussian vector."""
    move = now.price_shift + expected + now.index_volatility * shock[position.index]
    extra = terms.wage_growth + terms.wage_volatility * shock[position.wage]
    return Grown(price + move, wage + move + extra)


def generated_schedule(
    case: PensionModel, inputs: dict[str, Any], nodes: np.ndarray
) -> tuple[MarketTerms, MarketSteps, Array]:
    """Terms, steps and the nodes' `shape` [T+1, J]; see `dynamics.market_schedule`."""
    together, both = covariance(case, inputs), factors(case, inputs)
    kinds = nominal(case), real(case, inputs)
    results = [moments(case, both, bond, together) for bond in kinds]
    steps, d = case.steps, case.step
    times = np.arange(steps + 1) * d
    price = log_bond(case.curve, inputs, times)
    real_price = price - log_bond(case.inflation.break_even, inputs, times)
    nominal_shift, real_shift = shift(price, results[0]), shift(real_price, results[1])
    indices = growth(case, inputs, both, nominal_shift - real_shift)
    rates = slice(0, case.rates.count())
    risk = both.volatility * both.price_of_risk
    terms, asset_steps = asset_schedule(case, inputs, both, together, results[0])
    node_slope, node_shape = _nodes(case, both, kinds, results, nodes * d)
    long_slope = slope(both, kinds[0], np.array([LONG]))
    onward = log_bond(case.curve, inputs, times[:-1] + LONG) - price[:-1]
    long = -(onward + shape(long_slope, results[0])[:-1, 0]) / LONG
    market = MarketTerms(
        start=at_start(jnp.zeros(len(both.decay)), spread_now(case, inputs), shown_now(case)),
        slope=node_slope,
        rate_slope=jnp.stack([long_slope[0] / LONG, jnp.asarray(kinds[0].loads)]),
        shock=factor(together),
        decay=both.decay,
        reach=both.reach,
        wage_growth=indices.wage,
        wage_volatility=indices.wage_volatility,
        mortality_volatility=_mortality_volatility(case, inputs),
        spreads=spread_terms(case, inputs),
        assets=terms,
    )
    item = MarketSteps(
        rate_level=jnp.stack([long, nominal_shift / d], axis=1),
        cash_shift=nominal_shift + risk[:, rates] @ both.reached[rates],
        price_shift=indices.price,
        index_volatility=indices.index_volatility,
        volatility=both.volatility,
        drift=risk * both.reach,
        assets=asset_steps,
    )
    return market, item, node_shape


def _nodes(case: PensionModel, both, kinds, result, years: np.ndarray):
    """`slope` [J, g] and `shape` [T+1, J] of the basis on which liabilities are valued."""
    which = 1 if case.liability.future_indexation == "full" else 0
    if case.liability.basis == "fixed":
        return jnp.zeros((len(years), len(both.decay))), jnp.zeros((case.steps + 1, len(years)))
    slopes = slope(both, kinds[which], years)
    return slopes, shape(slopes, result[which])


def _mortality_volatility(case: PensionModel, inputs: dict[str, Any]) -> Array:
    lee_carter = case.lee_carter
    return jnp.zeros(()) if lee_carter is None else use(inputs, lee_carter.volatility)


def generated_move(
    case: PensionModel, terms: MarketTerms, now: MarketSteps, market: Market, noise: Array
) -> Move:
    """The market over one step; `noise` [Z] independent normals."""
    position = slots(case)
    shock = terms.shock @ noise
    count = case.rates.count()
    # The factors' integrals over the step.
    complete = terms.reach * market.factors + now.volatility * shock[position.iota]
    cash = now.cash_shift + jnp.sum(complete[:count])
    grown = grow(market.log_price, market.log_wage, complete[count], now, terms, position, shock)
    moved = returns(case, terms.assets, now, market, shock, cash)
    mortality = market.mortality
    if case.lee_carter is not None:
        mortality = mortality + terms.mortality_volatility * shock[position.mortality]
    after = Market(
        factors=terms.decay * market.factors + now.volatility * shock[position.zeta] + now.drift,
        log_price=grown.price,
        log_wage=grown.wage,
        mortality=mortality,
        spread=next_spread(terms.spreads, market.spread, shock[position.spread]),
        reported=moved.reported,
        log_discount=market.log_discount - cash,
    )
    return Move(cash, jnp.exp(moved.log), moved.swaps, after, moved.beneath)
