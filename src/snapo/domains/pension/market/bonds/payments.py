"""Payments of bonds and of the fixed legs of swaps: amounts at dates, in money or linked to prices.

Coupons are paid once a year up to the maturity. The first coupon is in proportion to the time since
the purchase.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ...records.case import PensionModel
from ..curve import log_bond

AT_PAR = np.nan  # the coupon of a bond whose value is its principal when it is bought


class Payments(NamedTuple):
    """Payments of k holdings for a principal of 1; all fields are static.

    - `steps` [J]: when payments are due, in steps from the purchase, rising.
    - `coupon` [k]: the rate per year, or `AT_PAR`. `period` [k, J]: the length in years for which a
      coupon is paid. `principal` [k, J]: 1 if the principal is due.
    """

    steps: np.ndarray
    coupon: np.ndarray
    period: np.ndarray
    principal: np.ndarray


# Prices [J] now of 1 that is due after `steps` [J]; where `linked`, of 1 that follows prices.
Prices = Callable[[np.ndarray, bool], Array | np.ndarray]


def payments(maturity: ArrayLike, coupon: ArrayLike, step: float) -> Payments:
    """The payments of bonds; `maturity` [k] in steps, `step`: its length in years."""
    maturity, coupon = np.asarray(maturity, int), np.asarray(coupon, float)
    year = round(1 / step)
    dates = [
        np.arange(last, 0, -year) if rate != 0 else np.array([last])
        for last, rate in zip(maturity, coupon)
    ]
    steps = np.unique(np.concatenate(dates))
    due = np.array([np.isin(steps, local) for local in dates])
    period = due * np.minimum(steps, year) * step * (coupon != 0)[:, None]
    return Payments(steps, coupon, period, (steps == maturity[:, None]).astype(float))


def zero_coupon(maturity: ArrayLike, step: float) -> Payments:
    """Only the principal."""
    return payments(maturity, np.zeros(np.shape(maturity)), step)


def coupons(
    of: Payments, price: Array | np.ndarray
) -> tuple[Float[Array, " k"], Float[Array, " k"]]:
    """Coupons per year, which for bonds at par are the par rate at these prices [J]; and annuities,
    the prices of a coupon of 1 per year."""
    at_par, last = np.isnan(of.coupon), np.argmax(of.principal, axis=1)
    annuity = xp.asarray(of.period) @ price
    # Periods of nothing would divide by nothing.
    par = (1 - price[last]) / xp.where(at_par, annuity, 1.0)
    return xp.where(at_par, par, np.nan_to_num(of.coupon)), annuity


def amounts(of: Payments, price: Array | np.ndarray) -> Float[Array, "k J"]:
    """The amounts due, [k, J], if the prices of payments are these [J]."""
    coupon, _ = coupons(of, price)
    return coupon[:, None] * of.period + of.principal


def ratio(of: Payments, linked: bool, before: Prices, after: Prices) -> Float[Array, " k"]:
    """Value at the prices `after` of a unit of money invested at the prices `before`."""
    price = before(of.steps, linked)
    due = amounts(of, price)
    return (due @ after(of.steps, linked)) / (due @ price)


def curve_prices(case: PensionModel, inputs: dict[str, Any]) -> Prices:
    """Today's prices of payments: on the curve, and for linked payments on the curve minus
    break-evens. Without `inputs` they are at the numbers of the case."""

    def prices(steps: np.ndarray, linked: bool) -> Array:
        years = steps * case.step
        log = log_bond(case.curve, inputs, years)
        if linked:
            log = log - log_bond(case.inflation.break_even, inputs, years)
        return xp.exp(log)

    return prices
