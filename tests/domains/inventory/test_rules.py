"""Classical rules at single states, and the search for their numbers."""

import itertools
import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from snapo.domains.inventory.policy.rules import Classical, myopic
from snapo.domains.inventory.policy.search import search
from snapo.problem.actions import Integers
from snapo.problem.smooth import Exact

UNIT, MEAN = 2.0, 3.0
LEVEL = 14.0


def seen(stock: float, *coming: float) -> jnp.ndarray:
    """The observation at this state, as the simulator makes it."""
    gap = LEVEL - stock - sum(coming)
    scaled = [(x - MEAN) / UNIT for x in (stock, *coming)]
    return jnp.asarray([gap / UNIT, UNIT, *scaled], jnp.float32)


@pytest.mark.prove
@pytest.mark.parametrize("state", [(4.0, 2.0), (0.0, 0.0), (9.0, 1.0)])
def test_the_myopic_rule_against_every_demand(state):
    """Two periods of lead time: the cheapest order for the period in which it arrives."""
    k = np.arange(20)
    chances = stats.poisson(MEAN).pmf(k)
    rule = myopic(chances, MEAN, 1.0, 4.0, 2, Integers(0, np.inf))
    stock, coming = state
    costs = []
    for order in range(15):
        cost = 0.0
        for (a, p), (b, q) in itertools.product(zip(k, chances), repeat=2):
            left = max(max(stock - a, 0.0) + coming - b, 0.0) + order
            cost += p * q * float(np.maximum(left - k, 0) @ chances
                                  + 4.0 * np.maximum(k - left, 0) @ chances)  # fmt: skip
        costs.append(cost)
    assert float(rule(seen(*state), Exact())[0]) == int(np.argmin(costs))


@pytest.mark.prove
@pytest.mark.parametrize(
    "numbers, order",
    [
        ((0.0, 1e6, 1e6), 5.0),  # base stock: 14 less 9
        ((0.0, 3.0, 1e6), 3.0),  # capped
        ((1e6, 4.0, 1e6), 4.0),  # constant
        ((2.0, 1e6, -6.0), 0.0),  # (8, 16): 9 is not below 8
        ((2.0, 1e6, -4.0), 7.0),  # (10, 16)
    ],
)
def test_classical_rules_at_a_position_of_nine(numbers, order):
    rule = Classical(*(jnp.asarray(x, jnp.float32) for x in numbers), action=Integers(0, np.inf))
    assert float(rule(seen(5.0, 4.0), Exact())[0]) == order


@pytest.mark.parametrize("size", [1, 2, 3])
def test_the_search_finds_the_lowest_point_of_its_grid(size):
    best = (2.3, -7.6, 11.2)[:size]

    def cost(point: tuple[float, ...]) -> float:
        return math.fsum((x - y) ** 2 for x, y in zip(point, best))

    assert search(cost, (0.0,) * size, 4.0, 1.0) == tuple(round(x) for x in best)
