"""Short rate and expected inflation: Gaussian factors fitted exactly to both initial curves.

Factors f = (x_1 .. x_F, p), g = F + 1 of them: df_i = -a_i f_i dt + s_i(t) (dW_i + lambda_i dt),
f_i(0) = 0. Over one step, with zeta and iota of `shocks`,

    f_i' = exp(-a_i d) f_i + s_i (zeta_i + lambda_i B_i(d)),
    int f_i = B_i(d) f_i + s_i (iota_i + lambda_i int_0^d B_i),

both exact while s_i is constant in the step. A bond discounts by K = sum_i l_i int f_i + own noise
+ a shift; l = (1 .. 1, 0) makes nominal bonds, l = (1 .. 1, -1) with the price index's noise
-s_I dW_I makes real ones (R. Jarrow, Y. Yildirim, JFQA 38, 2003, with Gaussian rates). With the
covariances under the risk-neutral measure S of f_t, c of f_t and K_0t, and G = Var K_0t,

    ln P(t, t+u) = ln P(0, t+u) - ln P(0, t) - (l B(u)) . (c_t + f_t) - (l B(u)) S_t (l B(u)) / 2

where the shift of step t is ln P(0, t) - ln P(0, t+d) + (G_t+d - G_t) / 2.
"""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import scan, xp

from ..records.case import PensionModel
from ..records.inputs import use
from .shocks import Slots, reach, slots


class MarketFactors(NamedTuple):
    """The g factors: `volatility` has the shape [T, g], all other numbers [g]. `decay`: exp(-a d);
    `reach`: B(d); `reached`: the integral of B from 0 to d. `price_of_risk` is zero if scenarios
    are risk-neutral.
    """

    mean_reversion: Array
    volatility: Array
    price_of_risk: Array
    decay: Array
    reach: Array
    reached: Array


class BondLoads(NamedTuple):
    """The loadings of a kind of bond: `loads` [g] on the integrals of the factors, `loading` [T] on
    dW_I."""

    loads: np.ndarray
    loading: Array


class Moments(NamedTuple):
    """Risk-neutral moments at times 0 .. T: `factors` S [T+1, g, g], `cross` c [T+1, g], `total` G
    [T+1]."""

    factors: Array
    cross: Array
    total: Array


def factors(case: PensionModel, inputs: dict[str, Any]) -> MarketFactors:
    """The factors of a case: those of rates first, expected inflation last."""
    rates, inflation = case.rates, case.inflation
    both = [(rates.mean_reversion, inflation.mean_reversion)]
    both += [(rates.price_of_risk, inflation.price_of_risk)]
    reversion, price = (xp.append(use(inputs, a), use(inputs, b)) for a, b in both)
    volatility = xp.column_stack([use(inputs, rates.volatility), use(inputs, inflation.volatility)])
    nodes, weights = np.polynomial.legendre.leggauss(8 if case.step < 0.5 else 16)
    inner = reach(reversion[:, None], case.step * (nodes + 1) / 2)
    return MarketFactors(
        mean_reversion=reversion,
        volatility=volatility,
        price_of_risk=0 * price if case.risk_neutral else price,
        decay=xp.exp(-reversion * case.step),
        reach=reach(reversion, case.step),
        reached=inner @ (weights * case.step / 2),
    )


def nominal(case: PensionModel) -> BondLoads:
    """Bonds with payments in money."""
    return BondLoads(np.append(np.ones(case.rates.count()), 0.0), xp.zeros(case.steps))


def real(case: PensionModel, inputs: dict[str, Any]) -> BondLoads:
    """Bonds with payments in units of the price index."""
    return BondLoads(
        np.append(np.ones(case.rates.count()), -1.0), -use(inputs, case.inflation.index_volatility)
    )


def moments(
    case: PensionModel, factors: MarketFactors, bond: BondLoads, covariance: Float[Array, "Z Z"]
) -> Moments:
    """The moments, in one pass over the steps; `_grow` has the formulas of a step."""
    position = slots(case)
    count = len(position.zeta)
    steps = _grow(factors, bond, covariance, position)
    slope = bond.loads * factors.reach
    decay = factors.decay

    def step(carry, grown):
        s, c, total = carry
        ds, dc, dtotal = grown
        after = (
            decay[:, None] * s * decay + ds,
            decay * (c + s @ slope) + dc,
            total + 2 * slope @ c + slope @ s @ slope + dtotal,
        )
        return after, after

    start = xp.zeros((count, count)), xp.zeros(count), xp.zeros(())
    _, later = scan(step, start, steps, case.steps)
    return Moments(*(xp.concatenate([zero[None], item]) for zero, item in zip(start, later)))


def _grow(factors: MarketFactors, bond: BondLoads, covariance: Array, position: Slots):
    """Additions of a step's shocks: Cov(s zeta), Cov(s zeta, k), Var(k); k = sum l s iota + own."""
    zeta, iota, index = position.zeta, position.iota, position.index
    moved = factors.volatility
    loaded = moved * bond.loads
    local = bond.loading[:, None]
    ds = moved[:, :, None] * moved[:, None, :] * covariance[zeta[:, None], zeta]
    dc = moved * (loaded @ covariance[zeta[:, None], iota].T + local * covariance[zeta, index])
    among = xp.sum(loaded @ covariance[iota[:, None], iota] * loaded, axis=1)
    across = loaded @ covariance[iota, index]
    dtotal = among + bond.loading * (2 * across + bond.loading * covariance[index, index])
    return ds, dc, dtotal


def shift(log_bond: Float[Array, " T1"], result: Moments) -> Float[Array, " T"]:
    """The shift of K in each step, with which the model fits the initial curve."""
    return -xp.diff(log_bond) + xp.diff(result.total) / 2


def slope(factors: MarketFactors, bond: BondLoads, years: np.ndarray) -> Float[Array, "n g"]:
    """l B(u): the fall of ln P(t, t+u) per unit of each factor."""
    return xp.asarray(bond.loads) * reach(factors.mean_reversion, years[:, None])


def shape(slopes: Float[Array, "n g"], result: Moments) -> Float[Array, "T1 n"]:
    """ln P(t, t+u) at factors of zero, beyond the ratio of the initial prices."""
    convexity = xp.einsum("ni,tij,nj->tn", slopes, result.factors, slopes) / 2
    return -result.cross @ slopes.T - convexity
