"""The native engine against XLA (and PyTorch, where it is installed): ratios from alternating runs.

    python -m benchmarks.native [--quick]

Every figure is a median over rounds in which the engines take turns, so that a busy machine slows
them alike. The floor is the time of only the multiply-adds of a network's forward pass and its two
transposes, done in registers by all threads; it is measured in the same rounds. No engine can be
faster relative to XLA than the floor is, unless it leaves out products with zero.
"""

import argparse
import ctypes
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from statistics import median

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.lanes.machine.linked import Linked
from snapo.lanes.machine.pipeline import host, object_code
from snapo.lanes.machine.threads import cores
from snapo.problem.actions import Box
from snapo.problem.noise import Stored
from snapo.problem.policy import Network, Policy
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Smooth

ROUNDS = 7


class Storage(Simulator):
    """Gas storage with a three-factor price and rates that depend on the inventory."""

    horizon: int = eqx.field(static=True, default=341)
    action: Box = eqx.field(default=Box(-math.inf, math.inf, 3))
    noise_size: int = eqx.field(static=True, default=3)

    def prepare(self, inputs):
        days = np.linspace(0, 1, self.horizon, dtype=np.float32)
        return Schedule({}, {"forward": 16 + np.sin(6 * days), "day": days})

    def initial(self, constants, noise):
        return {"factors": jnp.zeros(3), "level": jnp.asarray(0.2)}

    def observe(self, constants, now, state):
        factors = state["factors"]
        spot = jnp.exp(0.85 * factors[0] + 0.3 * factors[1] + 0.1 * factors[2])
        market = jnp.stack([now["forward"] / 16 - 1, spot - 1, now["day"], state["level"]])
        return jnp.concatenate([factors, market])

    def step(self, constants, now, state, action, noise, smooth):
        factors = state["factors"] * jnp.array([0.78, 1, 1]) + noise * jnp.array([0.05, 0.05, 0.05])
        spot = 0.85 * factors[0] + 0.3 * factors[1] + 0.1 * factors[2] - 0.05
        price = now["forward"] * jnp.exp(spot)
        level = state["level"]
        injection, withdrawal = (250 - 118 * level) / 7000, (150 + 125 * level) / 7000
        fraction = jax.nn.sigmoid(action)
        up = smooth.minimum(fraction[0] * injection, 1 - level, scale=0.01)
        down = smooth.minimum(fraction[1] * withdrawal, level, scale=0.01)
        cash = (down - up) * price - 0.01 * up - 0.025 * down + 0.001 * fraction[2]
        return {"factors": factors, "level": level + up - down}, {"cash": cash}

    def terminal(self, constants, state, smooth):
        return {"cash": -(state["level"] ** 2)}


class Correlated(Simulator):
    """300 factors moved by correlated noise: a 300 x 300 matrix-vector product per step.

    The matrix is triangular, as a Cholesky factor is; `dense` fills it.
    """

    dense: bool = eqx.field(static=True, default=False)
    horizon: int = eqx.field(static=True, default=50)
    action: Box = eqx.field(default=Box(-math.inf, math.inf))
    noise_size: int = eqx.field(static=True, default=300)

    def prepare(self, inputs):
        rng = np.random.default_rng(0)
        lower = rng.normal(size=(300, 300)).astype(np.float32) / 300
        lower = lower if self.dense else np.tril(lower)
        return Schedule({"lower": lower}, {"day": np.arange(self.horizon, dtype=np.float32)})

    def initial(self, constants, noise):
        return {"factors": jnp.zeros(300)}

    def observe(self, constants, now, state):
        return state["factors"][:4]

    def step(self, constants, now, state, action, noise, smooth):
        factors = 0.95 * state["factors"] + constants["lower"] @ noise
        return {"factors": factors}, {"cash": action[0] * jnp.tanh(factors).sum()}


class Plain(Policy):
    """A network whose outputs are the action."""

    network: Network

    def __call__(self, observation, smooth):
        return self.network(observation)


class Workload:
    """One row of the table: both engines, ready to run."""

    def __init__(
        self, simulator, widths, paths=1024, precision="float32", activation=jnp.tanh, table=False
    ):
        self.simulator, self.paths, self.precision = simulator, paths, precision
        self.widths = widths
        self.schedule = simulator.prepare(None)
        self.policy = Plain(Network(widths, key=jax.random.key(0), activation=activation))
        self.draws = Pseudo(1, antithetic=False).draws(np.arange(paths), simulator)
        if table:
            rng = np.random.default_rng(0)
            noise = rng.normal(size=(simulator.horizon, paths, simulator.noise_size))
            self.draws = Stored(np.zeros((paths, 0)), jnp.asarray(noise, precision))
        self.weights = {"cash": np.ones(paths, precision) / paths}
        self.smooth = Smooth(0.3)

    def adjoint(self, which) -> Callable:
        args = (self.simulator, self.policy, self.schedule, self.draws, self.smooth, self.weights)
        return lambda: jax.block_until_ready(which(precision=self.precision).adjoint(*args))

    def multiply_adds(self) -> int:
        """Multiply-adds of the gradient: the network's forward and two products back, and a full
        matrix's product with the noise, forward and in its gradient."""
        products = 3 * sum(a * b for a, b in pairwise(self.widths))
        if isinstance(self.simulator, Correlated):
            products += 2 * self.simulator.noise_size**2
        return products * self.simulator.horizon * self.paths

    def values(self) -> Callable:
        args = (self.simulator, self.policy, self.schedule, self.draws, self.smooth)
        return lambda: jax.block_until_ready(Native(self.precision).values(*args))


