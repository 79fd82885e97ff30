"""Policies that are recipes: made for a simulator's actions and features, or refused."""

import inspect
from importlib import import_module
from pkgutil import walk_packages

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.problem.reservoir import Reservoir, inputs

import snapo
from snapo.problem.actions import Box, Choice, Integers, Simplex
from snapo.problem.policies.memory import GRU
from snapo.problem.policies.rules import BaseStock, Constant, Linear, Threshold
from snapo.problem.policy import MLP, Policy, Residual, parameters
from snapo.problem.simulator import Interface
from snapo.problem.smooth import Exact

BOX = Interface(Box(0.0, 1.0, 2), 3)
SEEN = jnp.asarray([0.2, -1.0, 3.0])
KEY = jax.random.key(7)


@eqx.filter_jit
def decided(policy, seen=SEEN):
    """The exact decision, compiled as a whole."""
    return policy(seen, Exact())


def test_a_recipe_gives_the_same_network_as_the_explicit_form():
    recipe = MLP(hidden=(64, 64), activation=jnp.tanh)
    made = recipe.for_problem(BOX, KEY)
    explicit = MLP(BOX.action, 3, key=KEY, hidden=(64, 64), activation=jnp.tanh)
    np.testing.assert_array_equal(parameters(made), parameters(explicit))
    np.testing.assert_array_equal(decided(made), decided(explicit))
    assert not parameters(recipe).size


@pytest.mark.parametrize("action", [BOX.action, Simplex(2)], ids=["box", "simplex"])
def test_rules_start_in_the_middle_of_their_set(action):
    interface = Interface(action, 3)
    for recipe in (Constant(), Linear(), Residual(Constant(), hidden=(4,))):
        made = recipe.for_problem(interface, KEY)
        np.testing.assert_allclose(decided(made), [0.5, 0.5], atol=0.05)
    steep = decided(Linear(np.full((2, 3), [[9.0], [-9.0]]), 0.5, action))
    assert np.all((np.asarray(steep) >= 0) & (np.asarray(steep) <= 1))


def test_what_is_made_stays_itself():
    policy = MLP(BOX.action, 3, key=KEY)
    for made in (policy, Constant([0.1, 0.2]), Linear(np.ones((2, 3)))):
        assert made.for_problem(BOX, KEY) is made


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match=r"takes 5 features and decides 2 .* has 3 and 2"):
        MLP(BOX.action, 5, key=KEY).for_problem(BOX, KEY)
    with pytest.raises(ValueError, match="together, or none"):
        MLP(BOX.action, 5)
    for recipe in (MLP(), Residual(Constant()), Constant(), Linear()):
        with pytest.raises(ValueError, match="this is a recipe"):
            recipe(SEEN, Exact())


POLICIES = {
    "mlp": MLP(hidden=(4,)),
    "integers": MLP(Integers(0, 9), 3, key=jax.random.key(1), hidden=(4,)),
    "choice": MLP(Choice(3), 3, key=jax.random.key(1), hidden=(4,)),
    "residual": Residual(Constant([0.2, 0.4]), hidden=(4,)),
    "constant": Constant(),
    "linear": Linear([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0]], 0.25, Box(0.0, 1.0, 2)),
    "base stock": BaseStock(2.5),
    "threshold": Threshold(0.5, [0.0], [1.0]),
}


@pytest.mark.parametrize("name", POLICIES)
@pytest.mark.parametrize("seen", [[0.3, -0.1, 2.0], (1, 0, 2), np.array([1, 0, 2])])
def test_a_policy_is_exact_unless_told_and_takes_any_numbers(name, seen):
    policy = POLICIES[name]
    if name in ("mlp", "residual", "constant"):
        policy = policy.for_problem(BOX, jax.random.key(0))
    expected = policy(jnp.asarray(seen, jnp.float32), Exact())
    for given in (seen, np.asarray(seen, float), jnp.asarray(seen, jnp.float32)):
        np.testing.assert_array_equal(policy(given), expected)
        assert policy(given).dtype == jnp.float32


def test_every_policy_of_the_package_is_exact_unless_told():
    def below(kind):
        return [each for one in kind.__subclasses__() for each in (one, *below(one))]

    for each in walk_packages(snapo.__path__, "snapo."):
        if ".policy" in each.name or ".polic" in each.name or each.name.endswith(".rules"):
            import_module(each.name)
    kinds = [each for each in below(Policy) if each.__module__.startswith("snapo.")]
    assert len(kinds) > 15
    for kind in kinds:
        parameters = inspect.signature(kind.__call__).parameters
        assert isinstance(parameters["smooth"].default, Exact), kind


class Own(Policy):
    """A rule as the documentation writes one."""

    def __call__(self, observation, smooth=snapo.EXACT):
        return smooth.clip(2 * jnp.asarray(observation)[:1], 0.0, 1.0)


def test_a_rule_of_ones_own_may_be_exact_unless_told():
    assert Own()([0.3, 1.0]).tolist() == pytest.approx([0.6])
    problem = snapo.Problem(Reservoir(), inputs, "cash")
    assert snapo.evaluate(problem, Own(), paths=64).value > 0


def test_a_policy_that_remembers_says_what_it_takes():
    policy = GRU(Box(0.0, 1.0), 2, key=jax.random.key(0), hidden=4)
    assert policy([0.3, -0.1, 0.0, 0.0, 0.0, 0.0]).shape == (5,)
    with pytest.raises(ValueError, match="followed by the 4 numbers of the memory"):
        policy([0.3, -0.1])
