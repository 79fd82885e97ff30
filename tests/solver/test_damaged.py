"""Checkpoints that are damaged, cut short or another thing: refused in words, or read whole."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest

from snapo.problem.actions import Box
from snapo.problem.policies.rules import Constant
from snapo.problem.policy import MLP, Residual
from snapo.solver import checkpoint
from snapo.solver.derivatives import solution_file
from snapo.solver.train import Progress, Record, Training, initial_progress


@pytest.fixture(scope="module")
def progress() -> Progress:
    policy = MLP(Box(-np.inf, np.inf, 2), 3, key=jax.random.key(0), hidden=(4,))
    record = Record(1, 0.5, 0.1, 0.02, 0, 0.5, 0.5, 1.0)
    return replace(
        initial_progress(policy, Training(steps=3)), step=1, best_value=0.5, history=(record,)
    )


def same(a: Progress, b: Progress) -> bool:
    trees = ([getattr(p, name) for name in checkpoint._TREES] for p in (a, b))
    leaves = zip(*map(jax.tree.leaves, trees), strict=True)
    equal = all(_equal(x, y) for x, y in leaves)
    plain = [(p.step, p.best_value, p.stale, p.status, p.history) for p in (a, b)]
    return equal and plain[0] == plain[1]


def _equal(x, y) -> bool:
    return x is y if callable(x) else np.array_equal(np.asarray(x), np.asarray(y))


def read(file, progress: Progress) -> None:
    """Either the same progress, or a message that names the file."""
    try:
        found = checkpoint.load(file, progress)
    except solution_file.CheckpointError as error:
        assert str(file) in str(error) and "\n" not in str(error)
    else:
        assert same(found, progress)


@pytest.fixture
def file(tmp_path, progress):
    checkpoint.save(progress, tmp_path / "checkpoint.npz")
    assert same(checkpoint.load(tmp_path / "checkpoint.npz", progress), progress)
    return tmp_path / "checkpoint.npz"


def test_a_file_that_is_cut_short(file, progress):
    data = file.read_bytes()
    for part in range(20):
        file.write_bytes(data[: len(data) * part // 20])
        with pytest.raises(solution_file.CheckpointError, match="cannot be read"):
            checkpoint.load(file, progress)


def test_a_byte_that_is_flipped(file, progress):
    """In local headers, arrays, JSON and the central directory: every 29th byte, each bit once."""
    data = file.read_bytes()
    for number, place in enumerate(range(0, len(data), 29)):
        spoilt = bytearray(data)
        spoilt[place] ^= 1 << number % 8
        file.write_bytes(spoilt)
        read(file, progress)


def test_another_kind_of_file(file, progress, tmp_path):
    policy = progress.policy
    others = {
        "text": b"step,objective\n1,2\n",
        "json": json.dumps({"step": 1}).encode(),
        "a zip": b"PK\x05\x06" + b"\0" * 18,
        "a pickle": b"\x80\x04N.",
    }
    for content in others.values():
        file.write_bytes(content)
        with pytest.raises(solution_file.CheckpointError):
            checkpoint.load(file, progress)
    checkpoint.save_arrays(file, {"policy": policy}, {"versions": {}})
    with pytest.raises(solution_file.CheckpointError, match="another shape"):
        checkpoint.load(file, progress)
    trees = {name: getattr(progress, name) for name in checkpoint._TREES}
    for header in ({}, [], {"step": 1, "best_value": 0.0, "stale": 0, "status": "", "history": 3}):
        checkpoint.save_arrays(file, trees, header)  # pyright: ignore[reportArgumentType]
        with pytest.raises(solution_file.CheckpointError, match="not the checkpoint of a training"):
            checkpoint.load(file, progress)
    with pytest.raises(solution_file.CheckpointError, match="cannot be read"):
        checkpoint.load(tmp_path, progress)
    np.savez(file, leaf_0=np.zeros(3))
    with pytest.raises(solution_file.CheckpointError, match="cannot be read"):
        checkpoint.load(file, progress)


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (
            MLP(
                Box(-np.inf, np.inf, 2),
                3,
                key=jax.random.key(0),
                hidden=(4,),
                activation=jax.nn.tanh,
            ),
            "tanh",
        ),
        (MLP(Box(-np.inf, 5.0, 2), 3, key=jax.random.key(0), hidden=(4,)), "action.high is inf"),
        (
            Residual(
                Constant([0.0, 0.0]), Box(-np.inf, np.inf, 2), 3, key=jax.random.key(0), hidden=(4,)
            ),
            "Residual",
        ),
    ],
)
def test_a_policy_of_the_same_shape_that_is_another_one(file, progress, other, named):
    """Another activation, other actions: the same numbers would be another rule."""
    with pytest.raises(solution_file.CheckpointError, match="contains a") as refused:
        checkpoint.load(file, initial_progress(other, Training(steps=3)))
    assert named in str(refused.value) or "another shape" in str(refused.value)
