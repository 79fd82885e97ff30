"""One path: costs against closed forms, both engines, derivatives against differences."""

from dataclasses import replace
from operator import attrgetter

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm, poisson
from tests.domains.inventory.inventory_cases import case, optimised
from tests.domains.inventory.references.backlog import base_stock_cost

from snapo.domains.inventory.item.simulator import InventorySimulator
from snapo.domains.inventory.policy.rules import Classical
from snapo.domains.inventory.read.case import read_case
from snapo.domains.inventory.setup import first_policy
from snapo.engine import Native, Xla
from snapo.problem.objective import Mean
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Sources
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact, Smooth
from snapo.solver.adjoint import value_and_gradient
from snapo.solver.certificate import certify_derivatives, in_the_mean
from snapo.solver.derivatives.interval import Verdict
from snapo.solver.evaluate import evaluate

NORMAL = {"kind": "normal", "mean": 5.0, "deviation": 1.6}
ENDLESS = 1e6


def problem(of) -> Problem:
    return Problem(InventorySimulator.of(of), of.inputs(), Mean("result"))


def base_stock(of: Problem, level: float) -> Classical:
    """Up to `level`, which the rule counts from the level of the simulator."""
    own = float(of.schedule.steps["level"][0])
    numbers = [jnp.asarray(x) for x in (level - own, ENDLESS, ENDLESS)]
    return Classical(*numbers, action=of.action)


@pytest.mark.prove
@pytest.mark.parametrize("lead, shortage", [(0, 9.0), (1, 9.0), (4, 4.0)])
def test_base_stock_costs_its_closed_form_where_demand_waits(lead, shortage):
    """At the best level and beside it. From the level on, the position is always raised to it."""
    horizon = {"periods": 20, "warm_up": 10}
    of = problem(case(NORMAL, unmet="waits", lead_time=lead, shortage=shortage, horizon=horizon))
    engine = Xla()
    for off in (0.0, 1.5):
        level = float(of.schedule.steps["level"][0]) + off
        expected = base_stock_cost(level, 5.0, 1.6, lead, 1.0, shortage)
        found = evaluate(of, base_stock(of, level), paths=16384, engine=engine)
        assert abs(-found.value - expected) < 4 * found.standard_error
        assert found.standard_error < 0.005 * expected


@pytest.fixture(scope="module")
def small():
    """Lost sales of whole demand with two periods of lead time, and its first policy."""
    given = case(lead_time=2, stock=10.0, coming=[5.0], horizon={"periods": 6, "warm_up": 1})
    of = problem(given)
    return of, first_policy(of, given, 0)


@pytest.mark.prove
def test_both_engines_agree_and_the_adjoint_is_the_difference(small):
    of, policy = small
    smooth = Smooth(jnp.asarray(0.05))
    values = [
        value_and_gradient(of, policy, paths=512, smooth=smooth, engine=engine)
        for engine in (Xla("float64"), Native("float64"))
    ]
    assert values[0][0] == pytest.approx(values[1][0], rel=1e-10)
    for name, slope in values[0][1].inputs.items():
        assert slope == pytest.approx(values[1][1].inputs[name], rel=1e-8, abs=1e-12)
    costs = [of.inputs_by_name[name] for name in ("holding_cost", "shortage_cost")]
    for name, given in zip(("holding_cost", "shortage_cost"), costs):
        step, ends = 1e-4, []
        for way in (1, -1):
            moved = of.at({name: given.value + way * step})
            own = replace(moved, objective=Mean("result"))
            ends.append(
                evaluate(own, policy, paths=512, smooth=smooth, engine=Xla("float64")).value
            )
        slope = (ends[0] - ends[1]) / (2 * step)
        assert values[0][1].inputs[name] == pytest.approx(slope, rel=1e-5, abs=1e-7), name


@pytest.mark.prove
def test_a_season_moves_the_level_and_demand_and_both_engines_see_it(tmp_path):
    (tmp_path / "s.csv").write_text("period,factor\nsummer,0.5\nwinter,1.5\n")
    item = {"unmet": "waits", "lead_time": 1, "holding": 1.0, "shortage": 4.0}
    given = read_case(
        tmp_path / "case.toml",
        {"kind": "inventory", "item": item, "demand": NORMAL, "season": {"file": "s.csv"},
         "horizon": {"periods": 4, "warm_up": 0}},
    )  # fmt: skip
    of = problem(given)
    # Every two periods have a summer and a winter in them, and so the same level.
    assert of.schedule.steps["mean"] == pytest.approx(np.array([[2.5, 7.5], [7.5, 2.5]] * 2))
    assert np.ptp(of.schedule.steps["level"]) == pytest.approx(0)
    smooth, policy = Smooth(jnp.asarray(0.02)), first_policy(of, given, 0)
    (first, one), (second, other) = (
        value_and_gradient(of, policy, paths=128, smooth=smooth, engine=engine)
        for engine in (Xla("float64"), Native("float64"))
    )
    assert first == pytest.approx(second, rel=1e-10)
    assert one.inputs["season"] == pytest.approx(other.inputs["season"], rel=1e-8)


