"""A policy whose network adds nothing is valued without it, with the same bits."""

from functools import cache

import equinox as eqx
import jax
import numpy as np
import pytest
from tests.miniatures import MINIATURES

from snapo.engine import Native
from snapo.problem.smooth import Exact, Smooth
from snapo.study.domain import Options, load

KINDS = (
    "gas-storage",
    pytest.param("swing", marks=pytest.mark.prove),
    pytest.param("battery", marks=pytest.mark.prove),
)


@pytest.fixture(scope="module")
def setup_of(tmp_path_factory):
    """The setup of a small case, whose policy begins from the fitted value."""

    @cache
    def made(kind: str):
        loaded = load(MINIATURES[kind].write(tmp_path_factory.mktemp(kind)))
        return loaded.domain.study(loaded.case, Options()).setup()

    return made


@pytest.mark.parametrize("kind", KINDS)
def test_the_bits_of_paths_are_those_with_the_network(kind, setup_of):
    setup = setup_of(kind)
    problem, policy, engine = setup.problem, setup.policy, Native("float64")
    assert policy.network is not None and policy.simplest.network is None
    draws = problem.sources.evaluation.draws(np.arange(64), problem.simulator)
    for smooth in (Exact(), Smooth(0.01)):
        one, other = (
            engine.bind(problem, simplest=simplest).values(
                policy, draws, smooth, record=("action",)
            )
            for simplest in (True, False)
        )
        for name, total in one.totals.items():
            np.testing.assert_array_equal(total, other.totals[name])
        np.testing.assert_array_equal(one.record["action"], other.record["action"])


def test_a_network_that_adds_something_stays(setup_of):
    policy = setup_of("gas-storage").policy
    bias = policy.network.biases[-1]
    other = eqx.tree_at(lambda x: x.network.biases[-1], policy, bias.at[0].set(1e-30))
    assert other.simplest is other


def test_the_gradient_of_the_policy_is_that_of_its_network(setup_of):
    setup = setup_of("gas-storage")
    problem, engine = setup.problem, Native("float64")
    draws = problem.sources.evaluation.draws(np.arange(64), problem.simulator)
    weights = {name: np.full(64, 1 / 64) for name in problem.objective.outputs}
    result = engine.bind(problem, controls=False).adjoint(
        setup.policy, draws, Smooth(0.05), weights, wrt=("policy",)
    )
    moved = jax.tree.leaves(result.policy)
    assert any(np.any(leaf) for leaf in moved)
