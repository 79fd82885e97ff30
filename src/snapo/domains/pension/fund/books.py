"""The fund's books on one path: its state, and its liability at the market of that state."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from ..market.state import Market, log_factor
from ..people.lpi import limited
from ..people.lpi import log_factor as lpi_factor
from ..records.case import PensionModel
from .schedule import FundTerms

MINIMUM = 1e-6  # of the assets now: the liability counts as at least this much in ratios


class FundState(NamedTuple):
    """The fund at the start of a step.

    `assets`: money; `weights` [n]: the weights before trading; `overlay` [b]: notionals divided by
    assets, or None; `theta`: cumulated indexation; `fresh`: the ratio a of rights accrued since
    time 0 to their baseline; `deaths`: y, the logarithm of the rights lost by mortality beyond the
    baseline; `log_price_last`: the logarithm of prices at the last indexation; `ratio_sum`: the
    weighted sum so far of the funding ratios that make up the policy ratio; `jump`: the logarithm
    of the last indexation beyond the part that was valued already.
    """

    market: Market
    assets: Array
    weights: Array
    overlay: Array | None
    theta: Array
    fresh: Array
    deaths: Array
    log_price_last: Array
    ratio_sum: Array
    jump: Array


class FundBalance(NamedTuple):
    """Values of the `liability`, of its payments `by_node` [J] and of the step's `accrual`, in
    money; `ratio`: the funding ratio F."""

    liability: Array
    by_node: Array
    accrual: Array
    ratio: Array


def opening(terms: FundTerms) -> FundState:
    """The state before the first decision."""
    zero, one = jnp.zeros_like(terms.assets), jnp.ones_like(terms.assets)
    return FundState(
        market=terms.market.start,
        assets=terms.assets,
        weights=terms.weight,
        overlay=None if terms.swaps is None else terms.swaps.notional / terms.assets,
        theta=one,
        fresh=one,
        deaths=zero,
        log_price_last=zero,
        ratio_sum=zero,
        jump=zero,
    )


def balance(
    case: PensionModel, terms: FundTerms, people, shape: Array, state: FundState
) -> FundBalance:
    """The values on the case's basis, in the market of `state`."""
    market = state.market
    factor = log_factor(terms.market, shape, market)
    if case.lee_carter is not None:
        factor = factor - people.outlook * market.mortality
    scale = jnp.log(state.theta) - state.deaths
    if case.liability.future_indexation == "full":
        # Increases are due that prices have called for and no indexation has granted yet.
        scale = scale + market.log_price - state.log_price_last
    if limited(case):
        growth = market.log_price - state.log_price_last
        factor = factor + lpi_factor(people.lpi, terms.plan, growth, market.factors[-1])
    factor, scale = jnp.exp(factor), jnp.exp(scale)
    by_node = scale * (people.accrued + state.fresh * people.fresh) * factor
    liability = jnp.sum(by_node)
    wage = jnp.exp(market.log_wage) / state.theta
    accrual = scale * wage * jnp.sum(people.accrual * factor)
    return FundBalance(liability, by_node, accrual, _ratio(terms, state, liability))


def _ratio(terms: FundTerms, state: FundState, liability: Array) -> Array:
    """Assets divided by the liability; a fund without liabilities has a large ratio."""
    minimum = MINIMUM * terms.assets
    return state.assets / jnp.where(liability > minimum, liability, minimum)