@pytest.mark.prove
def test_with_a_cost_of_an_order_derivatives_go_through_whether_there_is_one(monkeypatch):
    """Sixteen times: the adjoint less a difference of the smooth value on the same paths, by where
    orders begin, their size and the mean demand; without forgetting, which bends them a little.
    """
    optimised(monkeypatch)
    monkeypatch.setattr("snapo.domains.inventory.item.simulator.memory", lambda case: 1e12)
    given = case(unmet="waits", lead_time=1, shortage=9.0, order=10.0,
                 horizon={"periods": 12, "warm_up": 0})  # fmt: skip
    policy = first_policy(problem(given), given, 0)
    smooth, engine, paths = Smooth(jnp.asarray(0.02)), Native("float64"), 32768
    off = []
    for seed in range(16):
        of = replace(problem(given), sources=Sources.of(None, seed))
        slope = value_and_gradient(of, policy, paths=paths, smooth=smooth, engine=engine)[1]

        def value(policy=policy, of=of, **moved):
            return evaluate(of.at(moved), policy, paths=paths, smooth=smooth, engine=engine).value

        found = {"demand_mean": (value(demand_mean=5.1) - value(demand_mean=4.9)) / 0.2}
        for name in ("wait", "first"):
            ways = [
                eqx.tree_at(attrgetter(name), policy, getattr(policy, name) + step)
                for step in (0.1, -0.1)
            ]
            found[name] = (value(ways[0]) - value(ways[1])) / 0.2
        own = {"wait": slope.policy.wait, "first": slope.policy.first, **slope.inputs}
        off.append([float(np.sum(own[name])) - found[name] for name in found])
    error = np.std(off, axis=0, ddof=1) / np.sqrt(len(off))
    assert np.all(error < [0.04, 0.02, 0.02])  # of -1.19, -.06 and .29
    assert np.all(np.abs(np.mean(off, axis=0)) < 3 * error)
    other = [
        value_and_gradient(of, policy, paths=256, smooth=smooth, engine=each)[1].inputs
        for each in (engine, Xla("float64"))
    ]
    for name, slope in other[0].items():
        assert slope == pytest.approx(other[1][name], rel=1e-8, abs=1e-12), name


@pytest.mark.prove
def test_the_held_derivative_by_the_mean_is_unbiased(small):
    """Orders held, demand whole: against a difference over many paths, within their errors.

    The rule orders a constant amount, so that nothing reacts to the mean but demand itself.
    """
    of, _ = small
    rule = Classical(jnp.asarray(ENDLESS), jnp.asarray(5.0), jnp.asarray(ENDLESS), action=of.action)
    engine, paths, step = Xla("float64"), 16384, 0.25
    slope = value_and_gradient(of, rule, paths=paths, decisions="held", engine=engine)[1]
    ends = [evaluate(of.at({"demand_mean": 5.0 + d}), rule, paths=paths, engine=engine).value
            for d in (step, -step)]  # fmt: skip
    difference = (ends[0] - ends[1]) / (2 * step)
    assert float(np.sum(slope.inputs["demand_mean"])) == pytest.approx(difference, rel=0.03)


@pytest.mark.prove
def test_moments_of_whole_demand_are_certified_in_the_mean(small):
    """No path moves with them a little; a move by a hundredth on many paths judges the derivative."""
    of, policy = small
    assert of.simulator.in_mean() == ("demand_mean",)
    found = {bump.input for bump in certify_derivatives(of, policy, paths=16)}
    assert found == set(of.inputs_by_name) - {"demand_mean"}
    near, far = (
        Verdict(source, (-0.05 - r, 0.0), (-0.05, 0.01), (r, 0.01), -0.05, -0.05, 0.01, 1.0, True)
        for source, r in (("held", 0.01), ("not known", 0.04))
    )
    rows = [in_the_mean(of, {"demand_mean": verdict})[0] for verdict in (near, far)]
    assert [row["passed"] for row in rows] == [True, False]
    # Per unit of demand: the move was a hundredth of five.
    assert rows[0]["worst_error"] == pytest.approx(0.01 / 0.05)
    assert rows[0]["allowed"] == pytest.approx(0.04 / 0.05)  # four standard errors
    assert in_the_mean(of, {}) == []
    normal = problem(case(NORMAL, horizon={"periods": 4, "warm_up": 0}))
    assert normal.simulator.in_mean() == ()


