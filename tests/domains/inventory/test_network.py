"""Places that supply one another: reading, balance of goods, both engines, and a line's optimum."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.inventory.references.serial import serial_line

from snapo.case.error import CaseError
from snapo.domains.inventory.network.rules import echelon_rule
from snapo.domains.inventory.read.network import read_network
from snapo.domains.inventory.setup import make_setup
from snapo.engine import Native, Xla
from snapo.problem.smooth import Exact, Smooth
from snapo.solver.adjoint import value_and_gradient
from snapo.solver.evaluate import evaluate
from snapo.solver.solve import Evaluation, solve

NORMAL = {"kind": "normal", "mean": 5.0, "deviation": 1.0}
SHOP = {"name": "shop", "lead_time": 0, "holding": 7.0, "shortage": 37.12, "demand": NORMAL}
LINE = (
    SHOP | {"supplier": "depot"},
    {"name": "depot", "supplier": "works", "lead_time": 0, "holding": 4.0},
    {"name": "works", "lead_time": 1, "holding": 2.0},
)
POISSON = {"kind": "poisson", "mean": 3.0}
STORES = (
    {"name": "centre", "lead_time": 2, "holding": 1.0},
    *(
        {"name": name, "supplier": "centre", "lead_time": lead, "holding": 2.0,
         "shortage": 15.0, "demand": POISSON}
        for name, lead in (("north", 1), ("south", 0))
    ),
)  # fmt: skip
# Clark and Scarf's recursion, `serial_line` with a grid of 0.01; Snyder and Shen, example 6.1, have
# 47.65 with the levels 6.49, 12.02 and 22.71.
OPTIMUM = 47.6602


def network(*places: dict[str, Any], **tables: Any):
    data = {"kind": "inventory", "place": list(places), **tables}
    return read_network(Path(__file__).parent / "case.toml", data)


def test_the_recursion_of_clark_and_scarf():
    found = serial_line(5.0, 1.0, np.array([7.0, 4.0, 2.0]), np.array([1, 1, 2]), 37.12, 0.02)
    assert found.levels == pytest.approx([6.49, 12.02, 22.71], abs=0.021)
    assert found.cost == pytest.approx(OPTIMUM, abs=5e-4)
    assert found.cost == pytest.approx(47.65, rel=5e-4)


def test_one_place_is_the_newsvendor():
    found = serial_line(5.0, 1.0, np.array([1.0]), np.array([2]), 9.0, 0.005)
    assert found.cost == pytest.approx(10 * 0.17549833 * np.sqrt(2), rel=1e-4)


def test_a_utility_is_refused_as_costs_are_no_wealth():
    with pytest.raises(CaseError, match="for wealth, not for costs"):
        network(*LINE, objective={"kind": "crra", "risk_aversion": 2.0, "wealth": 9.0})


def test_periods_to_cover():
    assert network(*LINE).network.cover.tolist() == [1, 2, 4]
    assert network(*STORES).network.cover.tolist() == [5, 2, 1]
    assert network(*STORES).network.sellers == (1, 2)


@pytest.mark.parametrize(
    "places, words",
    [
        ((SHOP, SHOP), "another place has this name"),
        ((SHOP | {"supplier": "moon"},), "the places are shop"),
        ((SHOP | {"supplier": "shop"},), "circle|must not have customers"),
        (({"name": "depot", "lead_time": 0, "holding": 1.0},), "no customers"),
        (({**SHOP, "shortage": None},), "allowed|shortage"),
        ((SHOP | {"name": "a shop"},), "letters, digits"),
    ],
)
def test_mistakes_are_refused_in_words(places, words):
    with pytest.raises(CaseError, match=words):
        network(*places)


@pytest.fixture(scope="module")
def stores():
    """One warehouse that is often empty, two stores with different lead times; any amounts."""
    tables = {"horizon": {"periods": 5, "warm_up": 0}, "network": {"whole": False}}
    return make_setup(network(*STORES, **tables))


@pytest.mark.prove
def test_goods_are_neither_made_nor_lost_and_a_supplier_shares(stores):
    simulator, schedule = stores.problem.simulator, stores.problem.schedule
    constants = schedule.constants
    state = {"stock": jnp.array([6.0, 0.0, 1.0]), "coming": jnp.zeros((3, 2))}
    wanted, drawn = jnp.array([4.0, 9.0, 3.0]), jnp.array([0.3, -0.2])
    now = {"weight": 1.0, "counted": 1.0}
    after, outputs = simulator.step(constants, now, state, wanted, drawn, Exact())
    # 12 are asked of 6: half of each; the centre's own order and the north's are on their way.
    assert after["coming"] == pytest.approx(np.array([[0, 4.0], [4.5, 0], [0, 0]]))
    asked = [float(outputs[f"demand_{name}"]) for name in ("north", "south")]
    assert after["stock"] == pytest.approx([0.0, -asked[0], 1.0 + 1.5 - asked[1]])
    left = max(2.5 - asked[1], 0.0)
    # Goods on their way from the centre cost as much as those in it; from outside, nothing.
    assert float(outputs["holding"]) == pytest.approx(1.0 * 4.5 + 2.0 * left)


@pytest.mark.prove
def test_a_supplier_shares_in_whole_units_where_demand_is_whole():
    problem = make_setup(network(*STORES, horizon={"periods": 5, "warm_up": 0})).problem
    state = {"stock": jnp.array([7.0, 0.0, 1.0]), "coming": jnp.zeros((3, 2))}
    constants, now = problem.schedule.constants, {"weight": 1.0, "counted": 1.0}
    wanted, drawn = jnp.array([4.0, 9.0, 3.0]), jnp.array([0.3, -0.2])
    after, _ = problem.simulator.step(constants, now, state, wanted, drawn, Exact())
    # 12 are asked of 7: shares of 5.25 and 1.75.
    assert after["coming"].tolist() == [[0, 4.0], [5.0, 0], [0, 0]]
    assert float(after["stock"][0]) == 0.0
    assert np.all(after["stock"] == np.round(after["stock"]))


@pytest.mark.prove
def test_both_engines_agree(stores):
    smooth = Smooth(jnp.asarray(0.02))
    (first, one), (second, other) = (
        value_and_gradient(stores.problem, stores.policy, paths=256, smooth=smooth, engine=engine)
        for engine in (Xla("float64"), Native("float64"))
    )
    assert first == pytest.approx(second, rel=1e-10)
    for name, slope in one.inputs.items():
        assert slope == pytest.approx(other.inputs[name], rel=1e-7, abs=1e-10), name


@pytest.mark.prove
def test_the_best_levels_of_a_line_cost_the_optimum():
    setup = make_setup(network(*LINE, horizon={"periods": 60, "warm_up": 20}))
    levels, units = (setup.problem.schedule.constants[name] for name in ("level", "unit"))
    above = (np.array([6.49, 12.02, 22.71]) - levels) / units
    found = evaluate(setup.problem, echelon_rule(setup, above), paths=16384, engine=Xla())
    assert abs(-found.value - OPTIMUM) < 3 * found.standard_error < 0.002 * OPTIMUM


@pytest.mark.study
def test_a_trained_line_is_within_four_thousandths_of_the_optimum():
    setup = make_setup(
        network(*LINE, horizon={"periods": 60, "warm_up": 30}, training={"steps": 150})
    )
    alone = Evaluation(65536, sensitivity_paths=0, smooth_paths=0, judge_paths=0)
    # From levels that are off: the first ones are close to the best already.
    policy = echelon_rule(setup, (0.8, -0.8, 0.8))
    start = evaluate(setup.problem, policy, paths=16384)
    assert -start.value > 1.02 * OPTIMUM
    found = solve(setup.problem, policy=policy, training=setup.training, evaluation=alone,
                  engine=setup.engines)  # fmt: skip
    print(f"line: {-found.value:.4f} ± {found.standard_error:.4f} from {-start.value:.4f}")
    assert abs(-found.value / OPTIMUM - 1) < 0.004
