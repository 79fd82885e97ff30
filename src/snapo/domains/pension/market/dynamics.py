"""One step of the market, by the models or from a file of ready-made scenarios.

In the models, rates, inflation, spreads and currencies are Gaussian. The returns of all asset
classes and swaps follow from them exactly, and are martingales under "Q". A share a of an appraised
return is shown at once and the rest later: shown' = a r + (1 - a) shown.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ..records.case import PensionModel
from ..records.inputs import use
from ..records.market import SuppliedScenarios
from .assets.asset_class import AssetMixture, Now, Scene, by_kind, in_order
from .assets.swaps import fixed_legs, swap_mixture, swap_returns, swap_schedule
from .bonds.strips import gain
from .curve import log_bond
from .factors import MarketFactors, Moments, factors, moments, nominal, real, shape, shift, slope
from .shocks import Slots, covariance, factor, slots
from .spreads import currency_terms, next_spread, spread_now, spread_terms
from .state import LONG, Market, MarketSteps, MarketTerms, Move, at_start


def shown_now(case: PensionModel) -> Array | None:
    """The last returns that appraisals have shown [q]; None in a case without appraised classes."""
    count = len(case.assets.smoothed)
    return xp.zeros(count) if count else None


def appraised(
    case: PensionModel, smoothing: Array, log: Float[Array, " n"], displayed: Array | None
) -> tuple[Float[Array, " n"], Array | None]:
    """Log returns as shown, and the next `displayed`; `smoothing` [q] is a."""
    if displayed is None:
        return log, None
    # A copy: JAX remembers an array of the case in the type it met first, and training is in
    # 32 bits, evaluation in 64.
    smoothed = np.array(case.assets.smoothed)
    displayed = smoothing * log[smoothed] + (1 - smoothing) * displayed
    order = np.arange(len(case.assets.classes))
    order[smoothed] = len(order) + np.arange(len(smoothed))
    return xp.concatenate([log, displayed])[order], displayed


class AssetTerms(NamedTuple):
    """`kinds`: one entry per kind (see `AssetClass.prepare`); `swaps`: their terms, or None;
    `exposure` [X]: the volatility of the unhedged share of a currency; `smoothing` [q]: the shares
    a."""

    kinds: tuple[Any, ...]
    swaps: Any
    exposure: Array
    smoothing: Array


class AssetSteps(NamedTuple):
    """The terms of assets that differ by step."""

    kinds: tuple[Any, ...]
    swaps: Any


class Returns(NamedTuple):
    """Returns of one step: `log` [n]: log returns as shown; `swaps` [b]: log returns of swaps over
    cash; `reported` [q]: the appraised returns that enter the next step; `beneath`: the bonds of
    each kind and of the swaps, None if log returns are Gaussian themselves."""

    log: Array
    swaps: Array | None
    reported: Array | None
    beneath: tuple[AssetMixture | None, ...]


def asset_schedule(
    case: PensionModel,
    inputs: dict[str, Any],
    factors: MarketFactors,
    covariance: Float[Array, "Z Z"],
    moments: Moments,
) -> tuple[AssetTerms, AssetSteps]:
    """The numbers of all classes that paths share; `moments` of nominal bonds."""
    currencies = currency_terms(case, inputs)
    scene = Scene(case, inputs, factors, covariance, currencies, moments)
    kinds = [kind.prepare(scene, positions) for kind, positions in by_kind(case)]
    swaps = (None, None) if case.overlay is None else swap_schedule(scene)
    smoothing = use(inputs, case.assets.smoothing)
    terms = AssetTerms(tuple(t for t, _ in kinds), swaps[0], currencies.exposure, smoothing)
    return terms, AssetSteps(tuple(s for _, s in kinds), swaps[1])


def returns(case: PensionModel, terms: AssetTerms, now, market, shock, cash) -> Returns:
    """Log returns of all classes; `now` the step's `MarketSteps`, `market` the state before it,
    `shock` [Z] the Gaussian vector, `cash` the log return of cash."""
    foreign = terms.exposure * shock[slots(case).currency] if case.currencies.names else None
    observed = Now(
        shock, now.volatility, now.index_volatility, cash, market.factors, market.spread, foreign
    )
    held = list(zip(by_kind(case), terms.kinds, now.assets.kinds))
    parts = [kind.log_return(case, at, term, step, observed) for (kind, at), term, step in held]
    beneath = [kind.mixture(case, at, term, step, observed) for (kind, at), term, step in held]
    log, displayed = appraised(case, terms.smoothing, in_order(case, parts), market.reported)
    swaps = None
    if case.buckets:
        beneath.append(swap_mixture(case, terms.swaps, now.assets.swaps, observed))
        swaps = swap_returns(case, terms.swaps, now.assets.swaps, observed)
    return Returns(log, swaps, displayed, tuple(beneath))


class IndexGrowth(NamedTuple):
    """Growth of ln I and ln W: for prices the shift `price` [T] and the `index_volatility` [T]; for
    wages beyond prices the growth `wage` per step and the `wage_volatility`."""

    price: Array
    index_volatility: Array
    wage: Array
    wage_volatility: Array


def growth(
    case: PensionModel, inputs: dict[str, Any], factors: MarketFactors, shift: Array
) -> IndexGrowth:
    """The growth of prices and wages. `shift` [T] is the shift of nominal bonds minus that of real
    bonds; it fits the index to the break-evens.

    ln I' - ln I = shift + int p + s_I (dW_I + lambda_I d), where int p has its own price of risk.
    """
    inflation = case.inflation
    volatility = use(inputs, inflation.index_volatility)
    risk = use(inputs, inflation.index_price_of_risk) * (0.0 if case.risk_neutral else case.step)
    drift = factors.volatility[:, -1] * factors.price_of_risk[-1] * factors.reached[-1]
    return IndexGrowth(
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
    """Terms, steps and the nodes' `shape` [T+1, J]; see `market_schedule`."""
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
        start=at_start(xp.zeros(len(both.decay)), spread_now(case, inputs), shown_now(case)),
        slope=node_slope,
        rate_slope=xp.stack([long_slope[0] / LONG, xp.asarray(kinds[0].loads)]),
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
        rate_level=xp.stack([long, nominal_shift / d], axis=1),
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
        return xp.zeros((len(years), len(both.decay))), xp.zeros((case.steps + 1, len(years)))
    slopes = slope(both, kinds[which], years)
    return slopes, shape(slopes, result[which])


