"""Contribution and indexation rules: published moments, and each rule by hand."""

from typing import get_args, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.market_cases import CASH, assets, cash_flows, full
from tests.domains.pension.market_cases import case as hand_case
from tests.domains.pension.market_cases import plan as hand_plan
from tests.domains.pension.people_cases import contributing, given, indexing, people_case, plan

from snapo.domains.pension.fund.books import balance, opening
from snapo.domains.pension.fund.contributions import CONTRIBUTIONS
from snapo.domains.pension.fund.increases import INCREASES
from snapo.domains.pension.fund.plan import contribution, indexation, indexation_flags
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.fund.terms import plan_terms
from snapo.domains.pension.policies.classical import ConstantMix
from snapo.domains.pension.read.tables_people import ContributionTable, IndexationTable
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.market import SuppliedScenarios
from snapo.domains.pension.records.plan import CashPlan
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.inputs import plain
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact, Smooth

EXACT = Exact()


def terms_of(terms):
    case = people_case(plan=terms)
    with jax.enable_x64(True):
        return plan_terms(case, plain(pension_inputs(case)))


def paid(terms, assets=900.0, liability=1000.0, wage=1.1, step=1 / 12, smooth=EXACT):
    with jax.enable_x64(True):
        found = contribution(
            terms,
            terms_of(terms),
            assets=assets,
            liability=liability,
            normal_cost=10.0,
            payroll=50.0,
            wage=wage,
            step=step,
            smooth=smooth,
        )
    return float(found)


def test_spreading_the_deficit_has_the_moments_of_its_linear_recursion():
    """Spread method, yearly: F' = (1 + i)(F + C - B), C = NC + k (AL - F), of a fund of 80 against 100.

    Figures from the recursion of first and second moments, returns of mean 5 % and deviation 15 %.
    """
    rule = contributing(
        normal_cost="rate",
        rate=given("contribution_rate", 3.238095),
        spread_factor=given("contribution_spread_factor", 0.1233376904),
    )
    terms = plan(contribution=rule)
    paths, years = 2**16, 30
    variance = np.log1p((0.15 / 1.05) ** 2)
    draws = np.random.default_rng(5).standard_normal((years, paths // 2))
    shocks = np.concatenate([draws, -draws], axis=1)
    returns = 1.05 * np.exp(np.sqrt(variance) * shocks - variance / 2)
    with jax.enable_x64(True):
        numbers = terms_of(terms)

        def paid_now(fund):
            return contribution(
                terms,
                numbers,
                assets=fund,
                liability=100.0,
                normal_cost=0.0,
                payroll=jnp.ones_like(fund),
                wage=1.0,
                step=1.0,
                smooth=EXACT,
            )

        fund = jnp.full(paths, 80.0)
        for year, growth in enumerate(returns, start=1):
            fund = growth * (fund + paid_now(fund) - 8.0)
            if year == 10:
                ten = np.asarray(fund), np.asarray(paid_now(fund))
        thirty = np.asarray(fund), np.asarray(paid_now(fund))
    expected = {10: (91.265333, 29.986620, 4.315409), 30: (98.333985, 37.356953, 3.443578)}
    for (funds, flows), (mean, deviation, flow) in zip((ten, thirty), expected.values()):
        error = deviation / np.sqrt(paths)
        assert abs(funds.mean() - mean) < 3 * error
        assert abs(flows.mean() - flow) < 3 * 0.1233376904 * error
        centred = (funds - funds.mean()) ** 2
        spread = centred.std() / np.sqrt(paths) / (2 * deviation)
        assert abs(funds.std() - deviation) < 3 * spread


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        (contributing("none"), 0.0),
        (contributing("fixed"), 0.2 * 55),
        (contributing("normal-cost"), 10.5),
        (contributing("normal-cost", normal_cost="rate"), 11.0),
        (contributing("spread"), 10.5 + 0.1 * 100 / 12),
        (contributing("target"), 10.5 + 200 / 8 / 12),
        (contributing("spread", has_cap=True, cap=given("contribution_cap", 0.15)), 8.25),
        (contributing("spread", has_floor=True, floor=given("contribution_floor", 0.5)), 27.5),
        (
            contributing(
                has_sponsor_limit=True, sponsor_limit=given("contribution_sponsor_limit", 60.0)
            ),
            5.5,
        ),
    ],
)
def test_each_rule_by_hand(rule, expected):
    assert paid(plan(contribution=rule)) == pytest.approx(expected, rel=1e-12)


def test_a_surplus_is_spread_too_but_no_target_pays_back():
    assert paid(plan(), assets=1300.0) == pytest.approx(10.5 - 0.1 * 300 / 12)
    assert paid(plan(contribution=contributing("target")), assets=1300.0) == pytest.approx(10.5)


def granted(rule, ratio, growth, smooth=EXACT):
    terms = plan(indexation=rule)
    with jax.enable_x64(True):
        found = indexation(terms, terms_of(terms), ratio=ratio, price_growth=growth, smooth=smooth)
    return tuple(map(float, found))


