"""A policy's trained numbers as one vector, there and back."""

import jax
import numpy as np
import pytest

import snapo
from snapo.problem.policy import trainable
from snapo.solver.learning.optimiser import Parts, flat

BOX = snapo.Box(-1.0, 1.0, 2)
KEY = jax.random.key(0)
BASE = snapo.MLP(BOX, 3, key=KEY, hidden=(4,))
POLICIES = {
    "network": BASE,
    "a base that is not trained": snapo.Residual(BASE, BOX, 3, key=KEY),
    "numbers": snapo.Constant(np.zeros(2), BOX),
}


@pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)
def test_the_trained_numbers_and_no_others_move(policy):
    parts = Parts.of(policy)
    vector = parts.vector(policy)
    assert vector.size and np.array_equal(vector, flat(trainable(policy)[0]))
    moved = parts.with_vector(policy, vector + 1)
    assert jax.tree.structure(moved) == jax.tree.structure(policy)
    assert np.array_equal(flat(trainable(moved)[0]), vector + 1)
    assert np.array_equal(flat(trainable(moved)[1]), flat(trainable(policy)[1]))


def test_a_gradient_without_the_leaves_that_are_not_trained_is_read_too():
    policy = POLICIES["a base that is not trained"]
    assert Parts.of(policy).vector(trainable(policy)[0]).size == flat(trainable(policy)[0]).size