def _mortality_volatility(case: PensionModel, inputs: dict[str, Any]) -> Array:
    lee_carter = case.lee_carter
    return xp.zeros(()) if lee_carter is None else use(inputs, lee_carter.volatility)


def generated_move(
    case: PensionModel, terms: MarketTerms, now: MarketSteps, market: Market, noise: Array
) -> Move:
    """The market over one step; `noise` [Z] independent normals."""
    position = slots(case)
    shock = terms.shock @ noise
    count = case.rates.count()
    # The factors' integrals over the step.
    complete = terms.reach * market.factors + now.volatility * shock[position.iota]
    cash = now.cash_shift + xp.sum(complete[:count])
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
    return Move(cash, xp.exp(moved.log), moved.swaps, after, moved.beneath)


def supplied_schedule(
    case: PensionModel, scenarios: SuppliedScenarios, inputs: dict[str, Any], nodes: np.ndarray
) -> tuple[MarketTerms, MarketSteps, Array]:
    """The zero rates of the file take the place of the factors: ln P(t, t+u) = -u z(u) is linear in
    them."""

    def slopes(years: np.ndarray) -> np.ndarray:
        linear = [np.interp(years, scenarios.tenor, row) for row in np.eye(len(scenarios.tenor))]
        return years[:, None] * np.stack(linear, axis=1)

    start = -log_bond(case.curve, inputs, scenarios.tenor) / scenarios.tenor
    fixed = case.liability.basis == "fixed"
    short = np.array([case.step])
    terms = MarketTerms(
        start=at_start(start),
        slope=xp.asarray(slopes(nodes * case.step) * (not fixed)),
        rate_slope=xp.asarray(
            np.concatenate([slopes(np.array([LONG])) / LONG, slopes(short) / short])
        ),
        swap_slope=None if case.overlay is None else _swap_slope(case, slopes),
    )
    steps = MarketSteps(rate_level=xp.zeros((case.steps, 2)))
    return terms, steps, xp.zeros((case.steps + 1, len(nodes)))


def _swap_slope(case: PensionModel, slopes: Callable) -> Array:
    """[2, J, k] slopes of the swaps' payments before and after a step."""
    due = fixed_legs(case).steps
    both = [slopes(steps * case.step) for steps in (due, due - 1)]
    return xp.asarray(np.stack(both))


def supplied_move(case: PensionModel, terms: MarketTerms, market: Market, noise: Array) -> Move:
    """A step of a scenario file: returns, inflation, wage growth, zero rates at its end."""
    count = len(case.assets.classes)
    gross, zeros = 1 + noise[:count], noise[count + 2 :]
    cash = xp.log(gross[case.assets.cash])
    swaps = None
    if terms.swap_slope is not None:
        before, later = terms.swap_slope[0] @ market.factors, terms.swap_slope[1] @ zeros
        growth = xp.expm1(before - later - cash)
        swaps = xp.log1p(gain(fixed_legs(case), xp.exp(-before), growth))
    after = market._replace(
        factors=zeros,
        log_price=market.log_price + noise[count],
        log_wage=market.log_wage + noise[count + 1],
        log_discount=market.log_discount - cash,
    )
    return Move(cash, gross, swaps, after)


def noise_size(case: PensionModel) -> int:
    """How many random numbers a step needs: normals, or the columns of a scenario file."""
    return slots(case).size if case.scenarios is None else len(case.scenarios.columns)


def market_schedule(
    case: PensionModel, inputs: dict[str, Any], nodes: np.ndarray
) -> tuple[MarketTerms, MarketSteps, Array]:
    """Terms, steps and the nodes' `shape` [T+1, J]; `nodes` [J] whole steps to a payment."""
    if case.scenarios is not None:
        return supplied_schedule(case, case.scenarios, inputs, nodes)
    return generated_schedule(case, inputs, nodes)


def move(
    case: PensionModel, terms: MarketTerms, now: MarketSteps, market: Market, noise: Array
) -> Move:
    """The market over one step."""
    if case.scenarios is not None:
        return supplied_move(case, terms, market, noise)
    return generated_move(case, terms, now, market, noise)
