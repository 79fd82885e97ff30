"""Receiver swaps of the overlay: nominal bonds of constant maturity, financed at cash."""

from typing import Any

from jaxtyping import Array, Float

from ...records.case import PensionCase
from ..curve import log_bond
from . import constant_maturity
from .asset_class import Now, Scene
from .bond import BondSteps, BondTerms


def _held(case: PensionCase) -> constant_maturity.Held:
    assert case.overlay is not None
    return constant_maturity.nominal_bonds(case, case.overlay.maturity, [-1] * case.buckets)


def swap_schedule(scene: Scene) -> tuple[BondTerms, BondSteps]:
    """The numbers of the b swaps that all paths share."""
    held = _held(scene.case)
    drift = constant_maturity.drift(scene, held, constant_maturity.load(scene, held))
    reach = constant_maturity.reach(held, scene.factors, scene.case.step)
    return BondTerms(reach), BondSteps(drift)


def swap_returns(case: PensionCase, terms: BondTerms, steps: BondSteps, now: Now) -> Array:
    """[b] log returns over cash of a step; swaps are in the fund's own currency."""
    own = now._replace(foreign=None)
    return constant_maturity.over_cash(case, _held(case), terms.reach, steps.drift, own)


def swap_log_prices(case: PensionCase, inputs: dict[str, Any]) -> Float[Array, " b"]:
    """ln of today's price of the bond in each swap."""
    return log_bond(case.curve, inputs, _held(case).maturity * case.step)
