"""The trained rule against known optima: lost sales, demand that waits, fixed costs of an order."""

import pytest
from tests.domains.inventory.inventory_cases import case
from tests.domains.inventory.references.backlog import best_base_stock
from tests.domains.inventory.test_references import DIGITS

from snapo.domains.inventory.setup import make_setup
from snapo.solver.solve import Evaluation, solve

HORIZON = {"periods": 60, "warm_up": 30}
VALUE_ALONE = Evaluation(65536, sensitivity_paths=0, smooth_paths=0, judge_paths=0)
SEEDS = pytest.mark.parametrize("seed", range(10))


def trained(of):
    """(cost of a period, standard error, seconds) of the trained rule."""
    setup = make_setup(of)
    found = solve(
        setup.problem,
        policy=setup.policy,
        training=setup.training,
        evaluation=VALUE_ALONE,
        engine=setup.engines,
    )
    return -found.value, found.standard_error, found.seconds["total"]


@SEEDS
@pytest.mark.study
def test_lost_sales_within_six_thousandths_of_every_optimum(seed):
    """All sixteen cells of Zipkin (2008), whole orders; within .3 % on average."""
    gaps = []
    for (kind, shortage), optima in DIGITS.items():
        for lead, optimum in enumerate(optima, 1):
            of = case(
                {"kind": kind, "mean": 5.0},
                lead_time=lead,
                shortage=float(shortage),
                horizon=HORIZON,
                training={"steps": 200, "seed": seed},
            )
            cost, error, seconds = trained(of)
            gaps.append(cost / optimum - 1)
            print(f"seed {seed}: {kind} p={shortage} L={lead}: {cost:.4f} ± {error:.4f}, optimum {optimum:.4f}, "
                  f"{gaps[-1]:+.3%}, {seconds:.1f} s")  # fmt: skip
            assert gaps[-1] < 0.006
    assert sum(gaps) / len(gaps) < 0.003


@SEEDS
@pytest.mark.study
@pytest.mark.parametrize("shortage, lead", [(9.0, 1), (9.0, 4), (4.0, 1)])
def test_demand_that_waits_within_four_thousandths(shortage, lead, seed):
    demand = {"kind": "normal", "mean": 5.0, "deviation": 1.6}
    of = case(demand, unmet="waits", lead_time=lead, shortage=shortage, horizon=HORIZON,
              training={"steps": 200, "seed": seed})  # fmt: skip
    cost, error, _ = trained(of)
    optimum = best_base_stock(5.0, 1.6, lead, 1.0, shortage).cost
    print(f"seed {seed}: p={shortage} L={lead}: {cost:.4f} ± {error:.4f}, optimum {optimum:.4f}, "
          f"{cost / optimum - 1:+.3%}")  # fmt: skip
    assert abs(cost / optimum - 1) < 0.004


# By `backlogged` and `lost_sales`: the first is (15, 25), the second (6, 40) of Zheng and
# Federgruen (1991), the third has no simple form.
FIXED = [
    ("waits", 5.0, 10.0, 2, 13.15522),
    ("waits", 10.0, 64.0, 0, 35.02156),
    ("lost", 5.0, 10.0, 1, 12.08956),
]


@SEEDS
@pytest.mark.study
@pytest.mark.parametrize("unmet, mean, order, lead, optimum", FIXED)
def test_fixed_costs_within_half_a_percent(unmet, mean, order, lead, optimum, seed):
    of = case({"kind": "poisson", "mean": mean}, unmet=unmet, lead_time=lead, shortage=9.0,
              order=order, horizon=HORIZON, training={"steps": 400, "seed": seed})  # fmt: skip
    cost, error, seconds = trained(of)
    print(f"seed {seed}: {unmet} K={order:g} L={lead}: {cost:.4f} ± {error:.4f}, optimum {optimum:.4f}, "
          f"{cost / optimum - 1:+.3%}, {seconds:.1f} s")  # fmt: skip
    assert cost < 1.005 * optimum
