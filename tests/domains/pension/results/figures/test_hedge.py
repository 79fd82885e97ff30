"""A closed gap of durations is a hedge ratio of 100 %."""

import numpy as np
import pytest
from tests.domains.pension.market_cases import CASH, assets, case, cash_flows, curve, given

from snapo.domains.pension.market.assets.bond import Bond
from snapo.domains.pension.records.assets import Overlay
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.results.figures.human import human
from snapo.domains.pension.results.figures.reconcile import figures
from snapo.problem.inputs import plain


@pytest.mark.prove
def test_a_par_swap_of_the_missing_duration_hedges_in_full():
    """Flat 3 % a year: half of 1,100 in 10-year bonds, 1,200 owed in 15 years. Macaulay's duration
    of a 20-year bond at par is (1 + y) / y (1 - (1 + y)^-20), 15.32 years: 815.7 of it close the
    gap of 1,200 * 15 - 550 * 10."""
    years = 1.03 / 0.03 * (1 - 1.03**-20)
    assert 815.7 * years == pytest.approx(1200 * 15 - 550 * 10, rel=1e-4)
    held = assets(1, [CASH, Bond("Bonds", maturity=10)], weight=[0.5, 0.5], amount=1100.0)
    one = case(
        1,
        step=1.0,
        held_assets=held,
        flows=cash_flows([1200 * 1.03**15], [14]),
        curve=curve("zero_rate", [1.0, 30.0], [np.log(1.03)] * 2),
        overlay=Overlay(
            maturities=np.array([20]),
            notional=given("overlay_notional", [815.7]),
            low=np.zeros(1),
            high=np.ones(1),
            unit="assets",
            leverage=given("overlay_leverage", 2.0),
            cost=given("overlay_cost", [0.0]),
            collateral_stress=given("overlay_collateral_stress", 0.035),
        ),
    )
    inputs = plain(pension_inputs(one))
    found = human(one, inputs, figures(one, inputs))
    assert found.liability == pytest.approx(1200, rel=1e-12)
    assert found.hedge_ratio == pytest.approx((550 * 10 + 815.7 * years) / 18000, rel=1e-9)
    assert found.hedge_ratio == pytest.approx(1.0, abs=1e-4)
