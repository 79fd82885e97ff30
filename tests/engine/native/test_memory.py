"""Memory: nothing leaks from call to call or from kernel to kernel, and the ceiling holds."""

import gc
import os
import subprocess
import sys

import equinox as eqx
import jax
import numpy as np
import pytest
from tests.engine.native.problems import Store, Tanh

from snapo.engine.native import Native, call, runtime
from snapo.lanes.machine import disk
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Smooth

linux = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def megabytes() -> float:
    """Resident memory now."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def maps_and_threads() -> tuple[int, int]:
    with open("/proc/self/maps") as file:
        return sum(1 for _ in file), len(os.listdir("/proc/self/task"))


def caller(native: Native, paths: int = 32):
    """Values and adjoint in turn."""
    simulator, policy = Store(), Tanh((4, 14, 2))
    schedule, smooth = simulator.prepare(None), Smooth(0.2)
    draws = Pseudo(0).draws(np.arange(paths), simulator)
    weights = {"cash": np.linspace(0, 1, paths)}

    def call() -> None:
        native.values(simulator, policy, schedule, draws, smooth)
        native.adjoint(simulator, policy, schedule, draws, smooth, weights)

    return call


@linux
@pytest.mark.parametrize(
    "calls",
    [pytest.param(1_000, marks=pytest.mark.prove), pytest.param(10_000, marks=pytest.mark.study)],
)
def test_calls_leak_nothing(calls):
    """A leak of one kilobyte per call would show."""
    call = caller(Native())
    for _ in range(100):
        call()
    gc.collect()
    before, maps, threads = megabytes(), *maps_and_threads()
    for _ in range(calls // 2):
        call()
    gc.collect()
    assert megabytes() - before < max(2, calls * 2**10 / 2**20)
    after_maps, after_threads = maps_and_threads()
    assert after_threads == threads
    assert after_maps <= maps + 8


class Scaled(Store):
    """A kernel that no other factor has: the factor is compiled in."""

    factor: float = eqx.field(static=True, default=1.0)

    def step(self, constants, now, state, action, noise, smooth):
        return super().step(constants, now, state, action, self.factor * noise, smooth)


@linux
@pytest.mark.parametrize(
    "kernels",
    [pytest.param(12, marks=pytest.mark.prove), pytest.param(200, marks=pytest.mark.study)],
)
def test_kernels_that_are_dropped_leave_nothing(kernels, tmp_path, monkeypatch):
    """No maps, no objects and no memory: LLVM's passes keep some, and go with their process.

    (0.2 to 0.35 megabytes for each kernel that this process compiles; the bound is a tenth of it.)
    JAX keeps its traces until its own caches are full or cleared.
    """
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(call, "KEPT", 4)
    monkeypatch.setattr(disk, "HERE", 4)
    policy, native = Tanh((4, 14, 2)), Native()

    def some(numbers) -> None:
        for number in numbers:
            simulator = Scaled(factor=1 + number / 1000)
            draws = Pseudo(0).draws(np.arange(8), simulator)
            native.values(simulator, policy, simulator.prepare(None), draws, Smooth(0.2))
        jax.clear_caches()
        gc.collect()

    some(range(8))
    before, maps, _ = megabytes(), *maps_and_threads()
    for first in range(8, 8 + kernels, 8):
        some(range(first, first + 8))
    assert len(call._runners) <= 4
    assert maps_and_threads()[0] - maps < 50
    assert megabytes() - before < 3 + 0.03 * kernels


PEAK = """
import sys
sys.path.insert(0, {here!r})
import resource
import numpy as np
from dataclasses import replace
from tests.engine.native.problems import Store, Tanh
from snapo.engine import Window
from snapo.engine.native import Native, runtime
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Smooth

runtime.TAPE = {tape}
simulator = replace(Store(), horizon={steps})
schedule, policy = simulator.prepare(None), Tanh((4, 32, 32, 2))
def run(steps, paths):
    draws = Pseudo(0).draws(np.arange(paths), simulator)
    weights = {{"cash": np.full(paths, 1 / paths)}}
    Native(threads={threads}).adjoint(simulator, policy, schedule, draws, Smooth(0.2), weights,
        window=Window({steps} - steps, steps), wrt=("policy", "schedule"))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(run(8, 64), run({steps}, {paths}))
"""


def growth(steps: int, paths: int, tape: int, threads: int) -> float:
    """Megabytes that a large call adds to those of a small one of the same kernel, in a process of
    its own: what JAX and LLVM take is in both."""
    code = PEAK.format(here=os.getcwd(), steps=steps, paths=paths, tape=tape, threads=threads)
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    before, after = map(float, out.stdout.split())
    return after - before


@linux
@pytest.mark.study
@pytest.mark.parametrize("tape", [8, 32])
def test_memory_stays_below_the_ceiling(tape):
    """T = 3650 and N = 16384: a tape per thread, the groups' sums, and rows for every path.

    A tape of the whole horizon would take 45 megabytes.
    """
    threads, steps, paths = 2, 3650, 16384
    sums = runtime.GROUPS * steps * 64 / 2**20  # this schedule's 4 numbers of a step in float64
    rows = paths * 4 * 32 / 2**20  # final states, totals, weights, bounds, and what is returned
    assert growth(steps, paths, tape * 2**20, threads) < threads * tape + 2 * sums + rows + 8
