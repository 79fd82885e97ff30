"""Returns of the asset classes and swaps over a step: exact, and martingales under "Q".

The log return over cash of a class is a drift plus a linear function of the step's Gaussian vector
(see `shocks`), and for credit also of its spread. Under "Q" the drift is minus half the variance,
so that every class earns cash on average. Under "P" it is the mean that the case gives; bonds earn
minus lambda_i s_i times their duration in the factor, currencies their premium, credit its spread
less defaults and less what a spread that reverts to its mean gives back.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .inputs import use
from .records import Assets, PensionCase
from .shocks import slots
from .short_rate import Factors


class AssetTerms(NamedTuple):
    """X currencies, k bonds, credits and swaps (in this order of classes), c of them credits.

    `exposure` [X]: volatility of what is left unhedged; `bond_reach` [k, F]: B((m - 1) d).
    Of credits [c]: `duration` in years, `mean_spread`, `spread_volatility`, `spread_variance` of
    zeta, `carry` per unit of spread and step, `reverting` the share of ln(s / mean) lost in a step,
    `fading` [R] what is left of it. `smoothing` [q].
    """

    exposure: Array
    bond_reach: Array
    duration: Array
    mean_spread: Array
    spread_volatility: Array
    spread_variance: Array
    carry: Array
    reverting: Array
    fading: Array
    rating_volatility: Array
    smoothing: Array


class AssetSteps(NamedTuple):
    """Per step: of the m classes with a shock of their own `drift`, `volatility` [T, m]; of bonds
    `bond_drift` [T, k]; `cross` [T, c] covariance of the bond's return with the spread's zeta."""

    drift: Array
    volatility: Array
    bond_drift: Array
    cross: Array


class Bonds(NamedTuple):
    """Static places: `classes` [k - b] positions of bonds and credits, `maturity`, `currency` [k],
    `credit` [c] which of the k are credits, `rating` [c]."""

    classes: np.ndarray
    maturity: np.ndarray
    currency: np.ndarray
    credit: np.ndarray
    rating: np.ndarray


def bonds(case: PensionCase) -> Bonds:
    """The bonds of a case: classes of kind bond and credit, then the swap buckets."""
    found = [(i, c) for i, c in enumerate(case.assets.classes) if c.maturity]
    swaps = [] if case.overlay is None else list(case.overlay.maturity)
    credit = [k for k, (_, each) in enumerate(found) if each.rating >= 0]
    return Bonds(
        classes=np.array([i for i, _ in found], int),
        maturity=np.array([c.maturity for _, c in found] + swaps, int),
        currency=np.array([c.currency for _, c in found] + [-1] * len(swaps), int),
        credit=np.array(credit, int),
        rating=np.array([found[k][1].rating for k in credit], int),
    )


def own_currency(case: PensionCase) -> np.ndarray:
    """[m] currencies of the classes with a shock of their own, -1 for the fund's."""
    return np.array([case.assets.classes[i].currency for i in case.assets.shocks], int)


def of_currency(values: Array, currency: np.ndarray) -> Array:
    """`values` [X] where a currency is held, zero where none is (-1)."""
    return jnp.append(values, jnp.zeros(1, values.dtype))[currency]


def asset_schedule(
    case: PensionCase, inputs: dict[str, Any], factors: Factors, covariance: Float[Array, "Z Z"]
) -> tuple[AssetTerms, AssetSteps]:
    """What all paths share."""
    held, credit = bonds(case), case.credit
    hedge = use(inputs, case.currencies.hedge_ratio)
    exposure = (1 - hedge) * use(inputs, case.currencies.volatility)
    count = len(case.rates.mean_reversion.index)
    shorter = (held.maturity - 1)[:, None] * case.step
    a = factors.mean_reversion[:count]
    reach = -jnp.expm1(-a * shorter) / a
    # What a currency adds on average, per step and unit of holding.
    added = -hedge * use(inputs, case.currencies.hedge_cost) * case.step
    premium = (1 - hedge) * use(inputs, case.currencies.premium) * case.step
    real_world = 0.0 if case.risk_neutral else 1.0
    fading = jnp.exp(-use(inputs, credit.mean_reversion) * case.step)
    mean = use(inputs, credit.mean_spread)
    lost = use(inputs, credit.default_loss) / mean
    place, rating = slots(case), held.rating
    own_variance = jnp.diag(covariance)[place.spread]
    terms = AssetTerms(
        exposure=exposure,
        bond_reach=reach,
        duration=jnp.asarray(held.maturity[held.credit] * case.step),
        mean_spread=mean[rating],
        spread_volatility=use(inputs, credit.volatility)[rating],
        spread_variance=own_variance[rating],
        carry=real_world * (1 - lost)[rating] * case.step,
        reverting=real_world * (1 - fading)[rating],
        fading=fading,
        rating_volatility=use(inputs, credit.volatility),
        smoothing=use(inputs, case.assets.smoothing),
    )
    volatility = use(inputs, case.assets.volatility)
    own = own_currency(case)
    drift = _own_drift(case, inputs, _own_variance(case, volatility, exposure, covariance))
    if case.assets.return_kind == "excess":
        drift = drift + real_world * of_currency(premium, own)
    bond_drift, cross = _bonds(case, factors, held, reach, exposure, covariance)
    bond_drift = bond_drift + of_currency(added + real_world * premium, held.currency)
    return terms, AssetSteps(drift + of_currency(added, own), volatility, bond_drift, cross)


def _own_variance(case, volatility, exposure, covariance) -> Float[Array, "T m"]:
    """Variance of a step's return, currency included."""
    place, currency = slots(case), own_currency(case)
    own = np.arange(place.size)[place.asset]
    foreign = np.where(currency >= 0, place.currency.start + currency, 0)
    e = of_currency(exposure, currency)
    both = 2 * volatility * e * covariance[own, foreign]
    return volatility**2 * covariance[own, own] + both + e**2 * covariance[foreign, foreign]


