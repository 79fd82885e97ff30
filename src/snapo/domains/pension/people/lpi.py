"""Limited price indexation: increases by prices within a cap and a floor, valued as options.

From date to date rights grow by X = min(max(e^Y, 1 + floor), 1 + cap), where Y is the Gaussian
growth of prices (`market.price_growth`), with mean m and standard deviation s. By Black's formula
(F. Black, J. Financial Economics 3, 1976) for a caplet and a floorlet on the year's growth,

    E X = (1 + floor) + call(1 + floor) - call(1 + cap),
    call(K) = exp(m + s^2 / 2) N((m + s^2 - ln K) / s) - K N((m - ln K) / s)

Years are not independent, since expected inflation persists. To first order in their covariances
(R. Price, IRE Trans. Inform. Theory 4, 1958), with d_k = d ln E X_k / d m_k,

    ln E prod X_k = sum ln E X_k + sum_{j<k} d_j d_k Cov(Y_j, Y_k)

which is exact without limits. The measure of a later payment shifts the means, and so ln E X_k by
d_k times the shift. The part of the first year depends on the growth of prices so far, and is
computed on every path. The sum of the later parts is a polynomial in the factor of expected
inflation, which `lpi` fits once.
"""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import erf, updated, xp

from ..market.price_growth import PriceGrowth, price_growth
from ..records.case import PensionModel
from ..records.inputs import use
from ..records.people import PAYMENT_YEARS

DEGREE = 12  # of the polynomials in the factor
WIDE = 5.0  # deviations of the factor in the long run, at which it counts as no larger
MINIMUM = 1e-16  # variance that takes the place of none


class Lpi(NamedTuple):
    """The additions of increases to the logarithm of the payments on the nodes, beyond today's
    expectation; arrays are [T+1, ...].

    - `mean`, `load`, `deviation` [T+1]: the mean of the growth of prices up to the first date, the
      rise of this mean with the factor, and the standard deviation.
    - `started` [T+1, J]: 1 if a node's payments have an increase ahead.
    - `later`, `joint` [T+1, J, DEGREE+1]: Chebyshev coefficients in the factor divided by `width`
      [T+1], for the part of the later dates and for the part that is joint with the first date.
    """

    mean: Array
    load: Array
    deviation: Array
    started: Array
    later: Array
    joint: Array
    width: Array


def limited(case: PensionModel) -> bool:
    """Whether liabilities contain the options in limited increases."""
    return case.liability.future_indexation == "capped"


def expected(mean, deviation, floor, cap) -> tuple[Array, Array]:
    """ln E X and d ln E X / d mean; `floor`, `cap` per year, above -1."""
    low, high = xp.log1p(floor), xp.log1p(cap)

    def below(strike, shift):
        return (1 + erf((mean + shift - strike) / (deviation * np.sqrt(2)))) / 2

    inside = xp.exp(mean + deviation**2 / 2)
    inside = inside * (below(low, deviation**2) - below(high, deviation**2))
    under, over = 1 - below(low, 0.0), below(high, 0.0)
    value = inside + (1 + floor) * under + (1 + cap) * over
    return xp.log(value), inside / value


