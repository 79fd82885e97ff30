"""Flows that are fixed days before their date, at the forward price of that moment."""

import datetime
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from tests.domains.energy.energy_cases import exact as exact_swing
from tests.domains.energy.energy_cases import swing
from tests.domains.gas_storage.references.linear_program import black_call
from tests.domains.gas_storage.storage_cases import read
from tests.lanes.in_numpy import in_numpy

from snapo.case.error import CaseError
from snapo.case.table import TableContext
from snapo.domains.gas_storage.read.nomination import nominated_on
from snapo.domains.gas_storage.references.lattice import refined
from snapo.domains.gas_storage.setup import bare_problem, factors, fitted_value, make_setup
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals, value_of_groups

# G4 with flows fixed one and two days before: Black (1976) with the deviation of the forward price
# at the nomination, computed apart from snapo.
G4 = {1: 9_930.853, 2: 9_438.289}


def nominated(days: int, **keys):
    return read("G4", contract={"nomination": {"days": days, **keys}})


@pytest.mark.parametrize("days", G4)
def test_three_calls_are_worth_black_at_the_nomination(days):
    case = nominated(days)
    problem = bare_problem(case)
    schedule = jax.tree.map(np.asarray, problem.schedule)
    volume = case.contract.ratchets.withdrawal.used()[:, 0]
    value = 0.0
    for t in np.flatnonzero(volume):
        deviation = np.sqrt(schedule.steps.price.variance[t])
        strike = case.contract.withdrawal_cost.used()[t]
        discount = schedule.steps.gas_discount[t]
        call = black_call(case.market.forward_curve.used()[t], strike, deviation, discount)
        value += volume[t] * float(call.value)
    assert value == pytest.approx(G4[days], abs=5e-4)


@pytest.mark.prove
@pytest.mark.parametrize("days", G4)
def test_lattice_and_policy_of_three_calls(days):
    case = nominated(days)
    problem = bare_problem(case)
    prices = factors(problem)
    assert prices is not None
    exact = refined(jax.tree.map(np.asarray, problem.schedule), prices, "linear").value
    assert exact == pytest.approx(G4[days], rel=2e-4)
    setup = make_setup(case, "native", fitted_value(problem))
    problem = setup.problem
    totals = path_totals(problem, setup.policy, 16_384, engine=setup.engines.evaluate)
    values = problem.objective, totals, problem.sources.evaluation
    shares = value_of_groups(*values, problem.simulator.control_variates())
    found = statistics.of_shares(shares)
    assert found.value == pytest.approx(G4[days], abs=2 * found.standard_error)


def test_the_derivative_with_respect_to_mean_reversion_goes_through_the_notice():
    """Of the loadings at the nomination, against central differences."""
    case = nominated(2)
    assert case.model.delivery.notice is not None
    process, (speed,) = case.model, case.model.mean_reversion.values

    def loading(x):
        numbers = replace(case.model.mean_reversion, values=np.array([x]))
        moved = replace(process, mean_reversion=numbers)
        inputs = {"volatility": process.volatility.values, "mean_reversion": numbers.values}
        inputs["forward_curve"] = case.market.forward_curve.values
        return in_numpy(moved.prepare)(inputs).steps.loading[100, 0]

    up, down = loading(speed + 1e-4), loading(speed - 1e-4)
    slope = (up - down) / 2e-4
    assert slope == pytest.approx(-2 / 365 * loading(speed), rel=1e-6)


def test_a_business_day_before():
    """The flows of Saturday to Monday are fixed on Friday; a holiday is no business day."""

    where = TableContext(Path(__file__), "contract", [])
    first = datetime.date(2026, 12, 22)  # a Tuesday
    dates = [first + datetime.timedelta(k) for k in range(9)]

    def fixed(days, *holidays):
        keys = {"days": days, "calendar": "business", "holidays": list(holidays)}
        found = nominated_on(where, SimpleNamespace(nomination=keys), dates)
        assert found is not None
        return [day.day for day in found]

    assert fixed(1, datetime.date(2026, 12, 25)) == [21, 22, 23, 24, 24, 24, 24, 28, 29]
    assert fixed(2) == [18, 21, 22, 23, 24, 24, 24, 25, 28]


def test_flows_of_one_nomination_meet_one_state():
    """No noise between the days of a weekend; before the valuation date all is known."""
    case = read(
        "quick", contract={"nomination": {"days": 1, "calendar": "business"}},
        market={"valuation_date": datetime.date(2025, 1, 1)},
    )  # fmt: skip
    steps = jax.tree.map(np.asarray, bare_problem(case).schedule).steps
    days = [day.strftime("%a") for day in case.days]
    still = np.flatnonzero(steps.price.next_shock[:-1, 0, 0] == 0)
    # Of the second day too, which is nominated on the valuation date like the first one.
    assert {days[t + 1] for t in still} == {"Sun", "Mon", days[1]}
    assert steps.price.variance[0] == 0


def test_a_nominated_swing_is_worth_less():
    """Without limits of a year each day is a call on its forward price."""
    keys = {"annual": None, "end": datetime.date(2026, 10, 31)}
    spot = exact_swing(swing(**keys))
    early = exact_swing(swing(**keys, nomination={"days": 3}))
    plan = exact_swing(swing(**keys), forward=True)
    assert plan < early < spot


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"objective": {"kind": "cvar", "level": 0.1}}, "the objective must be \"mean\""),
        ({"contract": {"nomination": {"days": 0}}}, "contract.nomination.days: got 0"),
        ({"contract": {"nomination": {"calendar": "bank"}}}, '"every-day" or "business"'),
        ({"model": {"kind": "regimes", "tightens": 0.05, "eases": 0.2, "premium": 0.4}},
         "with .contract. nomination it must be one of"),
    ],
)  # fmt: skip
def test_what_needs_the_spot_price_is_refused(changes, message):
    tables = {"contract": {"nomination": {"days": 1}}, **changes}
    with pytest.raises(CaseError, match=message):
        read("quick", **tables)
