"""Tests compile at XLA's low level (tests/conftest.py), users at its full one: the same numbers.

The same values and gradients, of the policy and of every input, in both precisions, from one
process of each level.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.test_examples import problem

import snapo
from snapo.engine import Xla
from snapo.problem.scenarios import Sources

ROOT = Path(__file__).parents[2]
# Rounding alone: sums over paths, steps and layers are taken in another order. Of the largest
# number in the same array, as gradients cancel; where whole arrays cancel (the battery's capacity
# in float32), the low level may be as far from float64 as the full one is, times four.
TOLERANCE = {"float64": 1e-12, "float32": 2e-5}
PROGRAM = """
import json, sys
from tests.engine.test_xla_level import numbers
print(json.dumps(numbers(sys.argv[1])))
"""


def weights_of_numpy(policy):
    """The policy with other weights: JAX draws its own, which differ in the last place."""
    random = np.random.default_rng(1)

    def drawn(leaf):
        return jnp.asarray(random.normal(0, 0.3, leaf.shape), leaf.dtype)

    return jax.tree.map(lambda x: drawn(x) if eqx.is_inexact_array(x) else x, policy)


def numbers(name: str) -> dict[str, list[float]]:
    """Value and gradients of an example with an untrained network: {precision and name: array}."""
    simulator, inputs, objective = problem(name)
    made = snapo.Problem(simulator, inputs, objective, Sources.of(None, 3))
    policy = weights_of_numpy(snapo.MLP(simulator.action, made.features, key=jax.random.key(1)))
    found = {}
    for precision in TOLERANCE:
        engine, smooth = Xla(precision=precision), snapo.Smooth(0.1)
        value, gradient = snapo.value_and_gradient(
            made, policy, paths=64, smooth=smooth, engine=engine
        )
        leaves = [leaf for leaf in jax.tree.leaves(gradient.policy) if leaf is not None]
        arrays = {"value": value, "policy": np.concatenate([np.ravel(leaf) for leaf in leaves])}
        for key, array in (arrays | gradient.inputs).items():
            found[f"{precision} {key}"] = np.ravel(np.asarray(array, np.float64)).tolist()
    return found


@pytest.mark.prove
@pytest.mark.parametrize(
    "name",
    [
        "own_simulator",
        pytest.param("battery", marks=pytest.mark.study),
        pytest.param("portfolio", marks=pytest.mark.study),
    ],
)
def test_the_low_level_gives_the_numbers_of_the_full_one(name):
    found = {}
    for level in ("low", "full"):
        environment = os.environ | {
            "SNAPO_TEST_XLA": level,
            "XLA_FLAGS": os.environ["XLA_FLAGS"] if level == "low" else "",
            "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(ROOT)]),
        }
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, name],
            capture_output=True, text=True, env=environment, timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found[level] = json.loads(done.stdout.splitlines()[-1])
    assert found["low"].keys() == found["full"].keys() and len(found["low"]) > 4
    for key, full in found["full"].items():
        precision, _, what = key.partition(" ")
        exact = np.asarray(found["full"][f"float64 {what}"])
        error, own = (np.max(np.abs(found[level][key] - exact)) for level in ("low", "full"))
        size = np.max(np.abs(full))
        assert error <= TOLERANCE[precision] * size + 4 * own, (key, error, own, size)
