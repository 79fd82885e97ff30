"""Threads, forks, interruptions, segments, and kernels on disk."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from contextlib import nullcontext

import numpy as np
import pytest
from tests.engine.native.problems import Store, Tanh, difference

from snapo.engine import Xla
from snapo.engine.native import Native, explain, runtime
from snapo.engine.native.call import NativeCall, forget_kernels
from snapo.lanes.machine import disk, pipeline, threads
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Smooth

PATHS = 333


def call(engine: Native, paths: int = PATHS, seed: int = 0):
    simulator = Store()
    draws = Pseudo(seed).draws(np.arange(paths), simulator)
    weights = {"cash": np.linspace(0, 1, paths)}
    policy = Tanh((4, 14, 2))
    return engine.adjoint(simulator, policy, simulator.prepare(None), draws, Smooth(0.2), weights)


def test_the_answer_does_not_depend_on_threads():
    one, two, many = (call(Native(threads=n)) for n in (1, 2, 7))
    assert difference(one, two) == 0 and difference(one, many) == 0


def test_segments_of_the_horizon_change_nothing_but_rounding(monkeypatch):
    whole = call(Native())
    monkeypatch.setattr(runtime, "TAPE", 1)  # one step at a time
    assert difference(whole, call(Native())) < 1e-6


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_passes_of_llvm_change_nothing_but_rounding(precision, monkeypatch):
    """So that some proofs may do without them (`tests/conftest.py`)."""
    results = []
    for level in (0, 2):
        chosen = pipeline.Pipeline(speed_level=level, code_level=level)
        for module in (pipeline, disk):
            monkeypatch.setattr(module, "PIPELINE", chosen)
        forget_kernels()
        results.append(call(Native(precision)))
    assert difference(*results) < (1e-6 if precision == "float32" else 1e-14)


def test_two_engines_in_two_threads():
    expected = {p: call(Native(p)) for p in ("float32", "float64")}
    failures = []

    def work(precision: str) -> None:
        for _ in range(20):
            if difference(expected[precision], call(Native(precision))) != 0:
                failures.append(precision)

    workers = [threading.Thread(target=work, args=(p,)) for p in expected for _ in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert not failures


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:os.fork")
@pytest.mark.filterwarnings("ignore:.*fork.*")
def test_the_kernel_works_after_a_fork():
    """JAX itself may not be used after a fork, so the child runs a kernel that is ready."""
    simulator = Store()
    call(Native())
    runner = list(_runners().values())[-1]
    lanes = runner.kernel.lanes
    assert lanes > 0
    reader, writer = os.pipe()
    inputs = _captured(simulator)
    expected = runner.run(inputs, 2).back[0].call_sums.copy()
    child = os.fork()
    if child == 0:
        gc.disable()  # giving back objects of JAX may wait for locks of threads that are not here
        same = np.array_equal(runner.run(inputs, 2).back[0].call_sums, expected)
        os.write(writer, b"1" if same else b"0")
        os._exit(0)
    os.waitpid(child, 0)
    assert os.read(reader, 1) == b"1"


def _runners():
    from snapo.engine.native import call

    return call._runners


def _captured(simulator) -> runtime.KernelInputs:
    """The inputs of one run of the kernel used last."""
    kept = []
    original = runtime.Runner.run

    def run(self, inputs, threads):
        kept.append(inputs)
        return original(self, inputs, threads)

    runtime.Runner.run = run
    try:
        call(Native())
    finally:
        runtime.Runner.run = original
    return kept[-1]


INTERRUPTED = """
import signal, sys, time
# Whoever starts the tests in the background passes on that interrupts are ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.path.insert(0, {here!r})
import numpy as np
from tests.engine.native.problems import Store, Tanh
from snapo.engine.native import Native
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact
simulator = Store(horizon=2000)
schedule, policy = simulator.prepare(None), Tanh((4, 14, 2))
def run(paths):
    draws = Pseudo(0).draws(np.arange(paths), simulator)
    Native().adjoint(simulator, policy, schedule, draws, Exact(), {{"cash": np.ones(paths)}})
run(64)
print("ready", flush=True)
try:
    while True:
        run(60_000)
except KeyboardInterrupt:
    print("stopped", flush=True)
