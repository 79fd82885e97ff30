"""How far rates may rise until the eligible assets no longer back the swaps: both sides revalued."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from tests.domains.pension.market_cases import CASH, assets, case, curve, given

from snapo.domains.pension.fund.books import opening
from snapo.domains.pension.fund.collateral import stressed
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.fund.trading import trade
from snapo.domains.pension.market.assets.bond import Bond
from snapo.domains.pension.policies.allocation import AllocationLimits
from snapo.domains.pension.records.assets import Overlay
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.results.balance import Headroom, headroom
from snapo.problem.problem import prepare
from snapo.problem.smooth import Exact


def fund(gilts: float, cash: float, swap: float, zero_coupon=(0,)):
    """Gilts and swaps of 20 years, and cash; a rise of x is worth exp(-20 x) to a zero-coupon."""
    amount = gilts + cash
    held = assets(
        1,
        [CASH, Bond("Gilts", maturity=20, eligible=1.0)],
        weight=np.array([cash, gilts]) / amount,
        amount=amount,
    )
    return case(
        1,
        step=1.0,
        held_assets=held,
        curve=curve("zero_rate", [1.0, 30.0], [0.03, 0.03]),
        overlay=Overlay(
            maturities=np.array([20]),
            notional=given("overlay_notional", [swap]),
            low=np.zeros(1),
            high=np.ones(1),
            unit="assets",
            leverage=given("overlay_leverage", 2.0),
            cost=given("overlay_cost", [0.0]),
            collateral_stress=given("overlay_collateral_stress", 0.035),
            zero_coupon=zero_coupon,
        ),
    )


@pytest.mark.prove
@pytest.mark.parametrize(
    ("gilts", "cash", "swap", "rise"),
    [
        # 30 e + 10 = 50 (1 - e) and 200 e - 100 = 1 - e, with e = exp(-20 rise).
        (30.0, 10.0, 50.0, np.log(80 / 40) / 20),
        (200.0, -100.0, 1.0, np.log(201 / 101) / 20),
    ],
)
def test_gilts_fall_with_the_swaps_that_they_back(gilts, cash, swap, rise):
    one = fund(gilts, cash, swap)
    found = headroom(one, one.assets.weight.used(), np.array([swap])) or Headroom()
    assert found.headroom == pytest.approx(1e4 * rise, rel=1e-9)


@pytest.mark.prove
def test_par_swaps_lose_what_their_payments_do():
    """A 20-year bond at par pays exp(0.03) - 1 a year."""
    one, years = fund(30.0, 10.0, 50.0, ()), np.arange(1, 21)
    due = np.expm1(0.03) + (years == 20)

    def left(rise):
        fixed = due @ np.exp(-(0.03 + rise) * years)
        return 30 * np.exp(-20 * rise) + 10 - 50 * (1 - fixed)

    found = headroom(one, one.assets.weight.used(), np.array([50.0])) or Headroom()
    assert found.headroom == pytest.approx(1e4 * brentq(left, 0.0, 0.2, xtol=1e-15), rel=1e-9)
    assert found.pv01 == pytest.approx(1e-4 * 50 * (due @ (years * np.exp(-0.03 * years))))


@pytest.mark.prove
@pytest.mark.parametrize("zero_coupon", [(), (0,)])
def test_the_policy_and_the_count_of_a_path_see_the_same_need(zero_coupon):
    """At a stress of the headroom itself a policy may hold these swaps and not one more, and the
    simulator counts what is beyond them."""
    one = fund(30.0, 10.0, 30.0, zero_coupon)
    weights, overlay = one.assets.weight.used(), one.overlay
    assert overlay is not None
    known = headroom(one, weights, np.array([30.0])) or Headroom()
    stress = given("overlay_collateral_stress", 1e-4 * known.headroom)
    one = replace(one, overlay=replace(overlay, collateral_stress=stress))
    cover = AllocationLimits(one).cover
    assert cover is not None
    wanted = np.array([1.0])
    with jax.enable_x64(True):
        place = np.asarray(cover(jnp.asarray(wanted), jnp.asarray(weights), Exact()))
        assert place == pytest.approx(30.0 / 40.0, rel=1e-9)
        schedule = prepare(PensionSimulator.of(one), pension_inputs(one))
        state, action = opening(schedule.constants), jnp.asarray([*weights, 1.0])
        held = trade(one, schedule.constants, state, action, 40.0, None, Exact())
    beyond = stressed(one, 1e-4 * known.headroom).need[0] * 10.0
    assert float(held.collateral_shortfall) == pytest.approx(beyond, rel=1e-9)


def test_assets_that_outlast_any_rise_are_enough():
    one = fund(30.0, 60.0, 50.0)
    found = headroom(one, one.assets.weight.used(), np.array([50.0])) or Headroom()
    assert found.headroom is None and found.enough
