"""The Gaussian vector of a step: exact integrals of Brownian motions, and their covariance.

With v the remaining time of the step: zeta = int exp(-a v) dW moves a factor of mean reversion a,
iota = int B(v) dW, B(v) = (1 - exp(-a v)) / a, moves that factor's time integral, and dW is the
plain increment. No volatility enters, so a volatility of zero is allowed.
"""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import updated, xp

from ..records.case import PensionModel
from ..records.inputs import use
from .correlation import brownians, matrix


class Slots(NamedTuple):
    """The index of each part of the vector of shocks. There are F rate factors and one inflation
    factor (g = F + 1). `zeta`, `iota`: [g] the shocks of rates, then of expected inflation. The
    other shocks are slices. The order of the vector is zeta and iota of rates, zeta and iota of
    inflation, price index, wage, mortality, ratings, currencies, asset classes with a separate
    shock.
    """

    zeta: np.ndarray
    iota: np.ndarray
    index: int
    wage: int
    mortality: int
    spread: slice
    currency: slice
    asset: slice
    size: int


def slots(case: PensionModel) -> Slots:
    """The indices of the parts of a case's vector."""
    f = case.rates.count()
    rates = np.arange(f)
    spread = 2 * f + 5 + len(case.credit.names)
    currency = spread + len(case.currencies.names)
    size = currency + len(case.assets.shocks)
    return Slots(
        zeta=np.append(rates, 2 * f),
        iota=np.append(rates + f, 2 * f + 1),
        index=2 * f + 2,
        wage=2 * f + 3,
        mortality=2 * f + 4,
        spread=slice(2 * f + 5, spread),
        currency=slice(spread, currency),
        asset=slice(currency, size),
        size=size,
    )


def reach(mean_reversion, years):
    """B(u) = (1 - exp(-a u)) / a."""
    return -xp.expm1(-mean_reversion * years) / mean_reversion


def covariance(case: PensionModel, inputs: dict[str, Any]) -> Float[Array, "Z Z"]:
    """The covariance of the vector of one step, by Gauss-Legendre quadrature over the step."""
    position, brownian = slots(case), _brownian(case)
    nodes, weights = np.polynomial.legendre.leggauss(8 if case.step < 0.5 else 16)
    left = case.step * (nodes + 1) / 2
    reversion = xp.append(
        use(inputs, case.rates.mean_reversion), use(inputs, case.inflation.mean_reversion)
    )
    loads = xp.ones((position.size, len(left)))
    loads = updated(loads, position.zeta, xp.exp(-reversion[:, None] * left))
    loads = updated(loads, position.iota, reach(reversion[:, None], left))
    fading = xp.exp(-use(inputs, case.credit.mean_reversion)[:, None] * left)
    loads = updated(loads, position.spread, fading)
    together = (loads * (weights * case.step / 2)) @ loads.T
    return together * matrix(case, inputs)[brownian[:, None], brownian]


def factor(covariance: Float[Array, "Z Z"]) -> Float[Array, "Z Z"]:
    """The lower triangular matrix that transforms independent normals into the vector."""
    scale = xp.sqrt(xp.diag(covariance))
    return scale[:, None] * xp.linalg.cholesky(covariance / scale / scale[:, None])


def _brownian(case: PensionModel) -> np.ndarray:
    """[Z] which Brownian motion drives each component."""
    f = case.rates.count()
    rest = np.arange(f + 1, len(brownians(case)))
    return np.concatenate([np.arange(f), np.arange(f), [f, f], rest])
