"""References against published optima and integrals."""

import numpy as np
import pytest
from scipy import integrate, stats
from tests.domains.inventory.references.backlog import base_stock_cost, best_base_stock
from tests.domains.inventory.references.value_iteration import Costs, backlogged, lost_sales

# Zipkin, Operations Research 56 (2008): mean demand 5, holding cost 1; by shortage cost, by lead.
OPTIMA = {
    ("poisson", 4): (4.04, 4.40, 4.60, 4.73),
    ("poisson", 9): (5.44, 6.09, 6.53, 6.84),
    ("geometric", 4): (9.82, 10.24, 10.47, 10.61),
    ("geometric", 9): (14.51, 15.50, 16.14, 16.58),
}
# The same by `lost_sales` here, to all digits that its grids and its tolerance of 1e-5 leave.
DIGITS = {
    ("poisson", 4): (4.04071, 4.39530, 4.59872, 4.72853),
    ("poisson", 9): (5.43822, 6.09364, 6.53137, 6.83594),
    ("geometric", 4): (9.81749, 10.24021, 10.46671, 10.60650),
    ("geometric", 9): (14.50817, 15.50290, 16.13674, 16.57737),
}
CHANCES = {
    "poisson": stats.poisson(5).pmf(np.arange(60)),
    "geometric": (1 / 6) * (5 / 6) ** np.arange(400),
}
GRIDS = {  # most stock and most order by lead
    "poisson": ((40, 20), (40, 18), (36, 14), (30, 11)),
    "geometric": ((120, 50), (110, 30), (90, 22), (70, 16)),
}
LONG = {3: [pytest.mark.prove], 4: [pytest.mark.study]}


@pytest.mark.parametrize("lead", [pytest.param(i, marks=LONG.get(i, [])) for i in range(1, 5)])
@pytest.mark.parametrize("kind, shortage", OPTIMA)
def test_value_iteration_finds_the_published_optima_of_lost_sales(kind, shortage, lead):
    costs = Costs(1.0, shortage)
    found = lost_sales(CHANCES[kind], 5.0, costs, lead, *GRIDS[kind][lead - 1], 1e-5)
    # Two decimals are published.
    assert found.cost == pytest.approx(OPTIMA[kind, shortage][lead - 1], abs=0.0051)
    assert found.cost == pytest.approx(DIGITS[kind, shortage][lead - 1], abs=1e-5)
    assert found.orders.max() < GRIDS[kind][lead - 1][1]


@pytest.mark.parametrize("mean, rule, cost", [(10, (6, 40), 35.0216), (20, (14, 62), 49.1730)])
def test_value_iteration_finds_the_published_rules_with_a_fixed_cost(mean, rule, cost):
    """Zheng and Federgruen, Operations Research 39 (1991): K = 64, h = 1, p = 9, no lead time."""
    chances = stats.poisson(mean).pmf(np.arange(6 * mean))
    found = backlogged(chances, mean, Costs(1.0, 9.0, 0.0, 64.0), 0, -40, 100)
    positions = np.arange(len(found.orders)) + found.first
    ordering = found.orders > 0
    assert found.cost == pytest.approx(cost, abs=1e-4)
    assert positions[ordering].max() == rule[0]
    assert set((positions + found.orders)[ordering]) == {rule[1]}


@pytest.mark.parametrize("shortage, lead, cost", [(9, 1, 3.9711), (9, 4, 6.2788), (4, 1, 3.1674)])
def test_the_best_base_stock_of_demand_that_waits(shortage, lead, cost):
    """Mean 5, deviation 1.6, holding cost 1: the formula, an integral and the best of levels."""
    found = best_base_stock(5.0, 1.6, lead, 1.0, shortage)
    assert found.cost == pytest.approx(cost, abs=1e-4)
    law = stats.norm(5.0 * (lead + 1), 1.6 * np.sqrt(lead + 1))

    def paid(demand: float) -> float:
        left = found.level - demand
        return (left if left > 0 else -shortage * left) * law.pdf(demand)

    low, high = law.mean() - 12 * law.std(), law.mean() + 12 * law.std()
    parts = [integrate.quad(paid, a, b, epsabs=1e-12)[0] for a, b in
             ((low, found.level), (found.level, high))]  # fmt: skip
    assert sum(parts) == pytest.approx(found.cost, abs=1e-9)
    numbers = (5.0, 1.6, lead, 1.0, shortage)
    assert base_stock_cost(found.level, *numbers) == pytest.approx(found.cost, abs=1e-12)
    for off in (-0.1, 0.1):
        assert base_stock_cost(found.level + off, *numbers) > found.cost


def test_no_lead_time_is_an_order_before_the_demand():
    """Lost sales without a lead time: the newsvendor's level every period, in closed form."""
    chances = CHANCES["poisson"]
    found = lost_sales(chances, 5.0, Costs(1.0, 4.0), 0, 40, 20)
    level = int(stats.poisson(5).ppf(0.8))
    left = np.maximum(level - np.arange(60), 0) @ chances
    assert found.cost == pytest.approx(left + 4.0 * (5.0 - level + left), abs=1e-6)
    assert found.orders[0] == level