def dates_before(case: PensionModel, first: np.ndarray, wait: np.ndarray) -> np.ndarray:
    """How many increases rights have had before a payment that is due in `wait` steps; `first` is
    the number of steps to the first date."""
    item = round(1 / case.step)
    return np.where(wait >= first, 1 + (wait - first) // item, 0)


def log_growth(case: PensionModel, inputs: dict[str, Any]) -> Float[Array, " H"]:
    """The logarithm of the expected growth of rights from today until the payment at time s * step,
    under the payment's measure, for s = 0 ... T + `PAYMENT_YEARS` / step."""
    result, none = price_growth(case, inputs, today=True), xp.zeros(1)
    first, d_first, later, joint = _parts(case, inputs, result, none)
    complete = first[0, 0] + later[0, 0] + d_first[0, 0] * joint[0, 0]
    complete = xp.concatenate([none, complete])
    return complete[dates_before(case, result.first[:1], _waits(case, _times(case)))]


def lpi(case: PensionModel, inputs: dict[str, Any], nodes: np.ndarray) -> Lpi:
    """The numbers that all paths share; `nodes` [J] whole steps to a payment."""
    result, observed = price_growth(case, inputs), log_growth(case, inputs)
    points = np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
    to_chebyshev = np.cos(np.arange(DEGREE + 1)[:, None] * np.arccos(points)) * 2 / len(points)
    to_chebyshev[0] /= 2
    width = factor_width(case)
    _, _, later, joint = _parts(case, inputs, result, xp.asarray(width * points))
    times = np.arange(case.steps + 1)
    dates = dates_before(case, result.first[:, None], _waits(case, nodes))
    ahead = observed[times[:, None] + nodes] - observed[times[:, None]]

    def on_nodes(values: Array) -> Array:
        """[T+1, J, points] from [T+1, points, N], by the dates before each node."""
        rows = xp.concatenate([xp.zeros_like(values[..., :1]), values], axis=-1)
        return xp.take_along_axis(rows, xp.asarray(dates)[:, None, :], -1).transpose(0, 2, 1)

    after = on_nodes(later) - ahead[..., None]
    return Lpi(
        mean=result.mean[:, 0],
        load=result.load[result.phase, 0],
        deviation=xp.sqrt(result.variance[result.phase, 0] + MINIMUM),
        started=xp.asarray(dates > 0, float),
        later=after @ to_chebyshev.T,
        joint=on_nodes(joint) @ to_chebyshev.T,
        width=xp.full(case.steps + 1, width),
    )


def log_factor(now: Lpi, terms, growth: Array, factor: Array) -> Float[Array, " J"]:
    """The addition to the logarithm of the value of each node's payments on a path.

    **Arguments:**

    - `now`: the numbers of one time. `growth`: the growth of ln prices since the last date.
      `factor`: the factor of expected inflation. `terms`: the terms of the plan, with `cap` and
      `floor`.
    """
    mean = now.mean + now.load * factor + growth
    first, slope = expected(mean, now.deviation, terms.floor, terms.cap)
    x = xp.clip(factor / now.width, -1.0, 1.0)
    powers = [xp.ones_like(x), x]
    while len(powers) <= DEGREE:
        powers.append(2 * x * powers[-1] - powers[-2])
    basis = xp.stack(powers)
    return now.later @ basis + now.started * (first + slope * (now.joint @ basis))


def _parts(case: PensionModel, inputs: dict[str, Any], result: PriceGrowth, factor: Array):
    """[T+1, points, N] or [.., 1]: ln E X_1, d_1, and by the number of dates the later dates' part
    and the part that goes with d_1, at values of the factor [points]."""
    rule = case.plan.indexation
    cap, floor = use(inputs, rule.cap), use(inputs, rule.floor)
    load, deviation = result.load[result.phase], xp.sqrt(result.variance[result.phase] + MINIMUM)
    mean = result.mean[:, None, :] + load[:, None, :] * factor[:, None]
    log, slope = expected(mean, deviation[:, None, :], floor, cap)
    rest = updated(slope, (..., 0), 0.0)
    together, shift = result.together[result.phase], result.later[result.phase]
    pairs = rest * xp.einsum("tqj,tkj->tqk", rest, xp.tril(together, -1))
    # Means under the measure of a payment after date n, for all dates before it.
    moved = xp.einsum("tqk,tnk->tqn", rest, xp.tril(shift))
    later = xp.cumsum(updated(log, (..., 0), 0.0) + pairs, axis=-1) - moved
    joint = xp.cumsum(rest * together[:, None, 0, :], axis=-1) - shift[:, None, :, 0]
    return log[..., :1], slope[..., :1], later, joint


def factor_width(case: PensionModel) -> Any:
    """`WIDE` long-run standard deviations of the factor; this width does not depend on inputs."""
    if case.derived is not None:
        return case.derived.width
    spread = case.inflation.volatility.used()[0] / np.sqrt(2 * case.inflation.mean_reversion.used())
    return float(WIDE * max(spread, 1e-4))


def _times(case: PensionModel) -> np.ndarray:
    return np.arange(case.steps + round(PAYMENT_YEARS / case.step) + 1)


def _waits(case: PensionModel, at: np.ndarray) -> np.ndarray:
    """Steps until the step whose payment is made `at` this many steps from now."""
    return at - (case.plan.timing == "arrears")
