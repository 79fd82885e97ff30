"""Collateral behind swaps: the eligible assets and the debt from the swaps after a rise of rates,
both by full revaluation.

All zero rates rise equally; with inflation swaps, break-evens fall by the same amount. Par swaps
and coupon bonds have the payments that are at par on today's curve. The revaluation is the same on
every path.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from snapo.problem.record.arrays import Array, jax
from snapo.problem.record.either import xp

from ..market.assets.asset_class import ratios
from ..market.assets.swaps import swap_gains
from ..market.bonds.payments import curve_prices
from ..records.case import PensionModel


class Stress(NamedTuple):
    """After a rise of rates: `cover` [n] is the collateral that a unit of each class provides, and
    `need` [b] the collateral that a unit of notional of each swap needs."""

    cover: Array | np.ndarray
    need: Array | np.ndarray

    def gap(self, weights: Array | np.ndarray, notional: Array | np.ndarray) -> Array:
        """The missing collateral, negative if there is a surplus, in the unit of the holdings
        `weights` [n] and `notional` [b]. If borrowed cash exceeds the eligible assets, there is no
        collateral."""
        there = self.cover @ weights
        return xp.asarray(self.need @ notional - xp.where(there >= 0, there, 0.0))


def eligible(case: PensionModel) -> np.ndarray:
    """The share of each class that counts as collateral, [n]."""
    if case.derived is not None:
        return case.derived.eligible
    return np.array([class_.eligible for class_ in case.assets.classes])


def stress(case: PensionModel, inputs: dict[str, Any], rise: Any) -> Stress:
    """The collateral after a `rise` of rates (0.01 is 100 basis points)."""
    overlay = case.overlay
    assert overlay is not None
    before = curve_prices(case, inputs)
    real = 2 if overlay.inflation else 1  # of rates minus break-evens

    def after(steps: np.ndarray, linked: bool) -> Array | np.ndarray:
        years = steps * case.step * (real if linked else 1)
        return before(steps, linked) * xp.exp(-rise * years)

    return Stress(eligible(case) * ratios(case, before, after), -swap_gains(case, before, after))


def stressed(case: PensionModel, rise: ArrayLike) -> Stress:
    """The collateral as by `stress`, at the numbers of the case and in 64 bits. For many rises [r]
    together `cover` is [r, n] and `need` [r, b]."""
    from snapo.problem.quickly import compiled_sooner  # with JAX, which a check does without

    with jax.enable_x64(True):
        item = xp.vectorize(lambda x: tuple(stress(case, {}, x)), signature="()->(n),(b)")
        result = compiled_sooner(item)(np.asarray(rise, np.float64))
        return Stress(*map(np.asarray, result))


def slope(case: PensionModel) -> np.ndarray:
    """The derivative of `need` with respect to the rise, at zero, [b]: the durations of the swaps,
    in years."""
    from snapo.problem.quickly import compiled_sooner

    with jax.enable_x64(True):
        risen = jax.jacfwd(lambda x: stress(case, {}, x).need)
        return np.asarray(compiled_sooner(risen)(np.zeros(())))
