"""A gap to the target: level payments close it at a fixed end, a rolling share of it may never do."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.domains.pension.market_cases import (
    CASH,
    assets,
    case,
    cash_flows,
    curve,
    given,
    no_contribution,
    plan,
)  # fmt: skip

from snapo.domains.pension.fund.schedule import annuity
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.plan import Liability
from snapo.domains.pension.results.figures.plausible import remarks
from snapo.engine.native import Native
from snapo.problem.inputs import plain
from snapo.problem.policies.rules import Constant
from snapo.problem.problem import prepare
from snapo.problem.record.either import with_numpy
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact

RATE, YEARS, OWED = 0.0677, 5, 100.0
BEHIND: Any = SimpleNamespace(
    funding=0.8, liability=100.0, duration=30.0, hedge_ratio=None,
    rate={}, rate_volatility={}, returns={},
)  # fmt: skip


def fund(timing: str, horizon: int, years: float = YEARS, level: bool = True):
    """Cash of 80 against a debt of 100 in 30 years, both at a flat rate; yearly steps."""
    rule = no_contribution(kind="target", recovery_years=years)
    if level:
        rule = replace(rule, level_steps=round(years))
    return case(
        horizon,
        step=1.0,
        held_assets=assets(horizon, [CASH], weight=[1.0], amount=80.0),
        flows=cash_flows([OWED * np.exp(30 * RATE)], [30 if timing == "advance" else 29]),
        curve=curve("zero_rate", [1.0, 60.0], [RATE, RATE]),
        plan=plan(timing=timing, contribution=rule),
    )


def paths(one):
    """Contributions by step and the gap after the last one."""
    simulator, inputs = PensionSimulator.of(one), pension_inputs(one)
    draws = Pseudo(1).draws(np.arange(1), simulator)
    schedule = prepare(simulator, inputs)
    rolled = Native("float64").values(
        simulator, Constant(np.ones(1)), schedule, draws, Exact(), record=("outputs",)
    )
    paid = np.asarray(rolled.record["outputs"]["contribution"])[:, 0]
    return paid, -float(np.asarray(rolled.totals["surplus"])[0])


@pytest.mark.prove
@pytest.mark.parametrize("timing", ["advance", "arrears"])
def test_level_payments_are_an_annuity_and_end_the_gap(timing):
    """20 over five payments with interest; what a second period finds is nothing."""
    paid, left = paths(fund(timing, 7))
    first = 0 if timing == "advance" else 1
    worth = np.exp(-RATE * (first + np.arange(YEARS))).sum()
    assert paid[:YEARS] == pytest.approx(20 / worth, rel=1e-6)
    assert paid[YEARS:] == pytest.approx(0, abs=1e-4)
    assert left == pytest.approx(0, abs=1e-4)


@pytest.mark.prove
def test_a_share_of_what_is_left_can_be_less_than_its_interest():
    """A fifteenth a year against 7 % of interest, paid at the ends of years; check says so."""
    one = fund("arrears", 7, 15.0, level=False)
    paid, left = paths(one)
    growth = np.exp(RATE) - 1 / 15
    assert growth > 1
    assert left == pytest.approx(20 * growth**7, rel=1e-6)
    assert paid[0] == pytest.approx(20 / 15, rel=1e-6)
    (note,) = remarks(one, BEHIND)
    assert "bears interest of 7.0% a year" in note and 'recovery = "level"' in note
    for closing in (fund("arrears", 7, 10.0, level=False), fund("arrears", 7, 15.0)):
        assert remarks(closing, BEHIND) == []
    # The curve plus a spread is what the gap earns in a valuation on that basis.
    dear = Liability("spread", given("liability_rate", 0.04), "none")
    (note,) = remarks(replace(fund("arrears", 7, 10.0, False), liability=dear), BEHIND)
    assert "11.4% a year" in note


@pytest.mark.parametrize("basis", ["fixed", "spread"])
def test_level_payments_have_the_compounding_of_the_valuation(basis):
    """A rate of 5 % a year, or 2 % over an annual curve of 3 %: five payments in arrears; the note
    on a rolling share states the annual rate. Beyond all payments a period may also end."""
    rate = {"fixed": 0.05, "spread": 0.02}[basis]
    one = replace(
        fund("arrears", 7),
        curve=curve("zero_rate", [1.0, 60.0], [np.log(1.03)] * 2),
        liability=Liability(basis, given("liability_rate", rate), "none", True),
    )
    level = with_numpy(annuity)(one, {})
    assert level is not None
    assert level[0] == pytest.approx((1 - 1.05**-5) / 0.05, rel=1e-12)
    assert level[4] == pytest.approx(1 / 1.05, rel=1e-12)
    rolling = fund("arrears", 7, 25.0, level=False).plan
    (note,) = remarks(replace(one, plan=rolling), BEHIND)
    assert "bears interest of 5.0% a year" in note
    rule = replace(one.plan.contribution, level_steps=120)
    longest = replace(one, plan=replace(one.plan, contribution=rule))
    model = PensionSimulator.of(longest).model
    level = with_numpy(annuity)(model, plain(pension_inputs(longest)))
    assert level is not None
    assert level[0] == pytest.approx((1 - 1.05**-120) / 0.05, rel=1e-6)  # float32
