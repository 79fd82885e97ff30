"""A network of one place is the item: seasons, fixed costs of an order, and both together."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.inventory.network_cases import one_place
from tests.domains.inventory.test_figures import FIXED

from snapo.domains.inventory.item.estimates import memory as item_memory
from snapo.domains.inventory.item.estimates import usual_cost
from snapo.domains.inventory.network.estimates import first_batches, memory, usual_costs
from snapo.domains.inventory.network.rules import echelon_rule, first_levels
from snapo.domains.inventory.policy.rules import classical
from snapo.domains.inventory.setup import first_batch, make_setup
from snapo.engine import Xla
from snapo.problem.smooth import Exact, Smooth
from snapo.solver.adjoint import value_and_gradient
from snapo.solver.solve import Evaluation, solve

POISSON = {"kind": "poisson", "mean": 5.0}
NORMAL = {"kind": "normal", "mean": 5.0, "deviation": 1.6}
HISTORY = {"kind": "empirical", "history": "h.csv"}
SEASON = "period,factor\nspring,0.5\nsummer,1.5\nautumn,1.1\n"
HORIZON = {"periods": 8, "warm_up": 2}
PARTS = (
    "result", "holding", "shortage", "ordering", "stock", "sold", "demand", "orders", "short",
)  # fmt: skip
SEASONAL_AND_FIXED = pytest.mark.parametrize(
    "demand, season, order, lead",
    [(POISSON, "s.csv", 10.0, 1), (NORMAL, "s.csv", 0.0, 3)],
)


def both(folder, demand: dict[str, Any], season: str, **place: Any):
    """(item, network) ready to solve, with the first rules, their networks at zero."""
    (folder / "s.csv").write_text(SEASON)
    item, whole = one_place(demand, folder, season, horizon=HORIZON, **place)
    made = []
    for setup in (make_setup(item), make_setup(whole)):
        last = setup.policy.network.weights[-1]  # pyright: ignore
        policy = eqx.tree_at(lambda p: p.network.weights[-1], setup.policy, jnp.zeros_like(last))
        made.append(setup._replace(policy=policy))
    return made


@pytest.mark.prove
@SEASONAL_AND_FIXED
def test_costs_and_derivatives_are_those_of_the_item(tmp_path, demand, season, order, lead):
    """The same draws, in double precision: smooth, with whether to order drawn, and exact."""
    item, whole = both(tmp_path, demand, season, order=order, lead_time=lead)
    kinds: list[dict[str, Any]] = [{"smooth": Smooth(jnp.asarray(0.02))}, {"decisions": "held"}]
    for kind in kinds:
        (first, one), (second, other) = (
            value_and_gradient(each.problem, each.policy, paths=64, engine=Xla("float64"), **kind)
            for each in (item, whole)
        )
        assert second == pytest.approx(first, rel=1e-12)
        names = set(one.inputs) - {"start_stock", "start_coming", "purchase_cost"}
        assert ("season" in names) == bool(season) and ("order_cost" in names) == (order > 0)
        for name in names:
            own = name if name in other.inputs else f"shop.{name}"
            slope = np.ravel(one.inputs[name])
            assert np.ravel(other.inputs[own]) == pytest.approx(slope, rel=1e-10, abs=1e-12), name


@pytest.mark.prove
@pytest.mark.parametrize(
    "demand, unmet, season",
    [(POISSON, "waits", "s.csv"), (POISSON, "lost", ""), (HISTORY, "waits", "s.csv")],
)
def test_every_path_of_an_s_S_rule_is_that_of_the_item(tmp_path, demand, unmet, season):
    """Whole demand, or a whole history times a season, with a fixed cost: every output of every
    path, to the last digits; if orders are real, to 1e-5, as the rules are in float32."""
    (tmp_path / "h.csv").write_text("period,demand\n" + "".join(f"{i},{i}\n" for i in range(11)))
    item, whole = both(tmp_path, demand, season, order=10.0, unmet=unmet)
    unit = float(whole.problem.schedule.constants["unit"][0])
    # Rules count from the first level, of which lost sales have another as an item.
    first = float(item.problem.schedule.steps["level"][HORIZON["warm_up"]])
    off = float(first - first_levels(whole)[0])
    assert off == pytest.approx(0, abs=1e-12) or unmet == "lost"
    rules = (
        classical(item, "(s, S)", {"above": 9.2, "reorder": -1.3}),
        echelon_rule(whole, ((9.2 + off) / unit,), wait=((1.3 - off) / unit,)),
    )
    totals = []
    for setup, rule in zip((item, whole), rules):
        draws = setup.problem.sources.evaluation.draws(np.arange(256), setup.problem.simulator)
        totals.append(Xla("float64").bind(setup.problem).values(rule, draws, Exact()).totals)
    assert 0.1 < np.mean(totals[0]["orders"]) < 0.6
    digits = 1e-5 if demand is HISTORY else 1e-12
    for name in PARTS:
        assert totals[1][name] == pytest.approx(totals[0][name], abs=digits), name


@pytest.mark.parametrize("season", ["", "s.csv"])
def test_estimates_are_those_of_the_item(tmp_path, season):
    (tmp_path / "s.csv").write_text(SEASON)
    item, whole = one_place(NORMAL, tmp_path, season, order=10.0)
    assert usual_costs(whole) == pytest.approx([usual_cost(item)], rel=1e-12)
    assert memory(whole) == pytest.approx([item_memory(item)], rel=1e-12)
    batch, wait = first_batches(whole)
    assert (batch[0], wait[0]) == pytest.approx(first_batch(item), rel=1e-12)


@pytest.mark.study
@pytest.mark.parametrize("unmet, mean, order, lead, optimum", FIXED)
def test_fixed_costs_within_half_a_percent_of_value_iteration(unmet, mean, order, lead, optimum):
    _, whole = one_place({"kind": "poisson", "mean": mean}, unmet=unmet, lead_time=lead,
                         order=order, horizon={"periods": 60, "warm_up": 30},
                         training={"steps": 400})  # fmt: skip
    setup = make_setup(whole)
    alone = Evaluation(65536, sensitivity_paths=0, smooth_paths=0, judge_paths=0)
    found = solve(setup.problem, policy=setup.policy, training=setup.training, evaluation=alone,
                  engine=setup.engines)  # fmt: skip
    print(f"{unmet} K={order:g} L={lead}: {-found.value:.4f} ± {found.standard_error:.4f}, "
          f"optimum {optimum:.4f}, {-found.value / optimum - 1:+.3%}")  # fmt: skip
    assert -found.value < 1.005 * optimum
