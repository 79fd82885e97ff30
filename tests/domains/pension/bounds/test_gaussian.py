"""What a unit of each investment is worth to a deflator: without prices of risk, what it costs."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.market_cases import CASH, assets, full, given

from snapo.domains.pension.bounds.best_mix import discounted_growth, gaussian_returns
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.market.assets.bond import Bond, CouponBond, IndexLinked
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.market import Correlation
from snapo.problem.problem import prepare


@pytest.mark.prove
def test_bonds_and_swaps_of_every_kind_are_worth_what_they_cost_under_q():
    """Par swaps, zero-coupon ones and swaps of inflation, whose returns are not Gaussian; on a path
    whose curve has moved."""
    classes = [
        CASH,
        CouponBond("Par", maturity=240),
        Bond("Zero", maturity=120),
        CouponBond("Five", maturity=90, coupon=0.05),
        IndexLinked("Linked", maturity=120),
    ]
    one = full(2, measure="Q", held_assets=assets(2, classes, weight=[0.2] * 5))
    assert one.overlay is not None
    swaps = replace(
        one.overlay,
        maturities=np.array([240, 120, 120]),
        notional=given("overlay_notional", np.zeros(3)),
        cost=given("overlay_cost", np.zeros(3)),
        low=np.zeros(3),
        high=np.ones(3),
        inflation=1,
        zero_coupon=(1,),
    )
    together = Correlation(("rate", "rate 2", "inflation"), given("correlation", [-0.2, 0.1, 0.3]))
    one = replace(one, overlay=swaps, correlation=together)
    simulator = PensionSimulator.of(one)
    with jax.enable_x64(True):
        schedule = prepare(simulator, pension_inputs(one))
        now = jax.tree.map(lambda leaf: leaf[1], schedule.steps)
        market = schedule.constants.market.start
        market = market._replace(factors=market.factors + jnp.array([0.01, -0.004, 0.003]))

        @jax.jit
        def unit(market):
            returns = gaussian_returns(one, schedule.constants, now, market)
            return discounted_growth(one, returns, jnp.zeros(returns.load.shape[-1]))

        found = unit(market)
    assert np.asarray(found.classes) == pytest.approx(np.ones(5), abs=1e-13)
    assert np.asarray(found.swaps) == pytest.approx(np.zeros(3), abs=1e-13)
