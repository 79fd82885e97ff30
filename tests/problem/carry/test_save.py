"""A policy in a file that describes itself: as it was, or refused in words."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.problem.carry.arrays import read_arrays, replacing, write_arrays
from snapo.problem.policy import Network, Policy

KEY = jax.random.key(3)
BOX = snapo.Box([0.0, -1.0], [1.0, np.inf])
SEVERAL = snapo.Product(run=snapo.Choice(2), power=snapo.Integers(0, 9))
# Made when they are asked for: every process of the tests reads this module.
POLICIES = {
    "network": lambda: snapo.MLP(BOX, 3, key=KEY, hidden=(4,), activation=jax.nn.tanh),
    "shares": lambda: snapo.MLP(snapo.Simplex(3), 3, key=KEY, hidden=(4, 5)),
    "residual": lambda: snapo.Residual(
        snapo.Constant([0.5, 0.5]), BOX, 3, key=KEY, hidden=(4,), scale=0.3
    ),
    "linear": lambda: snapo.Linear(np.ones((2, 3), np.float32), 0.5, BOX),
    "several": lambda: snapo.MLP(SEVERAL, 3, key=KEY, hidden=(4,)),
    "base stock": lambda: snapo.BaseStock(12.5, position=1, scale=2.0),
    "threshold": lambda: snapo.Threshold(1.0, [0.0], [1.0], feature=2),
    "recipe": lambda: snapo.MLP(hidden=(8,)),
}


@pytest.mark.parametrize("name", POLICIES)
def test_a_policy_comes_back_as_it_was(name, tmp_path):
    policy = POLICIES[name]()
    policy.save(tmp_path / "policy.npz")
    found = snapo.load_policy(tmp_path / "policy.npz")
    assert type(found) is type(policy)
    assert jax.tree.structure(found) == jax.tree.structure(policy)
    for new, old in zip(jax.tree.leaves(found), jax.tree.leaves(policy)):
        assert type(new) is type(old) and new.dtype == old.dtype
        np.testing.assert_array_equal(new, old)


class Mine(Policy):
    """A class of a user's own."""

    level: float = 1.0

    def __call__(self, observation, smooth):
        return observation[:1]


def _mine_too(x):
    return x


@pytest.mark.parametrize(
    "policy, words",
    [
        (Mine(), "it is of class Mine"),
        (snapo.Residual(Mine()), "its policy.base.array is Mine"),
        (snapo.MLP(activation=_mine_too), "its policy.activation is _mine_too"),
    ],
)
def test_code_of_ones_own_is_refused_with_what_to_give(policy, words, tmp_path):
    with pytest.raises(snapo.PolicyFileError) as told:
        policy.save(tmp_path / "policy.npz")
    assert words in str(told.value) and "like=policy" in str(told.value)
    assert not list(tmp_path.iterdir())


def _file(tmp_path, change) -> Path:
    """The file of a network, its header changed."""
    file = tmp_path / "policy.npz"
    POLICIES["network"]().save(file)
    arrays, header = read_arrays(file)
    header = change(header, arrays) or header
    write_arrays(file, arrays, header)
    return file


@pytest.mark.parametrize(
    "change",
    [
        lambda header, arrays: [1, 2],
        lambda header, arrays: {"header": 1},
        lambda header, arrays: header | {"snapo policy": 99},
        lambda header, arrays: header | {"policy": {"kind": "system", "fields": {}}},
        lambda header, arrays: header | {"policy": {"function": "eval"}},
        lambda header, arrays: header | {"policy": {"array": 10**9, "numpy": True}},
        lambda header, arrays: header | {"policy": {"kind": "Box", "fields": {}}},
        lambda header, arrays: header | {"features": 2},
        lambda header, arrays: header | {"features": "many"},
        lambda header, arrays: header["policy"]["fields"].update(other=1),
        lambda header, arrays: header["policy"]["fields"].pop("network"),
        lambda header, arrays: arrays.update(leaf_0=np.ones((9, 9), np.float32)),
        lambda header, arrays: arrays.update(leaf_0=np.array("text")),
        lambda header, arrays: header | {"policy": json.loads("[" * 400 + "]" * 400)},
    ],
)
def test_a_file_of_another_kind_is_refused(change, tmp_path):
    file = _file(tmp_path, change)
    with pytest.raises(snapo.PolicyFileError, match=r"policy\.npz"):
        snapo.load_policy(file)


def test_every_damaged_byte_is_refused_or_harmless(tmp_path):
    file = tmp_path / "policy.npz"
    POLICIES["network"]().save(file)
    whole = file.read_bytes()
    rng = np.random.default_rng(0)
    for place in rng.choice(len(whole), 60, replace=False):
        broken = bytearray(whole)
        broken[place] ^= 0xFF
        file.write_bytes(bytes(broken))
        try:
            found = snapo.load_policy(file)
        except snapo.PolicyFileError:
            continue
        assert isinstance(found, Policy)
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(snapo.PolicyFileError):
        snapo.load_policy(file)
    with pytest.raises(snapo.PolicyFileError):
        snapo.load_policy(tmp_path / "nowhere.npz")


def test_a_file_with_pickles_is_refused(tmp_path):
    file = tmp_path / "policy.npz"
    np.savez(file, header=np.array([Network], object))
    with pytest.raises(snapo.PolicyFileError):
        snapo.load_policy(file)
    assert jnp.asarray(1) == 1


def test_two_writers_of_one_file_do_not_meet_and_a_failure_changes_nothing(tmp_path):
    file = tmp_path / "table.csv"
    with replacing(file, shared=True) as first, replacing(file, shared=True) as second:
        first.write_text("first")
        second.write_text("second")
    assert file.read_text() == "first"  # its block ends last
    for shared in (False, True):
        with pytest.raises(OSError), replacing(file, shared) as partial:
            partial.write_text("half")
            raise OSError
    assert file.read_text() == "first" and list(tmp_path.iterdir()) == [file]
