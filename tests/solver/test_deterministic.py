"""A problem without noise: its paths are equal, so that it is valued on as few as say so."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.solver.relaxations.stop import Relaxation

PRICES = np.array([3.0, 1.0, 4.0, 2.0])


class Sale(snapo.Simulator):
    """A stock that is sold over four steps at known prices, at most three tenths in each."""

    horizon: int = 4
    action: snapo.Box = snapo.Box(0.0, 1.0)
    noise_size: int = 0

    def prepare(self, inputs):
        return snapo.Schedule({"stock": inputs["stock"]}, {"price": inputs["price"]})

    def initial(self, constants, noise):
        return {"stock": constants["stock"]}

    def observe(self, constants, now, state):
        return jnp.stack([now["price"] - 2, state["stock"]])

    def step(self, constants, now, state, action, noise, smooth):
        sold = smooth.minimum(0.3 * action[0], state["stock"], 0.1)
        return {"stock": state["stock"] - sold}, {"cash": now["price"] * sold}


INPUTS = {"stock": snapo.Input(1.0), "price": snapo.Input(PRICES)}
PROBLEM = snapo.Problem(Sale(), INPUTS, snapo.Mean("cash"))
TRAINING = snapo.Training(steps=300, paths=4, learning_rate=0.05)
BEST = 0.3 * (3 + 4 + 2) + 0.1 * 1  # all but a tenth at the three higher prices


class Noisy(Sale):
    """The same with a noise that moves nothing."""

    noise_size: int = 1


def test_equal_paths_are_as_few_as_have_an_error_whatever_is_asked_for():
    sources = PROBLEM.sources
    for source in (sources.validation, sources.evaluation):
        assert source.available(65_536) == 2
        assert [block.tolist() for block in source.blocks(2)] == [[0], [1]]
        assert source.groups(np.arange(2)).tolist() == [0, 1]
        assert source.describe(4096) == "2 equal paths, since nothing is random"
    # With noise they are again those that were given, and without it the few.
    noisy = replace(PROBLEM, simulator=Noisy())
    assert noisy.sources == snapo.Problem(Noisy(), INPUTS, snapo.Mean("cash")).sources
    assert noisy.sources.evaluation.available(65_536) == 65_536
    assert replace(noisy, simulator=Sale()).sources == sources
    assert replace(PROBLEM).sources is sources
    supplied = snapo.Supplied(np.zeros((4, 200, 0)))
    given = snapo.Problem(Sale(), INPUTS, snapo.Mean("cash"), snapo.Sources.of(supplied)).sources
    assert given.training.size == 120 and given.evaluation.available(40) == 2


def test_the_drift_is_known_from_as_few_paths():
    newer, earlier = (snapo.Constant(np.array([share])) for share in (0.2, -0.1))
    table = snapo.sensitivities(PROBLEM, newer, earlier=earlier)
    before = snapo.sensitivities(PROBLEM, earlier)
    for name in INPUTS:
        moved = table.moved[name]
        expected = table.held[name].value - before.held[name].value
        np.testing.assert_allclose(moved.value, expected, rtol=1e-12, atol=1e-12)
        assert not moved.standard_error.any()
    assert table.moved["price"].value.any()


class Plan(Relaxation):
    """The best plan of every path, which is known: no penalty."""

    terms = 0
    words = "none"

    def best(self, rolled, draws, scale):
        return np.full(draws.size, BEST)

    def charged(self, rolled, draws, scale):
        return np.zeros(draws.size)


@pytest.mark.prove
def test_value_derivatives_verdicts_and_bound_of_known_prices_have_no_error():
    """The stock's worth is the lowest price at which some is sold; a price's the quantity sold."""
    solution = snapo.solve(PROBLEM, training=TRAINING, engine="xla")
    assert solution.value == pytest.approx(BEST, abs=0.01) and solution.standard_error == 0
    assert solution.paths["evaluate"] == 2 and len(solution.totals["cash"]) == 2
    table = solution.sensitivities
    for name in INPUTS:
        assert not table.held[name].standard_error.any()
        assert not table.smooth[name].standard_error.any()
    np.testing.assert_allclose(table.held["price"].value, [0.3, 0.1, 0.3, 0.3], atol=0.01)
    assert table.verdicts["price"].bump[0] == pytest.approx(0.01 * BEST, rel=1e-3)
    found = snapo.bound(PROBLEM, solution.policy, relaxation=Plan(), penalty="none")
    assert found.paths == 2 and found.upper.value == pytest.approx(BEST)
    assert found.gap.standard_error == 0 and found.gap.value == pytest.approx(BEST - solution.value)
