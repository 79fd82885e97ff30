"""Solutions and policies go to another process of the user's own."""

import pickle
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants.double_integrator import DoubleIntegrator as Plant


def problem() -> snapo.Problem:
    inputs = make_inputs(Plant)
    return snapo.Problem(Plant(inputs, horizon=20), inputs, snapo.Mean("reward"))  # pyright: ignore


ROOT = Path(__file__).parents[3]
READS = """
import pickle, sys
import jax.numpy as jnp
import snapo
held = pickle.loads(sys.stdin.buffer.read())
print(held.value, held.policy(jnp.ones(3), snapo.Exact())[0])
"""


@pytest.mark.parametrize(
    "recipe",
    [
        snapo.MLP(), snapo.MLP(hidden=(8,), activation=jnp.tanh), snapo.GRU(), snapo.LastObservations(2),
        snapo.Residual(snapo.Constant(0.1)), snapo.Constant(0.2), snapo.Linear(),
    ],
    ids=lambda recipe: type(recipe).__name__,
)  # fmt: skip
def test_every_policy_comes_back_the_same(recipe):
    interface = problem().interface
    made = recipe.for_problem(interface, jax.random.key(0))
    for given in (recipe, made):
        back = pickle.loads(pickle.dumps(given))
        assert jax.tree.structure(back) == jax.tree.structure(given)
        for one, other in zip(jax.tree.leaves(back), jax.tree.leaves(given)):
            assert np.array_equal(one, other)


@pytest.mark.prove
def test_a_solution_goes_to_another_process():
    found = snapo.solve(
        problem(),
        training=snapo.Training(steps=3, paths=32),
        evaluation=snapo.Evaluation(64, sensitivity_paths=64, smooth_paths=32, judge_paths=32),
    )
    told = subprocess.run(
        [sys.executable, "-c", READS], input=pickle.dumps(found), capture_output=True, cwd=ROOT
    )
    assert told.returncode == 0, told.stderr.decode()
    value, action = map(float, told.stdout.split())
    assert value == found.value
    assert found.policy is not None
    assert action == pytest.approx(float(found.policy(jnp.ones(3), snapo.Exact())[0]), rel=1e-5)