@pytest.mark.prove
def test_the_mean_of_whole_demand_has_a_smooth_derivative_near_that_of_the_value():
    """A Poisson demand of 5, lost, with the first rule. Whole orders follow its level in steps: by
    differences over .1 and .25 the exact value's derivative is -.55 and -.75, so .15 is allowed.
    Where demand was not spread in training, the derivative was -1.45.
    """
    item = case(lead_time=3, shortage=9.0, horizon={"periods": 30, "warm_up": 10})
    of = problem(item)
    policy = first_policy(of, item, 0)
    engine, smooth = Native("float64"), Smooth(jnp.asarray(0.01))
    slope = value_and_gradient(of, policy, paths=16384, smooth=smooth, engine=engine)[1]
    ends = [evaluate(of.at({"demand_mean": mean}), policy, paths=65536, engine=engine)
            for mean in (5.25, 4.75)]  # fmt: skip
    found = float(slope.inputs["demand_mean"])
    assert found == pytest.approx((ends[0].value - ends[1].value) / 0.5, abs=0.15)


def test_a_shortage_below_half_a_unit_is_a_shortage():
    """Whole demand with real orders: 8 are demanded of 7.7."""
    of = problem(case(lead_time=0, whole=False, horizon={"periods": 2, "warm_up": 0}))
    schedule, between = of.schedule, (poisson.cdf(7, 5.0) + poisson.cdf(8, 5.0)) / 2
    eight, state = jnp.array([norm.ppf(between)]), {"stock": jnp.zeros(()), "missed": jnp.zeros(())}
    shown = []
    for order in (7.0, 7.7, 8.0):
        orders = jnp.array([order])
        now = at(schedule.steps, 0)
        _, outputs = of.simulator.step(schedule.constants, now, state, orders, eight, Exact())
        shown.append(2 * float(outputs["short"]))  # the average over two periods
    assert shown == [1.0, 1.0, 0.0]


def test_periods_without_shortage_at_a_real_level_are_the_distribution_of_demand():
    """With 7.7 units in every period, demand of 8 is not met: F(7) = 86.7 %, not F(8) = 93.2 %."""
    of = problem(case(lead_time=0, whole=False, horizon={"periods": 20, "warm_up": 0}, stock=0.0))
    draws = of.sources.evaluation.draws(np.arange(1024), of.simulator)
    totals = Xla("float64").bind(of).values(base_stock(of, 7.7), draws, Exact()).totals
    short, n = float(np.mean(totals["short"])), 20 * 1024
    expected = float(poisson.sf(7, 5.0))
    assert abs(short - expected) < 4 * np.sqrt(expected * (1 - expected) / n)


@pytest.mark.prove
@pytest.mark.parametrize("lead", [0, 1, 3])
def test_cycles_end_with_arrivals_and_are_met_without_unmet_demand(lead):
    """An (s, S) rule: counted from the recorded orders and shortages of every path."""
    periods = 40
    of = problem(case(lead_time=lead, shortage=4.0, order=20.0, stock=9.0, coming=[5.0] * (lead - 1),
                      horizon={"periods": periods, "warm_up": 0}))  # fmt: skip
    numbers = [jnp.asarray(x) for x in (10.0, ENDLESS, 1.0)]
    draws = of.sources.evaluation.draws(np.arange(32), of.simulator)
    rule = Classical(*numbers, action=of.action)
    found = Xla("float64").bind(of).values(rule, draws, Exact(), record=("outputs",))
    shown = {
        name: np.asarray(found.record["outputs"][name]) * periods for name in ("ordered", "short")
    }
    cycles = met = 0
    for path in range(32):
        arrivals = list(shown["ordered"][:, path])
        if lead > 1:
            arrivals = [5.0] * (lead - 1) + arrivals[: periods - lead + 1]
        missed = False
        for arrived, short in zip(arrivals, shown["short"][:, path]):
            if lead > 0:
                missed |= short > 0.5
            if arrived > 0.5:
                cycles, met, missed = cycles + 1, met + (not missed), False
            if lead == 0:
                missed |= short > 0.5
    totals = {
        name: float(np.sum(found.totals[name])) * periods for name in ("cycles", "cycles_met")
    }
    assert totals == pytest.approx({"cycles": cycles, "cycles_met": met}, abs=1e-6)
    assert 0.2 * cycles < met < cycles and cycles < 0.8 * 32 * periods
