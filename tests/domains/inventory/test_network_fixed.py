"""Costs of an order in a network: when they are paid, derivatives, both engines, trained rules."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.inventory.inventory_cases import optimised
from tests.domains.inventory.network_cases import network

from snapo.case.error import CaseError
from snapo.domains.inventory.network.estimates import first_batches
from snapo.domains.inventory.network.rules import RuleNumbers, best, echelon_rule
from snapo.domains.inventory.setup import make_setup
from snapo.engine import Native, Xla
from snapo.problem.scenarios import Sources
from snapo.problem.smooth import Exact, Smooth
from snapo.solver import statistics
from snapo.solver.adjoint import value_and_gradient
from snapo.solver.evaluate import evaluate, path_totals, value_of_groups
from snapo.solver.solve import Evaluation, solve

NORMAL = {"kind": "normal", "mean": 5.0, "deviation": 1.6}
POISSON = {"kind": "poisson", "mean": 3.0}
SHOP = {"name": "shop", "supplier": "depot", "lead_time": 1, "holding": 2.0, "shortage": 18.0,
        "demand": NORMAL}  # fmt: skip
DEPOT = {"name": "depot", "lead_time": 1, "holding": 1.0, "order": 40.0}
ALONE = {"name": "kiosk", "lead_time": 0, "holding": 1.0, "shortage": 9.0, "demand": NORMAL}


def test_a_cost_of_an_order_is_an_input_of_the_places_that_have_one():
    case = network(SHOP, DEPOT, ALONE | {"order": 3.0})
    assert case.network.fixed == (1, 2) and case.ordering is not None
    assert case.ordering.labels == ("depot", "kiosk") and case.ordering.unit == "EUR"
    assert case.network.linked.tolist() == [[1, 1, 0], [1, 1, 0], [0, 0, 1]]
    assert network(SHOP, {**DEPOT, "order": 0.0}).ordering is None


@pytest.mark.parametrize("value", [-1.0, "much", float("nan")])
def test_a_wrong_cost_is_refused_with_file_key_value_and_what_is_allowed(value):
    with pytest.raises(CaseError) as found:
        network(SHOP, DEPOT | {"order": value})
    assert found.value.file.endswith("case.toml") and found.value.where == "place[1].order"
    assert "a number of at least 0" in found.value.allowed


@pytest.fixture(scope="module")
def line():
    """Both places pay for an order."""
    case = network(SHOP | {"order": 5.0}, DEPOT, horizon={"periods": 12, "warm_up": 0})
    return make_setup(case)


@pytest.mark.prove
def test_an_order_is_paid_by_the_place_that_places_it(line):
    """The depot has 3 of the 4 that the shop asks for, and orders nothing itself."""
    simulator, constants = line.problem.simulator, line.problem.schedule.constants
    state = {"stock": jnp.array([9.0, 3.0]), "coming": jnp.zeros((2, 1)), "likelihood": jnp.ones(2)}
    now, noise = {"weight": 0.5, "counted": 1.0}, jnp.array([0.0, 0.0, 0.0])
    # [amounts, whether the shop orders, whether the depot does]
    for action, paid in (
        ([4.0, 7.0, 0.0, 1.0, 1.0, 0.0], 5.0),
        ([4.0, 7.0, 1.0, 0.0, 0.0, 1.0], 40.0),
        ([4.0, 7.0, 0.0, 1.0, 0.0, 1.0], 45.0),
    ):
        shop, depot = action[3], action[5]
        after, outputs = simulator.step(constants, now, state, jnp.array(action), noise, Exact())
        assert float(outputs["ordering"]) == pytest.approx(0.5 * paid)
        assert after["coming"][:, 0] == pytest.approx([3.0 * shop, 7.0 * depot])
        assert float(after["stock"][1]) == pytest.approx(3.0 - 3.0 * shop)
        assert float(outputs["orders_shop"]) == shop and float(outputs["orders_depot"]) == depot
        parts = sum(float(outputs[name]) for name in ("holding", "shortage", "ordering"))
        assert float(outputs["result"]) == pytest.approx(-parts)


@pytest.mark.prove
def test_derivatives_go_through_whether_each_place_orders(monkeypatch):
    """Eight times: the adjoint less a difference of the smooth value on the same paths, by where
    orders of either place begin and end and by the mean demand; without forgetting.

    Shortage is cheap: where it is dear, the rare paths on which a place does not order for long
    hold most of a derivative, and their errors are not known from eight times.
    """
    optimised(monkeypatch)
    monkeypatch.setattr(
        "snapo.domains.inventory.network.simulator.memory", lambda case: np.full(2, 1e12)
    )
    smooth, engine, paths = Smooth(jnp.asarray(0.02)), Native("float64"), 49152
    case = network(SHOP | {"order": 5.0, "shortage": 6.0}, DEPOT | {"order": 20.0},
                   horizon={"periods": 10, "warm_up": 0})  # fmt: skip
    setup = make_setup(case)
    policy, off = setup.policy, []
    for seed in range(8):
        of = replace(setup.problem, sources=Sources.of(None, seed))
        slope = value_and_gradient(of, policy, paths=paths, smooth=smooth, engine=engine)[1]

        def difference(ways, of=of):
            ends = [evaluate(problem, rule, paths=paths, smooth=smooth, engine=engine).value
                    for problem, rule in ways(of)]  # fmt: skip
            return (ends[0] - ends[1]) / 0.2

        row = []
        for name in ("wait", "first"):
            for place in (0, 1):
                moved = [
                    eqx.tree_at(lambda p, name=name: getattr(p, name), policy,
                                getattr(policy, name).at[place].add(step))
                    for step in (0.1, -0.1)
                ]  # fmt: skip
                found = difference(lambda of, moved=moved: [(of, each) for each in moved])
                row.append(float(getattr(slope.policy, name)[place]) - found)
        found = difference(lambda of: [(of.at({"shop.demand_mean": 5.0 + step}), policy)
                                       for step in (0.1, -0.1)])  # fmt: skip
        row.append(float(np.sum(slope.inputs["shop.demand_mean"])) - found)
        off.append(row)
    error = np.std(off, axis=0, ddof=1) / np.sqrt(len(off))
    ratios = np.abs(np.mean(off, axis=0)) / error
    print("off", np.mean(off, axis=0), "±", error)
    # Of five numbers, each known from eight, one may lie a little beyond two errors.
    assert np.all(ratios < 3) and np.sum(ratios < 2) >= 4
    assert np.all(error < [0.02, 0.02, 0.01, 0.02, 0.05])


@pytest.mark.prove
def test_both_engines_agree(tmp_path):
    """Whole demand with a season, costs of an order, stores that balance and send goods."""
    (tmp_path / "s.csv").write_text("period,factor\nsummer,0.5\nwinter,1.5\n")
    shops = [
        {**SHOP, "name": name, "demand": POISSON, "order": order, "season": {"file": "s.csv"}}
        for name, order in (("north", 4.0), ("south", 0.0))
    ]
    pools = [{"between": ["north", "south"], "cost": 1.0, "when": when}
             for when in ("before", "after")]  # fmt: skip
    case = network(*shops, DEPOT, folder=tmp_path, transshipment=pools,
                   horizon={"periods": 4, "warm_up": 0})  # fmt: skip
    setup, smooth = make_setup(case), Smooth(jnp.asarray(0.02))
    (first, one), (second, other) = (
        value_and_gradient(setup.problem, setup.policy, paths=128, smooth=smooth, engine=engine)
        for engine in (Xla("float64"), Native("float64"))
    )
    assert first == pytest.approx(second, rel=1e-10)
    assert {"order_cost", "north.season", "south.season"} < set(one.inputs)
    for name, slope in one.inputs.items():
        assert slope == pytest.approx(other.inputs[name], rel=1e-7, abs=1e-10), name


def compared(case, numbers: RuleNumbers | None = None):
    """(cost of the trained rule, cost of (s, S) of the echelons, paired error of the difference)."""
    setup = make_setup(case)
    alone = Evaluation(65536, sensitivity_paths=0, smooth_paths=0, judge_paths=0)
    found = solve(setup.problem, policy=setup.policy, training=setup.training, evaluation=alone,
                  engine=setup.engines)  # fmt: skip
    batch, wait = (tuple(float(x) for x in each) for each in first_batches(case))
    rule = echelon_rule(setup, *best(setup, RuleNumbers(batch, wait=wait)))
    objective, source = setup.problem.objective, setup.problem.sources.evaluation
    totals = path_totals(setup.problem, rule, 65536, engine=setup.engines.evaluate)
    shares = [value_of_groups(objective, each, source) for each in (found.totals, totals)]
    paired = statistics.of_shares(shares[0] - shares[1])
    cost = -statistics.of_shares(shares[1]).value
    print(f"trained {-found.value:.4f} ± {found.standard_error:.4f}, (s, S) {cost:.4f}, "
          f"{-paired.value:+.4f} ± {paired.standard_error:.4f}")  # fmt: skip
    return -found.value, cost, paired.standard_error


@pytest.mark.study
@pytest.mark.parametrize("seed", range(3))
def test_a_line_with_a_fixed_cost_upstream_is_not_dearer_than_s_S(seed):
    """There (s, S) of the upper echelon and base stock below are optimal (Clark and Scarf)."""
    case = network(SHOP, DEPOT, horizon={"periods": 60, "warm_up": 40},
                   training={"steps": 400, "seed": seed})  # fmt: skip
    trained, cost, _ = compared(case)
    assert trained < 1.002 * cost


@pytest.mark.study
@pytest.mark.parametrize("seed", range(3))
def test_a_line_with_fixed_costs_at_both_places_is_cheaper_than_s_S(seed):
    """Here no rule of echelon positions alone is optimal."""
    case = network(SHOP | {"order": 5.0}, DEPOT, horizon={"periods": 60, "warm_up": 40},
                   training={"steps": 400, "seed": seed})  # fmt: skip
    trained, cost, error = compared(case)
    assert trained < cost - 3 * error