"""


@pytest.mark.prove
def test_ctrl_c_returns_promptly():
    code = INTERRUPTED.format(here=os.getcwd())
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == "ready\n"
            time.sleep(1.0)
            begin = time.perf_counter()
            child.send_signal(signal.SIGINT)
            out, _ = child.communicate(timeout=60)
            assert "stopped" in out
            assert time.perf_counter() - begin < 10
        finally:
            child.kill()


@pytest.mark.prove
def test_memory_outlives_two_interrupts(monkeypatch):
    """A helper is at work when a second Ctrl-C ends the waiting: its rows must still be there."""
    inputs = _captured(Store())
    runner = list(_runners().values())[-1]
    begun, release, done = (threading.Event() for _ in range(3))
    main = threading.current_thread()

    def slow(own, first, last):
        if threading.current_thread() is main:
            begun.wait(10)
            raise KeyboardInterrupt
        begun.set()
        release.wait(10)
        done.set()

    def interrupted(others):
        raise KeyboardInterrupt

    monkeypatch.setitem(runner.machine.functions, "run", slow)
    monkeypatch.setattr(threads, "_wait", interrupted)
    memory = weakref.ref(inputs.memory)
    with pytest.raises(KeyboardInterrupt):
        runner.run(inputs, 2)
    del inputs
    gc.collect()
    assert memory() is not None
    release.set()
    assert done.wait(10)
    for _ in range(100):
        if memory() is None:
            return
        time.sleep(0.01)
    raise AssertionError("the memory is held for ever")


def test_an_interrupt_while_helpers_start_stops_them(monkeypatch):
    stop, started = np.zeros(1), threading.Event()

    def one(group, own):
        started.set()
        time.sleep(0.01)

    def second(taken=[]):  # noqa: B006
        if taken:
            assert started.wait(10)
            raise KeyboardInterrupt
        taken.append(1)
        return helper()

    helper = threads._helper
    monkeypatch.setattr(threads, "_helper", second)
    with pytest.raises(KeyboardInterrupt):
        threads.spread(one, 1000, 3, stop, lambda: nullcontext(None))
    assert stop[0] == 1


def test_scratch_memory_of_all_kernels_together_is_bounded(monkeypatch):
    call(Native(threads=2))
    assert 0 < runtime.spare.bytes() <= runtime.SPARE
    monkeypatch.setattr(runtime, "SPARE", 1000)
    call(Native(threads=2))
    assert runtime.spare.bytes() <= 1000


def test_scratch_memory_makes_room_for_large_inputs(monkeypatch):
    """Twice the inputs of a call and the scratch memory that waits are bounded together."""
    sizes = []
    inputs = NativeCall.inputs

    def measured(self, *values):
        result = inputs(self, *values)
        sizes.append(result.memory.size)
        return result

    monkeypatch.setattr(NativeCall, "inputs", measured)
    call(Native(threads=2))
    waiting = runtime.spare.bytes()
    assert waiting > 1000
    monkeypatch.setattr(runtime, "SPARE", 2 * sizes[0] + 1000)
    call(Native(threads=2))
    assert runtime.spare.bytes() <= 1000


def test_processors_are_counted_where_the_system_knows_no_affinity(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert threads.cores() == os.cpu_count()
    assert difference(call(Native(threads=1)), call(Native())) == 0


@pytest.mark.parametrize("days", [8, 10])
def test_a_schedule_of_another_length_is_refused(days):
    simulator = Store()  # of 9 steps
    schedule = Store(horizon=days).prepare(None)
    draws = Pseudo().draws(np.arange(4), simulator)
    for engine in (Native(), Xla()):
        with pytest.raises(ValueError, match="first axis must have 9 steps"):
            engine.values(simulator, Tanh((4, 14, 2)), schedule, draws, Smooth(0.2))


def test_explain_shows_every_stage():
    store = Store()
    text = str(explain(store, policy=Tanh((4, 14, 2))))
    for part in (
        "step: one path and its transpose",
        "computed once per step",
        "define void @step_reverse",
        "tape",
    ):
        assert part in text


def test_kernels_are_found_on_disk(tmp_path, monkeypatch):
    from snapo.lanes.machine import disk

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    _runners().clear()
    expected = call(Native())
    assert list(tmp_path.rglob("*.o"))
    _runners().clear()
    monkeypatch.setattr(disk, "object_code", None)
    assert difference(expected, call(Native())) == 0
