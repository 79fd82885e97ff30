"""One step of the market: the generator's, or what a file of ready-made scenarios says."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .assets import asset_schedule, bonds, returns
from .curve import log_bond
from .inflation import grow, growth
from .inputs import use
from .records import PensionCase, SuppliedScenarios
from .shocks import covariance, factor, slots
from .short_rate import factors, moments, nominal, real, shape, shift, slope


class Market(NamedTuple):
    """State of the market: `factors` [g] of rates and expected inflation (under ready-made
    scenarios the zero rates of the file), ln of price index and wages, Lee-Carter's k, spreads
    ln(s / mean) [R] or None, appraised returns [q] or None, ln of what cash discounts by."""

    factors: Array
    log_price: Array
    log_wage: Array
    mortality: Array
    spread: Array | None
    shown: Array | None
    log_discount: Array


class MarketTerms(NamedTuple):
    """What holds throughout: `start` the market at time 0; ln P(t, t+u) = shape - `slope` @ factors
    [J, g] at the payment nodes; `rate_slope` [2, g] of long and short rate. Under ready-made
    scenarios `swap_slope` [2, b, k] before and after a step; else the generator's numbers, with
    `shock` [Z, Z], `decay`, `reach` [g] and wages (see `inflation.Growth`)."""

    start: Market
    slope: Array
    rate_slope: Array
    swap_slope: Any = None
    shock: Any = None
    decay: Any = None
    reach: Any = None
    wage_growth: Any = None
    wage_volatility: Any = None
    mortality_volatility: Any = None
    assets: Any = None


class MarketSteps(NamedTuple):
    """Per step t: `rate_level` [T, 2] long and short rate at factors of zero; the generator's
    shifts of cash and prices, volatilities and drifts of the factors [T, g]."""

    rate_level: Array
    cash_shift: Any = None
    price_shift: Any = None
    index_volatility: Any = None
    volatility: Any = None
    drift: Any = None
    assets: Any = None


class Move(NamedTuple):
    """Over one step: log return of cash, gross returns [n], swaps' log returns over cash [b] or
    None, and the market after it."""

    cash: Array
    gross: Array
    swaps: Any
    market: Market


LONG = 10.0  # years of the long rate that a policy may see


def noise_size(case: PensionCase) -> int:
    """Numbers that a step needs: normals, or the columns of a scenario file."""
    return slots(case).size if case.scenarios is None else len(case.scenarios.columns)


def market_schedule(
    case: PensionCase, inputs: dict[str, Any], nodes: np.ndarray
) -> tuple[MarketTerms, MarketSteps, Array]:
    """Terms, steps and the nodes' `shape` [T+1, J]; `nodes` [J] whole steps to a payment."""
    if case.scenarios is not None:
        return _supplied(case, case.scenarios, inputs, nodes)
    return _generated(case, inputs, nodes)


def _generated(case: PensionCase, inputs: dict[str, Any], nodes: np.ndarray):
    together, both = covariance(case, inputs), factors(case, inputs)
    kinds = nominal(case), real(case, inputs)
    found = [moments(case, both, bond, together) for bond in kinds]
    steps, d = case.steps, case.step
    times = np.arange(steps + 1) * d
    price = log_bond(case.curve, inputs, times)
    real_price = price - log_bond(case.inflation.break_even, inputs, times)
    nominal_shift, real_shift = shift(price, found[0]), shift(real_price, found[1])
    indices = growth(case, inputs, both, nominal_shift - real_shift)
    rates = slice(0, len(case.rates.mean_reversion.index))
    risk = both.volatility * both.price_of_risk
    terms, asset_steps = asset_schedule(case, inputs, both, together)
    node_slope, node_shape = _nodes(case, both, kinds, found, nodes * d)
    long_slope = slope(both, kinds[0], np.array([LONG]))
    onward = log_bond(case.curve, inputs, times[:-1] + LONG) - price[:-1]
    long = -(onward + shape(long_slope, found[0])[:-1, 0]) / LONG
    market = MarketTerms(
        start=_start(case, inputs, jnp.zeros(len(both.decay))),
        slope=node_slope,
        rate_slope=jnp.stack([long_slope[0] / LONG, jnp.asarray(kinds[0].loads)]),
        shock=factor(together),
        decay=both.decay,
        reach=both.reach,
        wage_growth=indices.wage,
        wage_volatility=indices.wage_volatility,
        mortality_volatility=_mortality_volatility(case, inputs),
        assets=terms,
    )
    each = MarketSteps(
        rate_level=jnp.stack([long, nominal_shift / d], axis=1),
        cash_shift=nominal_shift + risk[:, rates] @ both.reached[rates],
        price_shift=indices.price,
        index_volatility=indices.index_volatility,
        volatility=both.volatility,
        drift=risk * both.reach,
        assets=asset_steps,
    )
    return market, each, node_shape