def _own_drift(case: PensionCase, inputs: dict[str, Any], variance: Array) -> Array:
    """Mean of a step's log return of the classes with a shock of their own, before currencies."""
    assets = case.assets
    if case.risk_neutral:
        return -variance / 2
    mean = use(inputs, assets.mean)
    if assets.mean_kind == "log":
        return mean * case.step + 0 * variance
    drift = jnp.log1p(mean) * case.step
    return drift - variance / 2 if assets.mean_kind == "arithmetic" else drift + 0 * variance


def _bonds(case: PensionCase, factors: Factors, held: Bonds, reach, exposure, covariance):
    """Drift [T, k] of bonds over cash before currencies, and `AssetSteps.cross`."""
    place, count = slots(case), reach.shape[1]
    volatility = factors.volatility[:, :count]
    steps, k = case.steps, len(held.maturity)
    foreign = np.where(held.currency >= 0, place.currency.start + held.currency, 0)
    parts = [
        np.broadcast_to(place.zeta[:count], (k, count)),
        np.broadcast_to(place.iota[:count], (k, count)),
        foreign[:, None],
    ]
    which = np.concatenate(parts, axis=1)
    e = jnp.broadcast_to(of_currency(exposure, held.currency)[:, None], (steps, k, 1))
    on_iota = jnp.broadcast_to(-volatility[:, None], (steps, k, count))
    load = jnp.concatenate([on_iota * reach, on_iota, e], axis=2)
    variance = jnp.einsum(
        "tki,kij,tkj->tk", load, covariance[which[:, :, None], which[:, None]], load
    )
    exposed = reach * factors.reach[:count] + factors.reached[:count]
    premium = (volatility * factors.price_of_risk[:count]) @ exposed.T
    spreads = covariance[which[held.credit], place.spread.start + held.rating[:, None]]
    cross = jnp.sum(load[:, held.credit] * spreads, axis=2)
    return -variance / 2 - premium, cross


class Returns(NamedTuple):
    """Over one step: `log` [n] log returns as shown, `swaps` [b] log returns over cash, `spread`
    [R] and `shown` [q] of the next step."""

    log: Array
    swaps: Array | None
    spread: Array | None
    shown: Array | None


def returns(case: PensionCase, terms: AssetTerms, now, volatility, market, shock, cash) -> Returns:
    """Log returns of all classes; `volatility` [F] of the rate factors, `cash` the log return of
    cash, `now` the step's `AssetSteps`."""
    place, held, count = slots(case), bonds(case), len(volatility)
    foreign = terms.exposure * shock[place.currency] if case.currencies.names else None
    parts, swaps, spread = [jnp.zeros_like(cash)[None]], None, market.spread
    if len(case.assets.shocks):
        own = now.drift + now.volatility * shock[place.asset]
        parts.append(_with_currency(own, foreign, own_currency(case)))
    if len(held.maturity):
        fall = terms.bond_reach @ (volatility * shock[place.zeta[:count]])
        fall = fall + jnp.sum(volatility * shock[place.iota[:count]])
        bond = _with_currency(now.bond_drift - fall, foreign, held.currency)
        if len(held.credit):
            extra = _credit(terms, now, held, spread, shock[place.spread])
            places = np.full(len(held.maturity), len(held.credit))
            places[held.credit] = np.arange(len(held.credit))
            bond = bond + jnp.append(extra, jnp.zeros_like(cash))[places]
        classes = len(held.classes)
        parts += [bond[:classes]] if classes else []
        swaps = bond[classes:] if case.buckets else None
    if spread is not None:
        spread = terms.fading * spread + terms.rating_volatility * shock[place.spread]
    log = jnp.concatenate(parts)[_order(case.assets, held)] + cash * _over_cash(case)
    if market.shown is None:
        return Returns(log, swaps, spread, None)
    smoothed = case.assets.smoothed
    shown = terms.smoothing * log[smoothed] + (1 - terms.smoothing) * market.shown
    order = np.arange(len(case.assets.classes))
    order[smoothed] = len(order) + np.arange(len(smoothed))
    return Returns(jnp.concatenate([log, shown])[order], swaps, spread, shown)


def _with_currency(log: Array, foreign: Array | None, currency: np.ndarray) -> Array:
    """Log returns with the currency's on top, where one is held."""
    return log if foreign is None else log + of_currency(foreign, currency)


def _credit(terms: AssetTerms, now, held: Bonds, spread: Array, zeta: Array) -> Array:
    """What the spread adds to the log return of the c credits."""
    u = spread[held.rating]
    level = terms.mean_spread * jnp.exp(u)
    move = -terms.duration * level
    shocked = move * terms.spread_volatility
    noise = zeta[held.rating] - now.cross - shocked * terms.spread_variance / 2
    return shocked * noise + level * terms.carry - move * terms.reverting * u


def _order(assets: Assets, held: Bonds) -> np.ndarray:
    """[n] where each class stands in cash, classes with a shock of their own, bonds."""
    order = np.zeros(len(assets.classes), int)
    order[assets.shocks] = 1 + np.arange(len(assets.shocks))
    order[held.classes] = 1 + len(assets.shocks) + np.arange(len(held.classes))
    return order


def _over_cash(case: PensionCase) -> np.ndarray:
    """[n] 1 where a class earns cash and something on top, 0 where its return is total."""
    found = np.ones(len(case.assets.classes))
    if case.assets.return_kind == "total" and not case.risk_neutral:
        found[case.assets.shocks] = 0.0
    return found