@pytest.mark.parametrize(
    ("kind", "ratio", "growth", "expected"),
    [
        ("none", 1.3, 0.02, 0.0),
        ("full", 1.3, 0.05, 0.05),
        ("full", 1.3, -0.01, -0.01),
        ("capped", 1.3, 0.05, 0.03),
        ("capped", 1.3, -0.01, 0.0),
        ("conditional", 1.0, 0.02, 0.0),
        ("conditional", 1.15, 0.02, 0.01),
        ("conditional", 1.3, 0.02, 0.02),
    ],
)
def test_indexation_by_hand(kind, ratio, growth, expected):
    assert granted(indexing(kind), ratio, growth) == pytest.approx((expected, 0.0), abs=1e-15)


def test_cuts_are_spread_over_years():
    assert granted(indexing(), 0.9, 0.02) == pytest.approx((0.0, 0.1 / 5))
    assert granted(indexing(cut_years=0), 0.9, 0.02) == (0.0, 0.0)


def test_smooth_rules_tend_to_the_exact_ones():
    for ratio in (0.95, 1.05, 1.25):
        rough = granted(indexing(), ratio, 0.03, Smooth(1e-3))
        assert rough == pytest.approx(granted(indexing(), ratio, 0.03), abs=1e-5)
    rule = plan(contribution=contributing("target", has_cap=True))
    assert paid(rule, smooth=Smooth(1e-3)) == pytest.approx(paid(rule), rel=1e-3)


def test_increases_fall_on_the_first_of_the_month():
    case = people_case(30, start_month=4, plan=plan(indexation=indexing(month=7, averaging=6)))
    due, averaging = indexation_flags(case)
    # Steps from April on: the third ends on the first of July.
    np.testing.assert_array_equal(np.flatnonzero(due), [2, 14, 26])
    np.testing.assert_allclose(averaging[:3], 1 / 3)
    np.testing.assert_allclose(averaging[9:15], 1 / 6)
    np.testing.assert_array_equal(averaging[3:9], 0)
    yearly = people_case(5, step=1.0)
    assert all(np.all(flags == 1) for flags in indexation_flags(yearly))


def test_the_format_has_the_kinds_that_the_rules_have():
    assert get_args(get_type_hints(ContributionTable)["kind"]) == tuple(CONTRIBUTIONS)
    assert get_args(get_type_hints(IndexationTable)["kind"]) == tuple(INCREASES)


@pytest.mark.prove
@pytest.mark.parametrize("engine", [Xla, Native])
def test_payments_agreed_in_money_are_paid_on_top_whatever_the_limits(engine):
    """A closed plan with a cap in shares of salaries, which are zero, gets its recovery plan."""
    agreed = CashPlan(given("contribution_schedule", [3.0, 4.0, 5.0]), np.array([1, 1, 4]))
    capped = {"has_cap": True, "schedule": agreed}
    rule = contributing("spread", normal_cost="rate", **capped)
    case = full(6, plan=hand_plan(contribution=rule), flows=cash_flows([200.0], [30]))
    simulator = PensionSimulator.of(case)
    draws = Pseudo(1).draws(np.arange(8), simulator)
    schedule = prepare(simulator, pension_inputs(case))
    made = engine("float64").values(
        simulator, ConstantMix(case), schedule, draws, EXACT, record=("outputs",)
    )
    paid = np.asarray(made.record["outputs"]["contribution"])
    assert paid[:, 0] == pytest.approx([0, 7, 0, 0, 5, 0])


def test_the_value_of_an_accrual_on_ready_made_paths_is_the_normal_cost():
    """5 at 2 %, discounted once; and by hand the share of the second accrual in the value of two,
    when the first payment of one has been made."""
    table = np.zeros((1, 2, 5))
    columns = ("return Cash", "inflation", "wage", "zero 1", "zero 10")
    one = hand_case(
        2,
        step=1.0,
        held_assets=assets(2, [CASH], weight=[1.0]),
        flows=cash_flows([40.0, 45.0, 400.0], [1, 2, 15], normal_cost=5.0),
        plan=hand_plan(accruing=True),
        scenarios=SuppliedScenarios(table, table, columns, np.array([1.0, 10.0])),
    )
    simulator = PensionSimulator.of(one)
    schedule = prepare(simulator, pension_inputs(one))
    terms, steps = schedule.constants, schedule.steps
    people = jax.tree.map(lambda rows: rows[0], steps.people)
    books = balance(simulator.model, terms, people, steps.shape[0], opening(terms))
    assert float(books.accrual) == pytest.approx(5.0, rel=1e-6)
    v = np.exp(-0.02)
    first, second = 45 * v + 400 * v**14, 40 * v + 45 * v**2 + 400 * v**15
    assert steps.people.mix == pytest.approx([1, second / (first + second)], rel=1e-6)
