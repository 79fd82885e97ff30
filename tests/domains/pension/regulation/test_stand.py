"""A fund of one payment, one bond and shares before the Dutch regulator, by hand."""

import datetime
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.domains.pension.market_cases import CASH, assets, case, cash_flows, curve, given

from snapo.domains.pension.market.assets.bond import Bond, CouponBond
from snapo.domains.pension.read.cells import TableReader
from snapo.domains.pension.read.tables import RegulationTable
from snapo.domains.pension.records.assets import Overlay
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.plan import Liability
from snapo.domains.pension.regulation.bases import due
from snapo.domains.pension.regulation.in_force import read_regulation
from snapo.domains.pension.regulation.position import recovery, regulation_of, shocked, stand
from snapo.problem.inputs import plain


def fund(**keys):
    """A payment after 20 years at 2 %; a 10-year bond and cash; cash counts as shares here."""
    place = TableReader(Path("case.toml"), "regulation", [], set())
    table = RegulationTable(**({"rules": "dutch-ftk"} | keys))
    held = assets(1, [CASH, Bond("Bond", maturity=10)], weight=[0.4, 0.6])
    one = case(
        1,
        step=1.0,
        held_assets=replace(held, risk=("developed", "none"), amount=given("assets", 80.0)),
        flows=cash_flows([100.0], [19]),
        curve=curve("zero_rate", [1.0, 30.0], [np.log(1.02)] * 2),
        liability=Liability("risk-free", given("liability_rate", 0.0), "none"),
    )
    rules = read_regulation(place, table, datetime.date(2024, 12, 31))
    return replace(one, regulation=rules)


@pytest.mark.prove
def test_required_own_funds_of_a_small_fund():
    one = fund(insurance_risk=0.03)
    found = stand(one, plain(pension_inputs(one)))
    liability = 100 * 1.02**-20
    raised = 100 * (1 + 0.02 * 0.76) ** -20 - liability
    gain = ((1 + 0.02 * 0.75) / 1.02) ** -10 - 1
    own = 0.0
    for _ in range(100):
        held = liability + own
        s1, s2, s6 = raised - 0.6 * held * gain, 0.3 * 0.4 * held, 0.03 * liability
        own = np.sqrt(s1**2 + s2**2 + 0.8 * s1 * s2 + s6**2)
    assert found.required == pytest.approx(own, rel=1e-10)
    assert found.losses.falling
    assert found.required_ratio == pytest.approx(1 + own / liability, rel=1e-10)
    assert found.policy_ratio == pytest.approx(80 / liability, rel=1e-12)
    assert (found.minimum_ratio, found.minimum / liability) == (1.04, pytest.approx(0.04))


def test_coupon_bonds_and_par_swaps_move_by_their_payments():
    """Of rates of 2 %, every payment at the factor of its own term; a par swap is
    a bond with the coupon of 2 %."""
    bond = CouponBond("Bond", maturity=10, coupon=0.05)
    one = fund(insurance_risk=0.0)
    swap = Overlay(
        maturities=np.array([20]),
        notional=given("overlay_notional", [5.0]),
        low=np.zeros(1),
        high=np.ones(1),
        unit="assets",
        leverage=given("overlay_leverage", 2.0),
        cost=given("overlay_cost", [0.0]),
        collateral_stress=given("overlay_collateral_stress", 0.035),
    )
    one = replace(one, assets=replace(one.assets, classes=(CASH, bond)), overlay=swap)
    rules, inputs = regulation_of(one).rules, plain(pension_inputs(one))
    found = shocked(one, inputs, due(one, inputs), "fall")

    def change(coupon, years):
        times = np.arange(1, years + 1)
        amount = coupon + (times == years)
        rates = 0.02 * np.interp(times, rules.term, rules.factors["fall"])
        return amount @ (1 + rates) ** -times / (amount @ 1.02**-times) - 1

    assert found.classes == pytest.approx([0, change(0.05, 10)], rel=1e-12)
    assert found.swaps == pytest.approx([change(0.02, 20)], rel=1e-12)


def test_the_way_to_recover_is_that_of_twelve_month_means():
    one = replace(fund(policy_ratios=[0.9] * 11 + [1.0]), step=1 / 12, steps=24)
    rising = np.linspace(1.0, 1.24, 25)[:, None] * np.array([1.0, 0.5])
    rising[0] = 1.0
    found = recovery(one, rising, 1.0)
    assert found.years == (0, 1, 2)
    policy = [(11 * 0.9 + 1.0) / 12, rising[1:13, 0].mean(), rising[13:25, 0].mean()]
    low = [policy[0], rising[1:13, 1].mean(), rising[13:25, 1].mean()]
    assert found.median == pytest.approx(np.mean([policy, low], 0))
    assert found.share == (0.0, 0.5, 0.5)
