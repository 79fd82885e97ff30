"""Policies as ONNX graphs and as Python files: both decide as snapo does."""

import jax
import jax.numpy as jnp
import numpy as np
import onnxruntime
import pytest

import snapo
from snapo.domains.gas_storage.policy.network import HEAD, StoragePolicy
from snapo.domains.pension.policies.allocation import PensionPolicy
from snapo.problem.policy import Policy
from snapo.problem.smooth import Exact
from snapo.study import commands

pytestmark = pytest.mark.prove
KEY = jax.random.key(5)
BOX = snapo.Box([0.0, -1.0], [1.0, np.inf])


class Mine(Policy):
    """A rule of a user's own, with groups, selections, indices and a loop."""

    def __call__(self, observation, smooth):
        logits = observation.at[np.array([2, 0])].set(0.5 * observation[1:])[np.array([1, 0, 2])]
        shares = smooth.simplex(logits, 0.1, 0.7, [((0, 2), 0.2, 0.9)])
        gained = jnp.where(
            observation[0] > 0, jnp.log1p(observation[1] ** 2), jnp.expm1(-logits[2])
        )
        return jnp.concatenate([shares, smooth.clip(gained, -1.0, 1.0)[None]])


def _large(policy):
    """The last layer's weights twenty times larger: decisions differ by state."""

    def larger(leaf):
        small = leaf.ndim == 2 and leaf.shape[0] < 4
        return jnp.asarray(20 * np.asarray(leaf)) if small else leaf

    return jax.tree.map(larger, policy)


def net(action, **more):
    return _large(snapo.MLP(action, 3, key=KEY, **more))


# Made when they are asked for: every process of the tests reads this module.
POLICIES = {
    "box": lambda: net(BOX),
    "gelu": lambda: net(snapo.Box(0.0, 1.0), activation=jax.nn.relu),
    "simplex": lambda: net(snapo.Simplex(3)),
    "choice": lambda: net(snapo.Choice(3)),
    "stop": lambda: net(snapo.Stop(2, hazard=0.49)),
    "several": lambda: net(snapo.Product(run=snapo.Choice(2), power=snapo.Integers(0, 9))),
    "residual": lambda: _large(
        snapo.Residual(snapo.Linear(0.1 * np.ones((2, 3), np.float32), 0.5), BOX, 3, key=KEY)
    ),
    "linear": lambda: snapo.Linear(np.ones((2, 3), np.float32), 0.5, BOX),
    "constant": lambda: snapo.Constant([0.25, 0.5]),
    "base stock": lambda: snapo.BaseStock(1.5, position=1),
    "threshold": lambda: snapo.Threshold(0.1, [0.0], [1.0], feature=2),
    "mine": Mine,
}


def agree(policy, seen, features=None, observe=None, dtype="float32", tolerance=1e-6):
    """Both decide alike on the observations [states, features]."""
    model = snapo.to_onnx(policy, features=features, observe=observe, dtype=dtype)
    session = onnxruntime.InferenceSession(model.SerializeToString())
    (found,) = session.run(None, {"observation": seen.astype(dtype)})
    with jax.enable_x64(dtype == "float64"):
        given = jnp.asarray(seen, dtype)
        see = observe or (lambda raw: raw)
        decide = jax.vmap(lambda raw: policy(see(raw), Exact()).astype(raw.dtype))
        expected = np.asarray(jax.jit(decide)(given))
    assert found.shape == expected.shape and found.dtype == expected.dtype
    scale = np.maximum(1.0, np.abs(expected))
    assert np.max(np.abs(found - expected) / scale) < tolerance
    text = snapo.to_python(policy, features=features, observe=observe, dtype=dtype)
    module = {}
    exec(text, module)
    plain = module["decide"](seen)
    assert plain.shape == expected.shape and plain.dtype == expected.dtype
    assert np.max(np.abs(plain - expected) / scale) < tolerance
    np.testing.assert_allclose(module["decide"](seen[0]), plain[0], rtol=tolerance, atol=tolerance)
    with pytest.raises(ValueError, match="an observation has"):
        module["decide"](seen[:, 1:])
    return np.asarray(found)


@pytest.mark.parametrize("name", POLICIES)
def test_a_graph_decides_as_the_policy(name):
    seen = np.random.default_rng(1).normal(size=(257, 3))
    policy = POLICIES[name]()
    found = agree(policy, seen, features=3)
    if name != "constant":
        assert np.ptp(found, axis=0).max() > 0  # decisions differ
    agree(policy, seen, features=3, dtype="float64", tolerance=1e-12)


def test_the_scaling_of_observations_is_part_of_the_graph(tmp_path):
    centre, scale = np.array([50.0, 20.0, 1.0]), np.array([20.0, 10.0, 0.1])
    raw = centre + scale * np.random.default_rng(2).normal(size=(64, 3))

    def observe(numbers):
        return (numbers - centre.astype(numbers.dtype)) / scale.astype(numbers.dtype)

    policy = POLICIES["box"]()
    agree(policy, raw, features=3, observe=observe)
    snapo.to_onnx(policy, tmp_path / "policy.onnx", features=3, observe=observe)
    assert (tmp_path / "policy.onnx").stat().st_size > 1000


def test_the_head_of_a_store_and_one_state_alone():
    policy = _large(StoragePolicy(HEAD + 5, key=KEY))
    seen = 1 + 0.2 * np.random.default_rng(3).normal(size=(257, HEAD + 5))
    # Its last weights are twenty times those of a start: a few last digits of float32 are lost in sums
    # that the two add up in other orders; 1.4e-6 was seen. In float64 nothing is.
    found = agree(policy, seen, tolerance=5e-6)  # it knows its number of features
    assert np.ptp(found, axis=0).min() > 0
    agree(policy, seen[:1], tolerance=5e-6)
    agree(policy, seen, dtype="float64", tolerance=1e-12)


@pytest.mark.study
def test_the_limits_of_a_fund(tmp_path):
    commands.new("pension", tmp_path / "fund", "small")
    case = commands.load(commands.CaseRequest(tmp_path / "fund")).case
    policy = PensionPolicy(case, 4, key=KEY, hidden=(8,))
    policy = _large(policy)
    seen = np.random.default_rng(4).normal(size=(64, 4))
    # Weights are the end of a search for their level: digits of float32 are lost in it.
    agree(policy, seen, tolerance=1e-5)
    agree(policy, seen, dtype="float64", tolerance=1e-9)
    policy.save(tmp_path / "policy.npz")
    found = snapo.load_policy(tmp_path / "policy.npz")
    for row in seen[:4].astype(np.float32):
        np.testing.assert_array_equal(found(row, Exact()), policy(row, Exact()))


def test_what_cannot_be_exported_is_named():
    with pytest.raises(ValueError, match="specify features="):
        snapo.to_onnx(snapo.Constant([0.5]))

    class Sorted(Policy):
        def __call__(self, observation, smooth):
            return jnp.sort(observation)

    with pytest.raises(ValueError, match="operation sort"):
        snapo.to_onnx(Sorted(), features=3)
