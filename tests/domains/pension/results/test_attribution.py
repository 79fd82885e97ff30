"""What moves the funding ratio: parts that add up to its change, and what each of them is."""

from dataclasses import replace

import numpy as np
import pytest
from tests.domains.pension.market_cases import (
    CASH,
    EQUITY,
    assets,
    case,
    cash_flows,
    full,
    given,
    no_contribution,
    plan,
)

from snapo.domains.pension.chapters.attribution import ROWS, Explained
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.engine.native import Native
from snapo.problem.policies.rules import Constant
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact


def explained(one, action, paths=4):
    """{part side: [paths]} of a case under a constant action, and F before and after."""
    simulator = Explained.of(one)
    schedule = prepare(simulator, pension_inputs(one))
    draws = Pseudo(2).draws(np.arange(paths), simulator)
    policy = Constant(np.asarray(action))
    rolled = Native("float64").values(simulator, policy, schedule, draws, Exact())
    totals = {name: np.asarray(total) for name, total in rolled.totals.items()}
    start = float(schedule.constants.assets / schedule.constants.liability)
    return totals, start, totals.pop("funding_ratio")


@pytest.mark.prove
def test_the_parts_add_up_on_every_path():
    """Bonds, credit, currencies, swaps, costs, contributions and conditional indexation at once."""
    granted = given("indexation_lower_ratio", 0.5)
    one = full(7)
    one = replace(
        one, plan=replace(one.plan, indexation=replace(one.plan.indexation, lower_ratio=granted))
    )
    totals, start, final = explained(one, [0.0, 0.2, 0.1, 0.1, 0.2, 0.2, 0.1, 0.5, 0.6])
    keys = {key for key, _ in ROWS}
    assert {name.split()[0] for name in totals} == keys
    assert sum(totals.values()) == pytest.approx(final - start, abs=1e-13)
    for name in ("rates", "credit", "assets", "accrual", "benefits", "costs", "interest"):
        assert np.all(totals[f"{name} assets"] != 0)
    for name in ("rates", "benefits", "interest", "indexation"):
        assert np.any(totals[f"{name} liability"] != 0)
    for name in ("accrual", "mortality"):  # cash flows are given: nobody accrues, nobody dies
        assert np.all(totals[f"{name} liability"] == 0)


@pytest.mark.prove
def test_in_a_market_that_stands_still_every_part_is_known():
    """Flat rates of 2 %, no volatility: nothing comes from rates, and one step is done by hand."""
    held = assets(1, [CASH, EQUITY], mean=[0.03], volatility=[0.0], weight=[0.5, 0.5])
    flows = cash_flows([2.0, 2.0, 80.0], [0, 1, 119])
    one = case(1, held_assets=held, flows=flows, plan=plan(contribution=no_contribution("spread")))
    totals, start, final = explained(one, [0.0, 0.5])
    owed = 100 / start
    later = (owed * np.exp(0.02 / 12)) - 2.0
    through_assets = (1 / owed + 1 / later) / 2
    paid = 0.1 / 12 * (owed - 100.0)
    earned = 100 * np.expm1(0.02 / 12)
    over = 100 * 0.5 * (np.exp(0.05 / 12) - np.exp(0.02 / 12))
    after = 100 + earned + over + paid - 2.0
    through_liability = -(100 + after) / (2 * owed * later)
    assert final == pytest.approx(after / later, rel=1e-12)
    want = {
        "accrual assets": paid * through_assets,
        "benefits assets": -2.0 * through_assets,
        "interest assets": earned * through_assets,
        "assets assets": over * through_assets,
        "benefits liability": -2.0 * through_liability,
        "interest liability": owed * np.expm1(0.02 / 12) * through_liability,
    }
    for name, total in totals.items():
        assert total == pytest.approx(want.get(name, 0.0), abs=1e-12), name
