"""Groups of paths that other processes compute have the bits of one process."""

from concurrent.futures.process import BrokenProcessPool

import jax
import numpy as np
import pytest
from tests.book.books import InProcess
from tests.engine.native.problems import Store, Tanh

from snapo.engine.native import Native, distributed
from snapo.engine.native.distributed import UNKNOWN, Distributed
from snapo.engine.workers import OTHER, WorkerPool, Workers
from snapo.problem.noise import Stored
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact, Smooth

PATHS = 333
WEIGHTS = {"cash": np.linspace(0, 1, PATHS), "left": np.linspace(1, -1, PATHS)}


def over(count: int, precision="float32") -> Native:
    pools = [WorkerPool(InProcess) for _ in range(count)]
    return Native(precision, distributed=Distributed(Workers(pools)))


def drawn(simulator, stored: bool):
    draws = Pseudo(3).draws(np.arange(PATHS), simulator)
    if not stored:
        return draws
    random = np.random.default_rng(0)
    return Stored(random.normal(size=(PATHS, 1)), random.normal(size=(9, PATHS, 3)))


def gradient(engine: Native, stored: bool = False, **options):
    store = Store()
    args = store, Tanh((4, 14, 2)), store.prepare(None), drawn(store, stored), Smooth(0.2)
    return engine.adjoint(*args, options.pop("weights", WEIGHTS), **options)


def same(one, two) -> None:
    left, right = jax.tree.leaves(one), jax.tree.leaves(two)
    assert len(left) == len(right) > 3
    for x, y in zip(left, right, strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    """Workers that know no kernel, and are used for everything."""
    monkeypatch.setattr(distributed, "_runners", {})
    monkeypatch.setattr(distributed, "MIN_SECONDS", 0.0)


@pytest.mark.parametrize("stored", [False, True])
def test_gradients_have_the_same_bits(stored):
    """Of one, two and three sets of groups; with columns of weights; with noise in arrays."""
    columns = {name: np.stack([w, w[::-1]]) for name, w in WEIGHTS.items()}
    for weights in (WEIGHTS, columns):
        expected = gradient(Native(), stored, weights=weights)
        for count in (1, 2, 3):
            engine = over(count)
            same(gradient(engine, stored, weights=weights), expected)
            assert engine.distributed.runs == 1


def test_values_and_records_have_the_same_bits():
    store = Store()
    args = store, Tanh((4, 14, 2)), store.prepare(None), drawn(store, False), Exact()
    for record in ((), ("state", "action")):
        one = Native("float64").values(*args, record=record)
        same(over(2, precision="float64").values(*args, record=record), one)


@pytest.mark.parametrize("stored", [False, True])
def test_parts_of_the_paths_have_the_same_bits(stored):
    """Sensitivities by block: recorded decisions, and a sum for every part."""
    store = Store()
    actions = np.random.default_rng(1).uniform(size=(9, PATHS, 2))
    values = store, None, store.prepare(None), drawn(store, stored), Exact(), WEIGHTS
    parts = (100, 33, 64, 64, 72)
    one, two = (
        engine.adjoints(*values, parts, actions=actions, wrt=("schedule",))
        for engine in (Native("float64"), over(2, precision="float64"))
    )
    same(two, one)


def test_a_worker_asks_once_for_the_text_of_a_kernel(monkeypatch):
    answers, before = [], distributed.compute

    def compute(job: bytes) -> bytes:
        answers.append(before(job))
        return answers[-1]

    monkeypatch.setattr(distributed, "compute", compute)
    engine = over(2)
    first, second = gradient(engine), gradient(engine)
    same(second, first)
    assert [answer == UNKNOWN for answer in answers].count(True) <= 2 < len(answers)
    assert UNKNOWN not in answers[-2:]


@pytest.mark.parametrize("reply", [OTHER, None])
def test_without_workers_that_can_this_process_computes(reply, monkeypatch):
    """Of another processor, or that fail: the bits are the same, and a note says so."""

    def compute(job: bytes) -> bytes:
        if reply is None:
            raise MemoryError("too large")
        return reply

    monkeypatch.setattr(distributed, "compute", compute)
    engine = over(2)
    same(gradient(engine), gradient(Native()))
    note = engine.distributed.note
    assert ("too large" if reply is None else "processor") in note and engine.distributed.runs == 0


def test_a_lost_answer_is_computed_again(monkeypatch):
    lost, before = [], distributed.compute

    def compute(job: bytes) -> bytes:
        answer = before(job)
        if answer != UNKNOWN and not lost:
            lost.append(job)
            raise BrokenProcessPool("killed")
        return answer

    monkeypatch.setattr(distributed, "compute", compute)
    engine = over(2)
    same(gradient(engine), gradient(Native()))
    assert lost and engine.distributed.runs == 1 and not engine.distributed.note


class Shut(InProcess):
    """An executor that somebody has shut down."""

    def submit(self, fn, /, *args, **kwargs):
        raise RuntimeError("cannot schedule new futures after shutdown")


def test_an_executor_that_was_shut_down_is_left_out():
    pools = [WorkerPool.of(Shut()), WorkerPool.of(InProcess())]
    for part, runs in ((pools, 1), (pools[:1], 0)):
        engine = Native(distributed=Distributed(Workers(part)))
        same(gradient(engine), gradient(Native()))
        assert engine.distributed.runs == runs
        assert ("broken" in engine.distributed.note) == (not runs)


def test_short_runs_stay_here(monkeypatch):
    monkeypatch.setattr(distributed, "MIN_SECONDS", 0.05)
    engine = over(2)
    for _ in range(3):
        same(gradient(engine), gradient(Native()))
    assert engine.distributed.runs == 0
    assert "workers save time from 50 ms on" in engine.distributed.note


def test_long_runs_go_to_workers_after_one_of_them_was_timed(monkeypatch):
    monkeypatch.setattr(distributed, "MIN_SECONDS", 1e-9)
    monkeypatch.setattr(distributed, "RATE", np.inf)
    engine = over(2)
    for runs in (0, 1, 2):
        gradient(engine)
        assert engine.distributed.runs == runs
    assert engine.distributed.note == ""
