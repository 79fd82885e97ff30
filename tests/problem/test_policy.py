"""Policies that are recipes: made for a simulator's actions and features, or refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.problem.actions import Box, Simplex
from snapo.problem.policy import MLP, Constant, Linear, Residual, parameters
from snapo.problem.simulator import Interface
from snapo.problem.smooth import Exact

BOX = Interface(Box(0.0, 1.0, 2), 3)
SEEN = jnp.asarray([0.2, -1.0, 3.0])
KEY = jax.random.key(7)


def test_a_recipe_gives_the_same_network_as_the_explicit_form():
    recipe = MLP(hidden=(64, 64), activation=jnp.tanh)
    made = recipe.for_problem(BOX, KEY)
    explicit = MLP(BOX.action, 3, key=KEY, hidden=(64, 64), activation=jnp.tanh)
    np.testing.assert_array_equal(parameters(made), parameters(explicit))
    np.testing.assert_array_equal(made(SEEN, Exact()), explicit(SEEN, Exact()))
    assert not parameters(recipe).size


@pytest.mark.parametrize("action", [BOX.action, Simplex(2)], ids=["box", "simplex"])
def test_rules_start_in_the_middle_of_their_set(action):
    interface = Interface(action, 3)
    for recipe in (Constant(), Linear(), Residual(Constant(), hidden=(4,))):
        made = recipe.for_problem(interface, KEY)
        np.testing.assert_allclose(made(SEEN, Exact()), [0.5, 0.5], atol=0.05)
    steep = Linear(np.full((2, 3), [[9.0], [-9.0]]), 0.5, action)(SEEN, Exact())
    assert np.all((np.asarray(steep) >= 0) & (np.asarray(steep) <= 1))


def test_what_is_made_stays_itself():
    policy = MLP(BOX.action, 3, key=KEY)
    for made in (policy, Constant([0.1, 0.2]), Linear(np.ones((2, 3)))):
        assert made.for_problem(BOX, KEY) is made


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match=r"takes 5 features and gives 2 .* has 3 and 2"):
        MLP(BOX.action, 5, key=KEY).for_problem(BOX, KEY)
    with pytest.raises(ValueError, match="together, or none"):
        MLP(BOX.action, 5)
    for recipe in (MLP(), Residual(Constant()), Constant(), Linear()):
        with pytest.raises(ValueError, match="this is a recipe"):
            recipe(SEEN, Exact())
