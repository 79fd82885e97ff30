"""The overlay: receiver swaps of rates and of inflation, of constant maturity.

A swap of rates is a nominal zero-coupon bond financed at cash. A zero-coupon swap of inflation
receives the growth of the price index over its maturity and pays the break-even: an index-linked
bond bought with the money of a nominal one of the same maturity. Per unit of notional they earn

    exp(cash) (exp(n) - 1)   and   exp(cash) (exp(l) - exp(n))

over a step, n and l being the bonds' log returns over cash; both are told as a log return over
cash, ln(1 + exp(l) - exp(n)) for inflation. Swaps of rates come first among the buckets.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...records.assets import Overlay
from ...records.case import PensionCase
from ..curve import log_bond
from . import constant_maturity
from .asset_class import Now, Scene


class SwapTerms(NamedTuple):
    """`reach` [b, f] of the nominal bonds, `linked` [i, f + 1] of the index-linked ones or None."""

    reach: Array
    linked: Array | None


class SwapSteps(NamedTuple):
    """`drift` [T, b] of the nominal bonds, `linked` [T, i] of the index-linked ones or None."""

    drift: Array
    linked: Array | None


def _overlay(case: PensionCase) -> Overlay:
    assert case.overlay is not None
    return case.overlay


def _held(case: PensionCase) -> constant_maturity.Held:
    return constant_maturity.nominal_bonds(case, _overlay(case).maturity, [-1] * case.buckets)


def _linked(case: PensionCase) -> constant_maturity.Held:
    overlay = _overlay(case)
    maturity = overlay.maturity[case.buckets - overlay.inflation :]
    return constant_maturity.linked_bonds(case, maturity, [-1] * overlay.inflation)


def swap_schedule(scene: Scene) -> tuple[SwapTerms, SwapSteps]:
    """The numbers of the b swaps that all paths share."""

    def bonds(held: constant_maturity.Held) -> tuple[Array, Array]:
        drift = constant_maturity.drift(scene, held, constant_maturity.load(scene, held))
        return constant_maturity.reach(held, scene.factors, scene.case.step), drift

    reach, drift = bonds(_held(scene.case))
    linked = (None, None)
    if _overlay(scene.case).inflation:
        linked = bonds(_linked(scene.case))
    return SwapTerms(reach, linked[0]), SwapSteps(drift, linked[1])


def swap_returns(case: PensionCase, terms: SwapTerms, steps: SwapSteps, now: Now) -> Array:
    """[b] log returns over cash of a step; swaps are in the fund's own currency."""
    own = now._replace(foreign=None)
    nominal = constant_maturity.over_cash(case, _held(case), terms.reach, steps.drift, own)
    if terms.linked is None:
        return nominal
    given = (terms.linked, steps.linked, own)
    linked = constant_maturity.over_cash(case, _linked(case), *given)  # pyright: ignore
    first = case.buckets - _overlay(case).inflation
    prices = jnp.log1p(jnp.exp(linked) - jnp.exp(nominal[first:]))
    return jnp.concatenate([nominal[:first], prices])


def swap_log_prices(case: PensionCase, inputs: dict[str, Any]) -> Float[Array, " b"]:
    """ln of today's price of the bond in each swap of rates; of inflation, of the index-linked
    bond over the nominal one."""
    years = _held(case).maturity * case.step
    first = case.buckets - _overlay(case).inflation
    nominal = log_bond(case.curve, inputs, years[:first])
    if first == case.buckets:
        return nominal
    prices = log_bond(case.inflation.break_even, inputs, years[first:])
    return jnp.concatenate([nominal, -prices])