def _nodes(case: PensionCase, both, kinds, found, years: np.ndarray):
    """`slope` [J, g] and `shape` [T+1, J] of the basis on which liabilities are valued."""
    which = 1 if case.liability.future_indexation == "full" else 0
    if case.liability.basis == "fixed":
        return jnp.zeros((len(years), len(both.decay))), jnp.zeros((case.steps + 1, len(years)))
    slopes = slope(both, kinds[which], years)
    return slopes, shape(slopes, found[which])


def _start(case: PensionCase, inputs: dict[str, Any], at: Array) -> Market:
    """The market at time 0 with factors `at`."""
    zero, credit = jnp.zeros(()), case.credit
    known = credit.names and case.scenarios is None
    ratio = use(inputs, credit.spread) / use(inputs, credit.mean_spread) if known else None
    appraised = len(case.assets.smoothed) and case.scenarios is None
    return Market(
        factors=at,
        log_price=zero,
        log_wage=zero,
        mortality=zero,
        spread=None if ratio is None else jnp.log(ratio),
        shown=jnp.zeros(len(case.assets.smoothed)) if appraised else None,
        log_discount=zero,
    )


def _mortality_volatility(case: PensionCase, inputs: dict[str, Any]) -> Array:
    lee_carter = case.lee_carter
    return jnp.zeros(()) if lee_carter is None else use(inputs, lee_carter.volatility)


def _supplied(case: PensionCase, scenarios: SuppliedScenarios, inputs, nodes: np.ndarray):
    """Zero rates of the file take the factors' place: ln P(t, t+u) = -u z(u), linear in them."""

    def slopes(years: np.ndarray) -> np.ndarray:
        linear = [np.interp(years, scenarios.tenor, row) for row in np.eye(len(scenarios.tenor))]
        return years[:, None] * np.stack(linear, axis=1)

    start = -log_bond(case.curve, inputs, scenarios.tenor) / scenarios.tenor
    maturity = bonds(case).maturity[-case.buckets :] if case.buckets else np.zeros(0)
    fixed = case.liability.basis == "fixed"
    short = np.array([case.step])
    terms = MarketTerms(
        start=_start(case, inputs, start),
        slope=jnp.asarray(slopes(nodes * case.step) * (not fixed)),
        rate_slope=jnp.asarray(
            np.concatenate([slopes(np.array([LONG])) / LONG, slopes(short) / short])
        ),
        swap_slope=jnp.asarray(
            np.stack([slopes(maturity * case.step), slopes((maturity - 1) * case.step)])
        )
        if case.buckets
        else None,
    )
    steps = MarketSteps(rate_level=jnp.zeros((case.steps, 2)))
    return terms, steps, jnp.zeros((case.steps + 1, len(nodes)))


def move(
    case: PensionCase, terms: MarketTerms, now: MarketSteps, market: Market, noise: Array
) -> Move:
    """The market over one step."""
    if case.scenarios is not None:
        return _read(case, terms, market, noise)
    place = slots(case)
    shock = terms.shock @ noise
    count = len(case.rates.mean_reversion.index)
    # What the factors' integrals over the step are.
    whole = terms.reach * market.factors + now.volatility * shock[place.iota]
    cash = now.cash_shift + jnp.sum(whole[:count])
    grown = grow(market.log_price, market.log_wage, whole[count], now, terms, place, shock)
    moved = returns(case, terms.assets, now.assets, now.volatility[:count], market, shock, cash)
    mortality = market.mortality
    if case.lee_carter is not None:
        mortality = mortality + terms.mortality_volatility * shock[place.mortality]
    after = Market(
        factors=terms.decay * market.factors + now.volatility * shock[place.zeta] + now.drift,
        log_price=grown.price,
        log_wage=grown.wage,
        mortality=mortality,
        spread=moved.spread,
        shown=moved.shown,
        log_discount=market.log_discount - cash,
    )
    return Move(cash, jnp.exp(moved.log), moved.swaps, after)


def _read(case: PensionCase, terms: MarketTerms, market: Market, noise: Array) -> Move:
    """A step of a scenario file: returns, inflation, wage growth, zero rates at its end."""
    count = len(case.assets.classes)
    gross, zeros = 1 + noise[:count], noise[count + 2 :]
    cash = jnp.log(gross[case.assets.cash])
    swaps = None
    if terms.swap_slope is not None:
        swaps = terms.swap_slope[0] @ market.factors - terms.swap_slope[1] @ zeros - cash
    after = market._replace(
        factors=zeros,
        log_price=market.log_price + noise[count],
        log_wage=market.log_wage + noise[count + 1],
        log_discount=market.log_discount - cash,
    )
    return Move(cash, gross, swaps, after)


def log_factor(terms: MarketTerms, shape: Float[Array, " J"], market: Market) -> Array:
    """[J] ln of what a payment's forward value is multiplied by, at the market's factors."""
    return shape - terms.slope @ market.factors