def alternate(*calls: Callable, rounds: int = ROUNDS) -> list[float]:
    """Median milliseconds of each call, which take turns; short calls repeat within a round."""
    repeats = []
    for call in calls:
        call()
        begin = time.perf_counter()
        call()
        repeats.append(max(1, int(0.05 / (time.perf_counter() - begin))))
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(rounds):
        for call, repeat, kept in zip(calls, repeats, times):
            begin = time.perf_counter()
            for _ in range(repeat):
                call()
            kept.append(1000 * (time.perf_counter() - begin) / repeat)
    return [median(kept) for kept in times]


CHAINS, TURNS = 12, 2_000_000  # enough to hide the latency, few enough for 16 registers


def multiply_adds(threads: int) -> tuple[Callable, int]:
    """A call in which every thread multiplies and adds in registers, and its number of
    multiply-adds."""
    register = host().register
    lanes = register // 4
    kind = f"<{lanes} x float>"
    lines = ["define void @run(ptr %out, i64 %a, i64 %b) #0 {\nentry:\n  br label %loop\nloop:"]
    lines += ["  %i = phi i64 [ 0, %entry ], [ %j, %loop ]"]
    lines += [
        f"  %x{k} = phi {kind} [ zeroinitializer, %entry ], [ %y{k}, %loop ]" for k in range(CHAINS)
    ]
    one = f"{kind} splat (float 1.0)"
    half = f"{kind} splat (float 0.5)"
    name = f"@llvm.fma.v{lanes}f32"
    lines += [f"  %y{k} = call {kind} {name}({kind} %x{k}, {half}, {one})" for k in range(CHAINS)]
    lines += [f"  %j = add i64 %i, 1\n  %more = icmp slt i64 %j, {TURNS}"]
    lines += ["  br i1 %more, label %loop, label %exit\nexit:", f"  %s0 = fadd {kind} %y0, %y1"]
    lines += [f"  %s{k} = fadd {kind} %s{k - 1}, %y{k + 1}" for k in range(1, CHAINS - 1)]
    lines += [f"  store {kind} %s{CHAINS - 2}, ptr %out, align 4\n  ret void\n}}"]
    lines += [f"declare {kind} {name}({kind}, {kind}, {kind})"]
    bits = 8 * register
    lines += [
        f'attributes #0 = {{ "prefer-vector-width"="{bits}" "min-legal-vector-width"="{bits}" }}'
    ]
    machine = Linked(object_code("\n".join(lines)), {"run": 2})
    outs = [np.zeros(64, np.float32) for _ in range(threads)]
    pool = ThreadPoolExecutor(threads)

    def call() -> None:
        run = machine.functions["run"]
        list(pool.map(lambda out: run(ctypes.c_void_p(out.ctypes.data), 0, 0), outs))

    return call, threads * TURNS * CHAINS * lanes


def rows(quick: bool):
    """(name, required ratio, workload)."""
    wide = (7, 32, 32, 3)
    yield "storage, float32", 10, Workload(Storage(), wide)
    yield "storage, float32, noise supplied", 10, Workload(Storage(), wide, table=True)
    yield "storage, float64", 8, Workload(Storage(), wide, precision="float64")
    yield "64 paths", 5, Workload(Storage(), wide, paths=64)
    if quick:
        return
    yield "16384 paths", 5, Workload(Storage(), wide, paths=16384)
    for width, needed in ((16, 5), (64, 7), (128, 4)):
        yield f"width {width}", needed, Workload(Storage(), (7, width, width, 3))
    yield "silu", 5, Workload(Storage(), wide, activation=jax.nn.silu)
    yield "relu", 5, Workload(Storage(), wide, activation=jax.nn.relu)
    yield "3650 steps", 7, Workload(Storage(horizon=3650), wide)
    yield "300 correlated factors", 5, Workload(Correlated(), (4, 8, 1))
    yield "300 factors, full matrix", 5, Workload(Correlated(dense=True), (4, 8, 1))


