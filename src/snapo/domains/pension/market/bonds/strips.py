"""Coupon bonds over a step: each payment is a separate zero-coupon bond, bought at the prices of
the path's curve and sold after the step (see `constant_maturity`).

With shares w of the value by payment, fixed at the purchase, a bond earns sum_j w_j exp(n_j) over
cash, where n_j are the log returns over cash of the payments.
"""

from typing import NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ...records.case import PensionModel
from ..assets.asset_class import AssetMixture, Now, Scene
from ..curve import log_bond
from ..factors import nominal, shape, slope
from . import constant_maturity
from .payments import Payments, amounts, coupons


class StripTerms(NamedTuple):
    """Terms of the q payments, one for each date and currency: `reach` [q, f] (see
    `constant_maturity`). For the J dates: `slope` [J, g], by which ln P falls per unit of each
    factor."""

    reach: Array
    slope: Array


class StripSteps(NamedTuple):
    """`drift` [T, q] of log returns over cash; `level` [T, J] ln P at factors of zero."""

    drift: Array
    level: Array


def _held(case: PensionModel, of: Payments, currency: np.ndarray) -> constant_maturity.HeldBonds:
    """All dates in the first currency, then all in the next one."""
    local = np.unique(currency)
    return constant_maturity.nominal_bonds(
        case, np.tile(of.steps, len(local)), np.repeat(local, len(of.steps))
    )


def prepare(scene: Scene, of: Payments, currency: np.ndarray) -> tuple[StripTerms, StripSteps]:
    """The numbers that all paths share; `currency` [k] of the holdings."""
    case, held = scene.case, _held(scene.case, of, currency)
    drift = constant_maturity.drift(scene, held, constant_maturity.load(scene, held))
    reach = constant_maturity.reach(held, scene.factors, case.step)
    years, times = of.steps * case.step, np.arange(case.steps) * case.step
    slopes = slope(scene.factors, nominal(case), years)
    later = log_bond(case.curve, scene.inputs, (times[:, None] + years).ravel())
    level = later.reshape(len(times), -1) - log_bond(case.curve, scene.inputs, times)[:, None]
    level = level + shape(slopes, scene.moments)[:-1]
    return StripTerms(reach, slopes), StripSteps(drift, level)


def _prices(terms: StripTerms, steps: StripSteps, now: Now) -> Float[Array, " J"]:
    return xp.exp(steps.level - terms.slope @ now.factors)


def mixture(
    case: PensionModel, of: Payments, currency: np.ndarray, terms: StripTerms, steps: StripSteps,
    now: Now,
) -> AssetMixture:  # fmt: skip
    """The shares of the payments in each holding, and the log returns of the payments over cash."""
    log = constant_maturity.over_cash(
        case, _held(case, of, currency), terms.reach, steps.drift, now
    )
    share = shares(of, _prices(terms, steps, now))
    of_own = (currency[:, None] == np.unique(currency)).astype(float)
    return AssetMixture((of_own[:, :, None] * share[:, None]).reshape(len(currency), -1), log)


def gains(
    case: PensionModel, of: Payments, currency: np.ndarray, terms: StripTerms, steps: StripSteps,
    now: Now,
) -> Float[Array, " k"]:  # fmt: skip
    """Gains over cash of a unit of money in each holding: share @ expm1(log) of its `mixture`."""
    log = constant_maturity.over_cash(
        case, _held(case, of, currency), terms.reach, steps.drift, now
    )
    price, growth = _prices(terms, steps, now), xp.expm1(log).reshape(-1, len(of.steps))
    by_currency = xp.stack([gain(of, price, row) for row in growth])
    return by_currency[np.unique(currency, return_inverse=True)[1], np.arange(len(currency))]


def gain(of: Payments, price: Float[Array, " J"], growth: Float[Array, " J"]) -> Float[Array, " k"]:
    """The gain per unit of money in each holding, if the `price` of each payment rises by `growth`.

    It is computed by sums over the payments, without a matrix of amounts due.
    """
    coupon, annuity = coupons(of, price)
    last = np.argmax(of.principal, axis=1)
    risen = price * growth
    rise = coupon * (of.period @ risen) + risen[last]
    return rise / xp.where(np.isnan(of.coupon), 1.0, coupon * annuity + price[last])


def shares(of: Payments, price: Float[Array, " J"]) -> Float[Array, "k J"]:
    """The share of each payment in the value of each holding."""
    due = amounts(of, price) * price
    return due / xp.sum(due, axis=1, keepdims=True)
