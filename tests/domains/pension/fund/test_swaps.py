"""Swaps at the edges: none held, ranges of no width, limits as shares of the liability."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from tests.domains.pension.market_cases import cash_flows, full, given

from snapo.domains.pension.chapters.sensitivities import standard_move
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.policies.allocation import (
    AllocationLimits,
    limit_unit,
    notionals,
    present,
)
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.results import balance
from snapo.domains.pension.results.balance import Headroom
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.inputs import Input
from snapo.problem.policies.rules import Constant
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import pull_back

CLASSES = 7


def swaps(**changes):
    """The full case with other swaps; its limits are shares of the liability."""
    one = full(3)
    assert one.overlay is not None
    return replace(one, overlay=replace(one.overlay, **changes))


def places(one):
    """Where in their ranges the notionals of a new policy lie."""
    action = AllocationLimits(one)(jnp.asarray(present(one)), Exact())
    return np.asarray(action)[CLASSES:]


@pytest.mark.prove
@pytest.mark.parametrize("unit", ["assets", "liability"])
def test_a_new_policy_holds_about_the_present_notionals(unit):
    one = swaps(unit=unit)
    worth = limit_unit(one)
    if unit == "assets":
        assert worth.tolist() == [100.0, 100.0]
    else:
        # Payments of 40 years, nearest to 10 and to 20: most of the liability each.
        simulator = PensionSimulator.of(one)
        whole = float(prepare(simulator, pension_inputs(one)).constants.liability)
        assert worth.sum() == pytest.approx(whole, rel=1e-12)
    found = notionals(one, places(one), worth)
    assert found == pytest.approx([8.0, 10.0], rel=1e-5)


@pytest.mark.prove
def test_a_bucket_without_payments_or_without_a_range_starts_somewhere():
    one = replace(swaps(high=np.array([0.4, 0.0])), cash_flows=cash_flows([50.0], [59]))
    worth = limit_unit(one)
    assert worth[1] == 0 < worth[0]
    found = notionals(one, places(one), worth)
    assert found[0] == pytest.approx(8.0, rel=1e-5)
    assert found[1] == 0


@pytest.mark.prove
def test_headroom_of_receivers_of_payers_and_of_nothing():
    one = swaps()
    weights = np.array([0.05, 0.95, 0, 0, 0, 0, 0])  # cash counts in full, shares do not
    none, receive, pay = (
        balance.headroom(one, weights, np.array(notional)) or Headroom()
        for notional in ([0, 0], [8, 10], [-8, -10.0])
    )
    assert none.headroom is None
    years = np.arange(1, 11)
    zero = np.interp(years, one.curve.tenor, one.curve.rate.values)
    price = np.exp(-zero * years)
    due = (1 - price[-1]) / price.sum() + (years == 10)

    def gain(rise):
        return 8 * (due @ (price * np.exp(-rise * years)) - 1) + 10 * np.expm1(-20 * rise)

    assert receive.headroom == pytest.approx(1e4 * brentq(lambda x: 5 + gain(x), 0, 0.1))
    assert receive.direction == "rise"
    assert pay.headroom == pytest.approx(1e4 * brentq(lambda x: 5 - gain(-x), 0, 0.1))
    assert pay.direction == "fall"


def test_one_per_cent_of_nothing_is_a_unit():
    move = standard_move(Input(np.zeros(2)))
    assert move.size.tolist() == [1, 1]
    assert move.words == "1 unit"


@pytest.mark.study
def test_derivatives_where_no_swaps_are_held():
    """Nothing held and nothing wanted: both engines are finite, and at the kink of the trading
    cost the derivative by the notional is that of one more."""
    one = swaps(notional=given("overlay_notional", [0.0, 0.0]))
    simulator, inputs = PensionSimulator.of(one), pension_inputs(one)
    draws = Pseudo(4).draws(np.arange(4), simulator)
    policy = Constant(np.array([0, 0.2, 0.1, 0.1, 0.2, 0.2, 0.1, 0, 0]))
    weights: dict[str, Any] = {"funding_ratio": np.full(4, 0.25)}
    found = []
    for engine in (Xla("float64"), Native("float64")):
        schedule = prepare(simulator, inputs)
        passed = engine.adjoint(simulator, policy, schedule, draws, Exact(), weights)
        found.append(pull_back(simulator, inputs, [passed.schedule]))
        assert all(np.all(np.isfinite(each)) for each in found[-1].values())

    def value(notional):
        moved = inputs | {"overlay_notional": Input(np.array([notional, 0.0]))}
        schedule = prepare(simulator, moved)
        totals = Native("float64").values(simulator, policy, schedule, draws, Exact()).totals
        return np.mean(totals["funding_ratio"])

    up = value(1.0) - value(0.0)  # the cost is linear: a whole unit, so that round-off is small
    for each in found:
        assert each["overlay_notional"][0][0] == pytest.approx(up, rel=1e-9)
