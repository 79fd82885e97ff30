"""Threads, forks, interruptions, segments, and kernels on disk."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from tests.engine.native.problems import Store, Tanh, difference

from snapo.engine.native import Native, explain, runtime
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


def test_two_engines_in_two_threads():
    expected = {p: call(Native(p)) for p in ("float32", "float64")}
    failures = []

    def work(precision: str) -> None:
        for _ in range(20):
            if difference(expected[precision], call(Native(precision))) != 0:
                failures.append(precision)

    threads = [threading.Thread(target=work, args=(p,)) for p in expected for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
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
    expected = runner.run(inputs, 2).call_sums.copy()
    child = os.fork()
    if child == 0:
        same = np.array_equal(runner.run(inputs, 2).call_sums, expected)
        os.write(writer, b"1" if same else b"0")
        os._exit(0)
    os.waitpid(child, 0)
    assert os.read(reader, 1) == b"1"


def _runners():
    from snapo.engine.native import call

    return call._runners


def _captured(simulator) -> runtime.Inputs:
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
