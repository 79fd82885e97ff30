"""Several rules as one policy: it decides, and learns, as the one at its place."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.domains.pension.policies.classical import OneOf
from snapo.problem.policies.rules import Constant, Linear
from snapo.problem.smooth import Exact

SEEN = jnp.asarray([0.3, -0.2])
RULES = (
    Constant(np.array([0.1, 0.9])),
    Linear(np.array([[1.0, 2.0], [0.5, 0.0]]), np.array([0.4, 0.6])),
    Constant(np.array([0.7, 0.2])),
)


@pytest.mark.parametrize("place", range(3))
def test_it_decides_and_learns_as_the_rule_at_its_place(place):
    policy = OneOf(RULES, place)
    assert policy.rule is RULES[place]
    found, wanted = policy(SEEN, Exact()), RULES[place](SEEN, Exact())
    np.testing.assert_allclose(found, wanted, rtol=1e-6)

    def first(policy):
        return policy(SEEN, Exact())[0]

    slopes, own = eqx.filter_grad(first)(policy), eqx.filter_grad(first)(RULES[place])
    for i, each in enumerate(slopes.rules):
        for leaf, alone in zip(jax.tree.leaves(each), jax.tree.leaves(own)):
            if i == place:
                np.testing.assert_allclose(leaf, alone, rtol=1e-6)
        assert i == place or not any(map(np.any, jax.tree.leaves(each)))
