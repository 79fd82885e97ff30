"""The overlay: receiver swaps of rates and of inflation, of constant maturity.

A swap of rates receives the fixed leg and pays cash on the notional. At par, the fixed leg is a
bond with a coupon once a year whose value on the path's curve is the notional; the leg of a
zero-coupon swap is a zero-coupon bond bought with the notional. A zero-coupon swap of inflation
receives the growth of the price index over its maturity and pays the break-even: an index-linked
bond financed by a nominal one of the same maturity.

Per unit of notional a swap therefore earns exp(cash) times w @ (exp(n) - 1) over a step. Here n are
the log returns over cash of zero-coupon bonds, and w the shares of a bond's payments, or 1 and -1
for inflation. The return of a swap is reported as ln(1 + w @ (exp(n) - 1)). Swaps of rates come
first among the buckets.
"""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ...records.assets import Overlay
from ...records.case import PensionModel
from ..bonds import constant_maturity, strips
from ..bonds.payments import AT_PAR, Payments, Prices, curve_prices, payments, ratio, zero_coupon
from .asset_class import AssetMixture, Now, Scene


class SwapTerms(NamedTuple):
    """Terms of the fixed legs (see `bonds.strips`), and `reach` [i, f + 1] of the index-linked
    bonds or None."""

    fixed: strips.StripTerms
    linked: Array | None


class SwapSteps(NamedTuple):
    """Steps of the fixed legs, and `drift` [T, i] of the index-linked bonds or None."""

    fixed: strips.StripSteps
    linked: Array | None


def _overlay(case: PensionModel) -> Overlay:
    assert case.overlay is not None
    return case.overlay


def fixed_legs(case: PensionModel) -> Payments:
    """Payments of all fixed legs, including those of inflation swaps."""
    overlay = _overlay(case)
    coupon = np.where(overlay.at_par, AT_PAR, 0.0)
    return payments(overlay.maturity, coupon, case.step)


def _linked(case: PensionModel) -> constant_maturity.HeldBonds:
    overlay = _overlay(case)
    maturity = overlay.maturity[case.buckets - overlay.inflation :]
    return constant_maturity.linked_bonds(case, maturity, [-1] * overlay.inflation)


def _own(case: PensionModel) -> np.ndarray:
    return np.full(case.buckets, -1)


def swap_schedule(scene: Scene) -> tuple[SwapTerms, SwapSteps]:
    """The numbers of the b swaps that all paths share."""
    case = scene.case
    terms, steps = strips.prepare(scene, fixed_legs(case), _own(case))
    if not _overlay(case).inflation:
        return SwapTerms(terms, None), SwapSteps(steps, None)
    held = _linked(case)
    drift = constant_maturity.drift(scene, held, constant_maturity.load(scene, held))
    reach = constant_maturity.reach(held, scene.factors, case.step)
    return SwapTerms(terms, reach), SwapSteps(steps, drift)


def swap_mixture(case: PensionModel, terms: SwapTerms, steps: SwapSteps, now: Now) -> AssetMixture:
    """The underlying bonds of the b swaps; swaps are in the fund's own currency."""
    local = now._replace(foreign=None)
    fixed = strips.mixture(case, fixed_legs(case), _own(case), terms.fixed, steps.fixed, local)
    if terms.linked is None or steps.linked is None:
        return fixed
    linked = constant_maturity.over_cash(case, _linked(case), terms.linked, steps.linked, local)
    inflation = np.eye(case.buckets)[:, case.buckets - len(linked) :]
    share = fixed.share * (1 - 2 * inflation.sum(1, keepdims=True))
    share = xp.concatenate([share, xp.asarray(inflation, share.dtype)], axis=1)
    return AssetMixture(share, xp.concatenate([fixed.log, linked]))


def swap_returns(
    case: PensionModel, terms: SwapTerms, steps: SwapSteps, now: Now
) -> Float[Array, " b"]:
    """Log returns over cash of a step."""
    local = now._replace(foreign=None)
    gain = strips.gains(case, fixed_legs(case), _own(case), terms.fixed, steps.fixed, local)
    if terms.linked is not None and steps.linked is not None:
        linked = constant_maturity.over_cash(case, _linked(case), terms.linked, steps.linked, local)
        first = case.buckets - len(linked)
        gain = xp.concatenate([gain[:first], xp.expm1(linked) - gain[first:]])
    return xp.log1p(gain)


def swap_gains(case: PensionModel, before: Prices, after: Prices) -> Float[Array, " b"]:
    """The gain per unit of notional of each swap, after a sudden move of the prices of payments."""
    overlay = _overlay(case)
    fixed = ratio(fixed_legs(case), False, before, after)
    if not overlay.inflation:
        return fixed - 1
    first = case.buckets - overlay.inflation
    due = zero_coupon(overlay.maturity[first:], case.step)
    linked = ratio(due, True, before, after)
    return xp.concatenate([fixed[:first] - 1, linked - fixed[first:]])


def swap_values(case: PensionModel, inputs: dict[str, Any]) -> Float[Array, " b"]:
    """Values per unit of notional of swaps that have no value at the numbers of the case."""
    return swap_gains(case, curve_prices(case, {}), curve_prices(case, inputs))
