"""Kernels stored by an earlier process: used as they are, for the same sources and numbers alone."""

import functools
import sys
from collections import OrderedDict
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.engine.native.problems import Store, Tanh
from tests.miniatures import MINIATURES

from snapo.engine.choose import choose
from snapo.engine.native import Native, call, forget_kernels, unsupported
from snapo.lanes.machine import disk
from snapo.problem.actions.sets import Box
from snapo.problem.code import described
from snapo.problem.policy import MLP
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import probe
from snapo.problem.smooth import Smooth
from snapo.study.domain import Options, load

explain = sys.modules[unsupported.__module__]
RECORD = ("state", "action", "outputs", "slack")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty cache folder; kernels of the process are forgotten before and after."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    forget_kernels()
    yield tmp_path / "snapo" / "kernels"
    forget_kernels()


@pytest.fixture
def problem_of(tmp_path):
    """A small problem of a kind."""

    def problem(kind: str):
        loaded = load(MINIATURES[kind].write(tmp_path / kind))
        study = loaded.domain.study(loaded.case, Options())
        assert study.setup is not None
        return study.setup().problem

    return problem


def run(problem, precision: str = "float64"):
    """Values with all records, and the adjoint, of 100 paths."""
    simulator, schedule = problem.simulator, problem.schedule
    features = probe(simulator, schedule)[1].shape[0]
    policy = MLP(simulator.action, features, key=jax.random.key(0), hidden=(4,))
    draws = Pseudo(0).draws(np.arange(100), simulator)
    values = Native(precision).values(
        simulator, policy, schedule, draws, Smooth(0.2), record=RECORD
    )
    weights: dict = {name: np.ones(100) for name in list(values.totals)[:1]}
    adjoint = Native(precision).adjoint(simulator, policy, schedule, draws, Smooth(0.2), weights)
    return values, adjoint


def bits(tree) -> list[tuple]:
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    return [(leaf.shape, str(leaf.dtype), leaf.tobytes()) for leaf in leaves]


def refuse(*_):
    raise AssertionError("a kernel was traced")


PROOFS = [pytest.param(kind, marks=pytest.mark.prove) for kind in ("gas-storage", "swing")]


@pytest.mark.parametrize("kind", ["inventory", *PROOFS])
def test_a_stored_kernel_gives_the_same_bits_without_a_trace(kind, problem_of, folder, monkeypatch):
    problem = problem_of(kind)
    first, stored = run(problem), set(folder.glob("*.kernel"))
    assert len(stored) >= 2
    forget_kernels()
    monkeypatch.setattr(call, "traced", refuse)
    second = run(problem)
    assert jax.tree.structure(first) == jax.tree.structure(second)
    assert bits(first) == bits(second) and set(folder.glob("*.kernel")) == stored


@pytest.mark.parametrize("kind", ["inventory", *PROOFS])
def test_choosing_an_engine_leaves_the_kernel_of_derivatives(kind, problem_of, folder, monkeypatch):
    """To examine a simulator of the package costs no kernel that evaluation does not need."""
    problem = problem_of(kind)
    features = probe(problem.simulator, problem.schedule)[1].shape[0]
    policy = MLP(problem.simulator.action, features, key=jax.random.key(0), hidden=(4,))
    monkeypatch.setattr(explain, "_reasons", OrderedDict())
    evaluation = choose("native", problem, policy).evaluate.bind(problem, controls=False)
    monkeypatch.setattr(call, "traced", refuse)
    draws = Pseudo(0).draws(np.arange(100), problem.simulator)
    evaluation.adjoint(policy, draws, Smooth(0.2), {problem.objective.outputs[0]: np.ones(100)})


def test_a_simulator_of_the_user_is_not_stored(folder):
    simulator = Store()
    draws = Pseudo(0).draws(np.arange(20), simulator)
    Native().values(simulator, Tanh((4, 14, 2)), simulator.prepare(None), draws, Smooth(0.2))
    assert not list(folder.glob("*.kernel")) and list(folder.glob("*.o"))


@pytest.mark.prove
@pytest.mark.parametrize("damage", [b"", b"snapo kernel 2\n", None], ids=["empty", "cut", "other"])
def test_a_damaged_file_is_made_again(damage, problem_of, folder):
    problem = problem_of("inventory")
    first = run(problem)
    for path in folder.glob("*.kernel"):
        content = path.read_bytes()
        path.write_bytes(content[:-1] + b"x" if damage is None else damage)
    forget_kernels()
    assert bits(run(problem)) == bits(first)
    assert all(disk.read(path) is not None for path in folder.glob("*.kernel"))


@pytest.mark.prove
def test_other_sources_have_other_kernels(problem_of, folder, monkeypatch):
    problem = problem_of("inventory")
    run(problem)
    stored = set(folder.glob("*.kernel"))
    forget_kernels()
    monkeypatch.setattr(described, "_sources", lambda: "edited")
    run(problem)
    assert len(set(folder.glob("*.kernel")) - stored) == 2


class Pair(NamedTuple):
    left: float
    right: float


class Mine:
    """A class of a user's."""


def closure(number: float):
    return lambda x: x * number


@pytest.mark.parametrize(
    "tree",
    [
        Mine(), (Mine,), closure(2.0), partial(closure(2.0), 1), Pair(1.0, 2.0), object(),
        {"a": (1, Mine())}, functools.lru_cache(np.sin), iter([1]),
    ],
)  # fmt: skip
def test_what_this_process_alone_can_compare_has_no_text(tree):
    assert described.described(tree) is None


PLAIN = [
    0.0, -0.0, 1, 1.0, True, "1", None, (), (1,), (1, (2,)), ((1, 2),), [1], float("nan"),
    np.float32(1), np.float64(1), np.dtype("float32"), jnp.tanh, jax.nn.relu, jnp.float32,
    partial(jnp.sum, axis=0), partial(jnp.sum, axis=1), Box, Box(0.0, 1.0), Box(0.0, 2.0),
    Box(0.0, 1.0, size=2), {"a": 1}, {"a": 2}, {"b": 1},
    np.zeros(3), np.zeros(4), np.zeros((3, 1)), np.zeros(3, np.float32), frozenset({1, 2}),
]  # fmt: skip


def test_texts_differ_where_the_trace_may_differ():
    texts = [described.described((item,)) for item in PLAIN]
    assert None not in texts and len(set(texts)) == len(texts)


def test_arrays_are_arguments_and_objects_of_snapo_are_compared_by_value():
    assert described.described(np.zeros(3)) == described.described(np.ones(3))
    assert described.described((Box(0.0, 1.0),)) == described.described((Box(0.0, 1.0),))
