"""Growth of prices from date to date: Gaussian under the measure of each payment.

Y_k = ln I(u_k) / I(u_{k-1}), where u_k is in years after time t. N(u) is the part of ln I(t + u)
that is unknown at t. In the model of `factors`, with volatilities that do not change,

    K(u, v) = Cov(N(u), N(v)) = int_0^min (s_p B(u-s) dW_p + s_I dW_I)(s_p B(v-s) dW_p + s_I dW_I)
    C(u, T) = Cov(N(u), int_0^T r) = int_0^u sum_i (s_p B(u-s) dW_p + s_I dW_I) s_i B_i(T-s) dW_i

The forward index of u is exp(E N(u) - C(u, u) + K(u, u) / 2), which the fitted real and nominal
bonds give (Jarrow and Yildirim, JFQA 38, 2003). Under the measure of a payment at T the mean of
ln I falls by C(u, T).
"""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ..records.case import PensionModel
from ..records.inputs import use
from ..records.people import PAYMENT_YEARS
from .correlation import matrix
from .curve import log_bond
from .factors import factors, moments, nominal, real, shape, slope
from .shocks import covariance, reach


class PriceGrowth(NamedTuple):
    """Price growth up to the dates k = 1 ... N after each time t = 0 ... T. Times with the same
    number of steps to the first date are one phase.

    - `phase` [T+1]: the row of `variance`, `together`, `later` and `load`. `first` [T+1]: steps to
      the first date.
    - `mean` [T+1, N]: the mean of Y_k under the measure of a payment after date k, with the factor
      of expected inflation at zero; `load` [phases, N]: its rise per unit of that factor.
    - `variance` [phases, N]: variances; `together` [phases, N, N]: covariances of pairs.
    - `later` [phases, N, N]: at [n, k], the fall of the mean of Y_k if the payment follows date n.
    """

    phase: np.ndarray
    first: np.ndarray
    mean: Array
    load: Array
    variance: Array
    together: Array
    later: Array


def price_growth(case: PensionModel, inputs: dict[str, Any], today: bool = False) -> PriceGrowth:
    """All moments, exact at every time of the grid. With `today` they are computed at time 0 only,
    without the scan over the steps that other times need."""
    item, d = round(1 / case.step), case.step
    times = np.arange(1 if today else case.steps + 1)
    first = np.ones_like(times)
    if item > 1:
        # A step s ends on a date where (start_month + s) % 12 + 1 is the month.
        last = case.plan.indexation.month - 1 - case.start_month
        first = (last - times) % item + 1
    count = round(PAYMENT_YEARS) + -(-case.steps // item) + 1
    phases = np.unique(first)
    dates = phases[:, None] + item * np.arange(-1, count)  # date 0 is now
    dates[:, 0] = 0
    years = d * dates
    model = _Model(case, inputs)
    spread = model.among(years)
    step = np.diff(np.eye(count + 1), axis=0)
    # Payments follow an increase all the year; the middle one represents them.
    after = ((item - 1) / 2 + (case.plan.timing == "arrears")) * d
    due = model.with_rates(years[:, 1:, None], years[:, None, :], after)  # [phases, n, k]
    at = xp.concatenate([xp.zeros((len(phases), 1)), model.with_rates_at(years[:, 1:])], axis=1)
    variance = xp.diagonal(spread, axis1=1, axis2=2)
    falls = xp.diff(due, axis=2)
    own_fall = xp.diagonal(falls, axis1=1, axis2=2)
    phase = np.searchsorted(phases, first)
    mean = model.forward(times, dates[phase])
    steady = xp.diff(at, axis=1) - xp.diff(variance, axis=1) / 2 - own_fall
    together = xp.einsum("ki,pij,lj->pkl", step, spread, step)
    return PriceGrowth(
        phase=phase,
        first=first,
        mean=xp.diff(mean, axis=1) + steady[phase],
        load=xp.diff(reach(model.reversion, years), axis=1),
        variance=xp.diagonal(together, axis1=1, axis2=2),
        together=together,
        later=falls - own_fall[:, None, :],
    )


class _Model:
    """The numbers of rates and inflation in a case, and their integrals."""

    def __init__(self, case: PensionModel, inputs: dict[str, Any]):
        self.case, self.inputs = case, inputs
        prices, count = case.inflation, case.rates.count()
        self.reversion = use(inputs, prices.mean_reversion)
        self.rates = use(inputs, case.rates.mean_reversion)
        available = matrix(case, inputs)
        volatility = use(inputs, case.rates.volatility)[0]
        expected, index = use(inputs, prices.volatility)[0], use(inputs, prices.index_volatility)[0]
        self.expected, self.index = expected**2, index**2
        self.both = expected * index * available[count, count + 1]
        self.drift = expected * volatility * available[count, :count]
        self.own_load = index * volatility * available[count + 1, :count]

    def among(self, years: np.ndarray) -> Float[Array, "phases n n"]:
        """K of all pairs of times."""
        u, v = years[:, :, None], years[:, None, :]
        m, k = np.minimum(u, v), self.reversion

        def left(w):
            return (xp.exp(-k * (w - m)) - xp.exp(-k * w)) / k

        product = (xp.exp(-k * (u + v - 2 * m)) - xp.exp(-k * (u + v))) / (2 * k)
        squares = (m - left(u) - left(v) + product) / k**2
        crossed = (2 * m - left(u) - left(v)) / k
        return self.expected * squares + self.both * crossed + self.index * m

    def with_rates(self, paid: np.ndarray, u: np.ndarray, after: float) -> Array:
        """C(u, paid + after); a u beyond `paid` counts as `paid`."""
        return self._with(np.minimum(u, paid), paid + after)

    def with_rates_at(self, u: np.ndarray) -> Array:
        """C(u, u)."""
        return self._with(u, u)

    def _with(self, u: np.ndarray, paid: np.ndarray) -> Array:
        k, result = self.reversion, xp.zeros(np.broadcast_shapes(np.shape(u), np.shape(paid)))
        for i in range(self.case.rates.count()):
            a = self.rates[i]
            left = (xp.exp(-a * (paid - u)) - xp.exp(-a * paid)) / a
            single = (u - left) / a
            faded = (xp.exp(-a * (paid - u)) - xp.exp(-k * u - a * paid)) / (k + a)
            double = (u + xp.expm1(-k * u) / k - left + faded) / (k * a)
            result = result + self.drift[i] * double + self.own_load[i] * single
        return result

    def forward(self, times: np.ndarray, dates: np.ndarray) -> Float[Array, "T1 n"]:
        """ln of the forward index of each date over the index now, at factors of zero."""
        case, inputs, d = self.case, self.inputs, self.case.step
        ahead = np.arange(times[-1] + dates.max() + 1) * d
        index = -log_bond(case.inflation.break_even, inputs, ahead)
        row = times[:, None]
        if len(times) == 1:  # today the forwards are those of the curve
            return index[dates]
        both, together = factors(case, inputs), covariance(case, inputs)
        far = np.arange(dates.max() + 1)
        change = xp.zeros((len(times), len(far)))
        for sign, bond in ((1.0, real(case, inputs)), (-1.0, nominal(case))):
            slopes = slope(both, bond, far * d)
            change = change + sign * shape(slopes, moments(case, both, bond, together))
        return index[row + dates] - index[row] + change[row, dates]