TORCH = """
import math, time, torch
torch.set_num_threads({threads})
T, N = 341, {paths}
sizes = (7, 32, 32, 3)
layers = [m for a, b in zip(sizes, sizes[1:]) for m in (torch.nn.Linear(a, b), torch.nn.Tanh())]
net = torch.nn.Sequential(*layers[:-1])
forward = torch.full((T,), 16.0, requires_grad=True)
noise = torch.randn(T, N, 3)
decay, shock = torch.tensor([0.78, 1, 1]), torch.tensor([0.05, 0.05, 0.05])
load = torch.tensor([0.85, 0.3, 0.1])
def run():
    f, level, cash = torch.zeros(N, 3), torch.full((N,), 0.2), torch.zeros(N)
    for t in range(T):
        spot = torch.exp(f @ load)
        day = torch.full((N,), t / T)
        market = [(forward[t] / 16 - 1).expand(N), spot - 1, day, level]
        x = torch.cat([f, torch.stack(market, 1)], 1)
        a = torch.sigmoid(net(x))
        f = f * decay + noise[t] * shock
        price = forward[t] * torch.exp(f @ load - 0.05)
        up = torch.minimum(a[:, 0] * (250 - 118 * level) / 7000, 1 - level)
        down = torch.minimum(a[:, 1] * (150 + 125 * level) / 7000, level)
        cash = cash + (down - up) * price - 0.01 * up - 0.025 * down + 0.001 * a[:, 2]
        level = level + up - down
    (cash - level ** 2).mean().backward()
run()
times = []
for _ in range(5):
    begin = time.perf_counter(); run(); times.append(time.perf_counter() - begin)
print(1000 * sorted(times)[2])
"""


def torch_milliseconds(python: str, threads: int) -> float | None:
    """The time of the same rollout in PyTorch (eager), in an interpreter that has it."""
    code = TORCH.format(threads=threads, paths=1024)
    done = subprocess.run([python, "-c", code], capture_output=True, text=True, check=False)
    return float(done.stdout) if done.returncode == 0 else None


FIRST = """
import time
from benchmarks.native import Native, Storage, Workload
work = Workload(Storage(), (7, 32, 32, 3))
args = (work.simulator, work.policy, work.schedule, work.draws, work.smooth, work.weights)
begin = time.perf_counter()
Native().adjoint(*args)
print(time.perf_counter() - begin)
"""


def first_results() -> tuple[float, float]:
    """Seconds to the first gradient of a new process: without a cache, and with its kernel."""
    with tempfile.TemporaryDirectory() as folder:
        seconds = [
            float(
                subprocess.run(
                    [sys.executable, "-c", FIRST],
                    env=os.environ | {"XDG_CACHE_HOME": place},
                    capture_output=True,
                    text=True,
                    check=True,
                ).stdout
            )
            for place in (f"{folder}/{i}" for i in (0, 1, 2, 2, 2, 2, 2, 2))
        ]
    return median(seconds[:3]), median(seconds[3:])


def table(quick: bool = False, python: str = sys.executable) -> Iterator[str]:
    """The lines of the table, each as soon as it is known; `python` is one that may have torch."""
    threads = cores()
    spin, spun = multiply_adds(threads)
    (alone,) = alternate(spin)
    yield f"{threads} threads, {2e-6 * spun / alone:.0f} GFLOP/s in registers"
    yield (
        f"{'workload':34}{'native ms':>10}{'XLA ms':>10}{'ratio':>8}{'needed':>8}"
        f"{'gradient/value':>16}{'over floor':>12}"
    )
    for name, needed, work in rows(quick):
        native, xla, values, spinning = alternate(
            work.adjoint(Native),
            work.adjoint(Xla),
            work.values(),
            spin,
            rounds=3 if work.paths > 9000 else ROUNDS,
        )
        single = 4 / np.dtype(work.precision).itemsize  # the floor is of float32
        floor = spinning * work.multiply_adds() / spun / single
        yield (
            f"{name:34}{native:10.1f}{xla:10.1f}{xla / native:8.1f}{needed:8}"
            f"{native / values:16.2f}{native / floor:12.2f}"
        )
    work = Workload(Storage(), (7, 32, 32, 3))
    args = (work.simulator, work.policy, work.schedule, work.draws, work.smooth, work.weights)
    one, two, spinning = alternate(
        lambda: Native(threads=1).adjoint(*args), lambda: Native(threads=2).adjoint(*args), spin
    )
    floor = spinning * work.multiply_adds() / spun
    yield (
        f"times the multiply-add floor: {two / floor:.2f} (needed 1.4); "
        f"one to two threads: {one / two:.2f} (1.8)"
    )
    torch = torch_milliseconds(python, threads)
    yield "PyTorch eager: " + (
        "not installed" if torch is None else f"{torch:.0f} ms, {torch / two:.0f} times (25)"
    )
    cold, warm = first_results()
    yield f"from call to first result: {cold:.2f} s (1.5); kernel on disk: {warm:.2f} s (0.3)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the first rows only")
    parser.add_argument("--torch", default=sys.executable, help="a Python that can import torch")
    options = parser.parse_args()
    for line in table(options.quick, options.torch):
        print(line, flush=True)


if __name__ == "__main__":
    main()
