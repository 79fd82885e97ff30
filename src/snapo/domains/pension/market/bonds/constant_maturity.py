"""Zero-coupon bonds that are sold after each step and replaced by bonds of the original maturity.

A bond of m steps depends on the factors f with the loadings l (see `market.factors`: 1 for every
factor of rates, and -1 for expected inflation if the bond is index-linked). Over a step of length d
its log return over cash is

    drift - sum_i l_i s_i (B_i((m - 1) d) zeta_i + iota_i) + (index-linked) s_I dW_I + currency

where a drift of minus half the total variance makes the bond over cash a martingale under "Q".
Under "P" each dW moves by lambda d, so that the drift has -sum_i l_i s_i lambda_i (B_i((m - 1) d)
B_i(d) + int_0^d B_i) and, index-linked, s_I lambda_I d on top. For index-linked bonds the return is
that of I(t) P_real(t, T), in money.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ...records.case import PensionModel
from ...records.inputs import use
from ..assets.asset_class import Now, Scene
from ..factors import MarketFactors
from ..shocks import slots
from ..spreads import of_currency


class HeldBonds(NamedTuple):
    """k bonds, as static data: `maturity` [k] in steps, `currency` [k], `loads` [f]: the loadings l
    of the first f factors, and whether they are `linked` to prices."""

    maturity: np.ndarray
    currency: np.ndarray
    loads: np.ndarray
    linked: bool


def nominal_bonds(case: PensionModel, maturity: ArrayLike, currency: ArrayLike) -> HeldBonds:
    """Bonds with payments in money."""
    loads = np.ones(case.rates.count())
    return HeldBonds(np.asarray(maturity, int), np.asarray(currency, int), loads, False)


def linked_bonds(case: PensionModel, maturity: ArrayLike, currency: ArrayLike) -> HeldBonds:
    """Bonds with payments in units of the price index."""
    loads = np.append(np.ones(case.rates.count()), -1.0)
    return HeldBonds(np.asarray(maturity, int), np.asarray(currency, int), loads, True)


class Load(NamedTuple):
    """The loadings of returns over cash: `size` [T, k, L], on the components `which` [k, L] of the
    Gaussian vector."""

    size: Array
    which: np.ndarray

    def variance(self, covariance: Array) -> Float[Array, "T k"]:
        """The variance of a step's log return."""
        among = covariance[self.which[:, :, None], self.which[:, None]]
        return xp.einsum("tki,kij,tkj->tk", self.size, among, self.size)

    def with_component(self, covariance: Array, component: np.ndarray) -> Float[Array, "T k"]:
        """Covariance with one `component` [k] of the vector for each bond."""
        return xp.sum(self.size * covariance[self.which, component[:, None]], axis=2)


def reach(held: HeldBonds, factors: MarketFactors, step: float) -> Float[Array, "k f"]:
    """The products l B((m - 1) d), one for each factor on which a bond depends."""
    shorter = (held.maturity - 1)[:, None] * step
    a = factors.mean_reversion[: len(held.loads)]
    return xp.asarray(-held.loads) * xp.expm1(-a * shorter) / a


def load(scene: Scene, held: HeldBonds) -> Load:
    """The exposure of a step's return to the Gaussian vector, currency included."""
    case, factors = scene.case, scene.factors
    position, count = slots(case), len(held.loads)
    steps, k = case.steps, len(held.maturity)
    foreign = np.where(held.currency >= 0, position.currency.start + held.currency, 0)
    which = [
        np.broadcast_to(position.zeta[:count], (k, count)),
        np.broadcast_to(position.iota[:count], (k, count)),
        foreign[:, None],
    ]
    volatility = factors.volatility[:, None, :count]
    complete = xp.broadcast_to(-volatility * held.loads, (steps, k, count))
    e = of_currency(scene.currencies.exposure, held.currency)
    size = [
        -volatility * reach(held, factors, case.step),
        complete,
        xp.broadcast_to(e[:, None], (steps, k, 1)),
    ]
    if held.linked:
        local = use(scene.inputs, case.inflation.index_volatility)
        which.append(np.full((k, 1), position.index))
        size.append(xp.broadcast_to(local[:, None, None], (steps, k, 1)))
    return Load(xp.concatenate(size, axis=2), np.concatenate(which, axis=1))


def drift(scene: Scene, held: HeldBonds, load: Load) -> Float[Array, "T k"]:
    """Mean of a step's log return over cash, currency included."""
    case, factors, count = scene.case, scene.factors, len(held.loads)
    exposed = reach(held, factors, case.step) * factors.reach[:count]
    exposed = exposed + held.loads * factors.reached[:count]
    premium = (factors.volatility[:, :count] * factors.price_of_risk[:count]) @ exposed.T
    currency = -load.variance(scene.covariance) / 2 - premium
    currencies = scene.currencies
    earned = currencies.hedging + (0.0 if case.risk_neutral else 1.0) * currencies.premium
    currency = currency + of_currency(earned, held.currency)
    if held.linked and not case.risk_neutral:
        local = use(scene.inputs, case.inflation.index_volatility)
        price = use(scene.inputs, case.inflation.index_price_of_risk)
        currency = currency + (local * price * case.step)[:, None]
    return currency


def over_cash(case: PensionModel, held: HeldBonds, reach: Array, drift: Array, now: Now) -> Array:
    """[k] log returns over cash; `reach` [k, f] and the step's `drift` [k]."""
    position, count = slots(case), len(held.loads)
    volatility = now.volatility[:count]
    fall = reach @ (volatility * now.shock[position.zeta[:count]])
    fall = fall + xp.sum(held.loads * volatility * now.shock[position.iota[:count]])
    if held.linked:
        fall = fall - now.index_volatility * now.shock[position.index]
    result = drift - fall
    return result if now.foreign is None else result + of_currency(now.foreign, held.currency)
