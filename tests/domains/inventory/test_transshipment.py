"""Stores that send one another goods: reading, balance of goods, closed forms, both engines."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.inventory.references.pooling import one_newsvendor, pooled_stores

from snapo.case.error import CaseError
from snapo.domains.inventory.network.rules import ENDLESS, echelon_rule
from snapo.domains.inventory.network.transshipment import in_pieces
from snapo.domains.inventory.read.network import read_network
from snapo.domains.inventory.setup import make_setup
from snapo.engine import Native, Xla
from snapo.problem.smooth import Exact, Smooth
from snapo.solver.adjoint import value_and_gradient
from snapo.solver.evaluate import evaluate
from snapo.solver.solve import Evaluation, solve

NORMAL = {"kind": "normal", "mean": 5.0, "deviation": 1.6}
POISSON = {"kind": "poisson", "mean": 3.0}
HOLDING, SHORTAGE = 1.0, 9.0


def stores(count: int, *pools: dict[str, Any], demand=NORMAL, lead=0, **tables: Any):
    """A case of equal stores; `pools` have all of them where they name none."""
    names = [f"s{i}" for i in range(count)]
    place = {"lead_time": lead, "holding": HOLDING, "shortage": SHORTAGE, "demand": demand}
    data = {
        "kind": "inventory",
        "place": [{"name": name, **place} for name in names],
        "transshipment": [{"between": names, **pool} for pool in pools],
        **tables,
    }
    return read_network(Path(__file__).parent / "case.toml", data)


def at_levels(case, levels, kept: float = 0.0):
    """(a case ready to solve, the rule that orders up to these levels [n])."""
    setup = make_setup(case)
    own = setup.problem.schedule.constants
    return setup, echelon_rule(setup, (levels - own["level"]) / own["unit"], kept)


def test_the_closed_form_has_the_newsvendors_at_both_ends():
    mean, deviation = np.full(3, 5.0), np.array([1.0, 1.6, 2.0])
    free = pooled_stores(mean, deviation, HOLDING, SHORTAGE, 0.0)
    total = float(np.sqrt(np.sum(deviation**2)))
    assert free.cost == pytest.approx(one_newsvendor(total, HOLDING, SHORTAGE), rel=1e-8)
    dear = pooled_stores(mean, deviation, HOLDING, SHORTAGE, HOLDING + SHORTAGE)
    each = sum(one_newsvendor(one, HOLDING, SHORTAGE) for one in deviation)
    assert dear.cost == pytest.approx(each, rel=1e-8)
    assert dear.levels == pytest.approx(5 + 1.2815515655 * deviation, abs=1e-4)
    between = pooled_stores(mean, deviation, HOLDING, SHORTAGE, 3.0)
    assert free.cost < between.cost < dear.cost


@pytest.mark.parametrize(
    "pool, words",
    [
        ({"between": ["s0", "moon"], "cost": 1.0}, "the places with customers are s0, s1, s2"),
        ({"between": ["s0", "s0"], "cost": 1.0}, "be listed only once"),
        ({"between": ["s0"], "cost": 1.0}, "2 or more"),
        ({"cost": 1.0, "one_way": True}, "the first of which sends"),
        ({"cost": -1.0}, "at least 0"),
        ({"cost": 1.0, "when": "never"}, "before"),
    ],
)
def test_mistakes_are_refused_in_words(pool, words):
    with pytest.raises(CaseError, match=words):
        stores(3, pool)


def test_two_tables_of_the_same_places_are_refused():
    with pytest.raises(CaseError, match="same places"):
        stores(2, {"cost": 1.0}, {"cost": 2.0})
    found = stores(2, {"cost": 1.0}, {"cost": 2.0, "when": "before"})
    assert found.transshipment is not None
    assert found.transshipment.labels == ("s0, s1", "s0, s1 (before demand)")


def test_orders_are_whole_where_demand_is_and_a_case_may_say_otherwise():
    assert stores(2, demand=POISSON).network.integer
    assert not stores(2).network.integer
    assert not stores(2, demand=POISSON, network={"whole": False}).network.integer


def test_amounts_in_pieces_keep_their_sum():
    case = stores(3, demand=POISSON)
    found = in_pieces(case.network, jnp.array([0.4, 2.7, 0.9]), Exact())
    assert found.sum() == 4 and np.all(found == np.round(found))
    assert np.all(np.abs(found - np.array([0.4, 2.7, 0.9])) < 1)


def one_period(case, stock, noise, **parts):
    """(state, outputs) after a period from this stock, with these parts of the action."""
    setup = make_setup(case)
    simulator, constants = setup.problem.simulator, setup.problem.schedule.constants
    action = jnp.concatenate([jnp.asarray(parts[name], float) for name in simulator.action.names])
    state = {"stock": jnp.asarray(stock, float)}
    now = {"weight": 1.0, "counted": 1.0}
    return simulator.step(constants, now, state, action, jnp.asarray(noise), Exact())


@pytest.mark.prove
def test_after_demand_goods_go_where_they_are_short_less_what_is_held_back():
    case = stores(3, {"cost": 2.0})
    noise = np.array([(4.0 - 5.0) / 1.6, (9.0 - 5.0) / 1.6, (7.0 - 5.0) / 1.6])  # demand 4, 9, 7
    state, outputs = one_period(case, [10.0, 5.0, 6.0], noise, order=[0, 0, 0], held=[3, 0, 0])
    # Six are left in the first store, of which it holds three; short are four and one.
    assert state["stock"] == pytest.approx([3.0, -4 + 3 * 0.8, -1 + 3 * 0.2])
    assert float(outputs["transshipment"]) == pytest.approx(6.0)
    assert float(outputs["sent_s0"]) == pytest.approx(3.0) == float(outputs["moved"])
    assert float(outputs["received_s1"]) == pytest.approx(2.4)
    assert float(outputs["sold"]) == pytest.approx(4 + 7.4 + 6.6)
    assert float(outputs["result"]) == pytest.approx(-(3 + 9 * 2.0 + 6))


@pytest.mark.prove
def test_before_demand_stocks_are_balanced_within_a_band():
    case = stores(2, {"cost": 1.0, "when": "before"})
    noise = np.zeros(2)  # demand 5, 5
    none = {"order": [0, 0], "band": [0, 0], "shift": [0, 0]}
    state, outputs = one_period(case, [10.0, 2.0], noise, **none)
    assert state["stock"] == pytest.approx([1.0, 1.0])
    assert float(outputs["transshipment"]) == pytest.approx(4.0)
    state, _ = one_period(case, [10.0, 2.0], noise, **none | {"band": [1, 0]})
    assert state["stock"] == pytest.approx([2.0, 0.0])
    state, _ = one_period(case, [10.0, 2.0], noise, **none | {"shift": [2, -2]})
    assert state["stock"] == pytest.approx([3.0, -1.0])


@pytest.mark.prove
def test_one_way_is_one_way_and_the_cheapest_pool_comes_first():
    pools = {"cost": 3.0}, {"between": ["s0", "s1"], "cost": 1.0, "one_way": True}
    case = stores(3, *pools)
    noise = np.array([-1.0, 2.0, 2.0]) / 1.6  # demand 4, 7, 7
    state, outputs = one_period(case, [7.0, 5.0, 5.0], noise, order=[0] * 3, held=[0] * 3)
    assert state["stock"] == pytest.approx([0.0, 0.0, -1.0])
    assert float(outputs["transshipment"]) == pytest.approx(2 * 1.0 + 1 * 3.0)
    noise = np.array([2.0, -1.0, -1.0]) / 1.6
    only = stores(3, pools[1])
    state, _ = one_period(only, [5.0, 7.0, 7.0], noise, order=[0] * 3, held=[0] * 2)
    assert state["stock"] == pytest.approx([-2.0, 3.0, 3.0])


@pytest.mark.prove
def test_whole_goods_stay_whole_and_none_is_made_or_lost():
    both = {"cost": 1.0}, {"cost": 0.5, "when": "before"}
    setup = make_setup(
        stores(3, *both, demand=POISSON, lead=1, horizon={"periods": 8, "warm_up": 0})
    )
    draws = setup.problem.sources.evaluation.draws(np.arange(64), setup.problem.simulator)
    found = Native("float64").bind(setup.problem).values(
        setup.policy, draws, Exact(), record=("state", "action", "outputs")
    )  # fmt: skip
    stock, coming = found.record["state"]["stock"], found.record["state"]["coming"]
    assert np.allclose(stock, np.round(stock)) and np.allclose(coming, np.round(coming))
    orders = found.record["action"][..., :3]
    assert np.allclose(orders, np.round(orders))
    demand = np.stack([found.record["outputs"][f"demand_s{i}"] for i in range(3)], -1) * 8
    total = stock.sum(-1) + coming.sum((-1, -2))
    change = (orders - demand).sum(-1)
    assert np.allclose(total[1:] - total[:-1], change[:-1], atol=1e-9)


@pytest.mark.prove
@pytest.mark.parametrize("count, moving", [(2, 0.0), (2, 2.0), (3, 5.0)])
def test_complete_pooling_costs_its_closed_form(count, moving):
    """Value, and by the envelope theorem what the cost of moving is worth."""
    best = pooled_stores(np.full(count, 5.0), np.full(count, 1.6), HOLDING, SHORTAGE, moving)
    case = stores(count, {"cost": moving}, horizon={"periods": 20, "warm_up": 2})
    setup, rule = at_levels(case, best.levels)
    found = evaluate(setup.problem, rule, paths=8192, engine=Native("float64"))
    assert abs(-found.value - best.cost) < 3 * found.standard_error < 0.01 * best.cost
    near = [pooled_stores(np.full(count, 5.0), np.full(count, 1.6), HOLDING, SHORTAGE, moving + h)
            for h in (-1e-3, 1e-3)]  # fmt: skip
    slope = (near[1].cost - near[0].cost) / 2e-3
    held = value_and_gradient(
        setup.problem, rule, paths=8192, decisions="held", engine=Native("float64")
    )
    assert -held[1].inputs["transshipment_cost"][0] == pytest.approx(slope, rel=0.02)


@pytest.mark.prove
def test_with_a_lead_time_free_pooling_is_one_store():
    count, lead = 3, 2
    deviation = 1.6 * np.sqrt(count * (lead + 1))
    best = one_newsvendor(deviation, HOLDING, SHORTAGE)
    level = (lead + 1) * 5 + 1.2815515655 * deviation / count
    case = stores(count, {"cost": 0.0}, lead=lead, horizon={"periods": 30, "warm_up": 15})
    setup, rule = at_levels(case, np.full(count, level))
    found = evaluate(setup.problem, rule, paths=8192, engine=Native("float64"))
    assert abs(-found.value - best) < 3 * found.standard_error < 0.02 * best
    alone = evaluate(setup.problem, echelon_rule(setup, (0.0,) * 3, ENDLESS), paths=8192)
    assert -alone.value == pytest.approx(3 * one_newsvendor(1.6 * 3**0.5, 1.0, 9.0), rel=0.01)


@pytest.mark.prove
def test_balanced_before_demand_is_eppen_and_schrages_form():
    """With a deviation at which no store is ever so short that balance would need its orders."""
    demand = {"kind": "normal", "mean": 5.0, "deviation": 0.8}
    count, lead = 3, 1
    each = 0.8 * np.sqrt(lead / count + 1)
    level = (lead + 1) * 5 + 1.2815515655 * each
    pool = {"cost": 0.0, "when": "before"}
    case = stores(count, pool, demand=demand, lead=lead, horizon={"periods": 30, "warm_up": 10})
    setup, rule = at_levels(case, np.full(count, level))
    found = evaluate(setup.problem, rule, paths=8192, engine=Native("float64"))
    best = count * one_newsvendor(each, HOLDING, SHORTAGE)
    assert abs(-found.value - best) < 3 * found.standard_error < 0.01 * best


@pytest.mark.prove
@pytest.mark.parametrize("demand", [NORMAL, POISSON])
def test_both_engines_agree_and_the_adjoint_is_the_difference(demand):
    """Whole demand is spread in training, so that its quantile has a difference on every path."""
    both = {"cost": 1.0}, {"cost": 0.5, "when": "before"}
    tables = {"horizon": {"periods": 4, "warm_up": 0}}
    setup = make_setup(stores(2, *both, demand=demand, lead=1, **tables))
    problem, smooth = setup.problem, Smooth(jnp.asarray(0.05))
    (first, one), (second, other) = (
        value_and_gradient(problem, setup.policy, paths=256, smooth=smooth, engine=engine)
        for engine in (Xla("float64"), Native("float64"))
    )
    assert first == pytest.approx(second, rel=1e-10)
    for name, slope in one.inputs.items():
        assert slope == pytest.approx(other.inputs[name], rel=1e-7, abs=1e-10), name
        given, step = problem.inputs_by_name[name].value, 1e-4
        way = np.zeros(given.shape) if given.ndim else np.ones(())
        way[(0,) * given.ndim] = 1.0
        ends = [
            evaluate(problem.at({name: given + side * step * way}), setup.policy, paths=256,
                     smooth=smooth, engine=Native("float64")).value
            for side in (1, -1)
        ]  # fmt: skip
        expected = (ends[0] - ends[1]) / (2 * step)
        assert slope.flat[0] == pytest.approx(expected, rel=1e-4, abs=1e-5), name


@pytest.mark.study
@pytest.mark.parametrize("seed", range(10))
def test_trained_stores_are_within_four_thousandths_of_the_closed_forms(seed):
    """The last case has a rule that no base stock of each store by itself can be: 1.5 % better."""
    mean, deviation = np.full(4, 5.0), np.full(4, 1.6)
    lead = {"periods": 40, "warm_up": 20}
    cases = [
        (stores(2, {"cost": 2.0}, horizon={"periods": 20, "warm_up": 5}),
         pooled_stores(mean[:2], deviation[:2], HOLDING, SHORTAGE, 2.0).cost),
        (stores(4, {"cost": 0.5}, horizon={"periods": 20, "warm_up": 5}),
         pooled_stores(mean, deviation, HOLDING, SHORTAGE, 0.5).cost),
        (stores(3, {"cost": 0.0}, lead=2, horizon=lead), one_newsvendor(4.8, HOLDING, SHORTAGE)),
        (stores(3, {"cost": 0.0, "when": "before"}, lead=2, horizon=lead),
         3 * one_newsvendor(1.6 * np.sqrt(2 / 3 + 1), HOLDING, SHORTAGE)),
    ]  # fmt: skip
    alone = Evaluation(65536, sensitivity_paths=0, smooth_paths=0, judge_paths=0)
    for case, best in cases:
        training = case.training.model_copy(update={"steps": 200, "seed": seed})
        setup = make_setup(replace(case, training=training))
        found = solve(setup.problem, policy=setup.policy, training=setup.training,
                      evaluation=alone, engine=setup.engines)  # fmt: skip
        off = -found.value / best - 1
        print(f"seed {seed}: {-found.value:.4f} ± {found.standard_error:.4f}, {off:+.2%}")
        assert abs(off) < 0.004
