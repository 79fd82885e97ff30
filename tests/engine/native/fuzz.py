"""Random step functions, composed from what the engine supports, on both engines.

A case is a number: it fixes the function, its inputs, its sizes and the precision. The XLA engine
answers in float64 with `jax.disable_jit`, one primitive after another: the kernels of primitives
are compiled once and serve all cases, which costs a tenth of compiling every case as a whole.
Types of JAX's intermediate results may differ there (tanh of an integer is one in float32), so that
where the engines differ the case is compiled as a whole before it is judged.

Engines may differ by what a change of the inputs in the last place changes, some twenty times over,
as every operation rounds. Where a comparison flips at its margin, the paths concerned are moved
off it and everything has to agree.

    python tests/native/fuzz.py 2000 [first]
"""

import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from tests.engine.native.fuzz_parts import BINARY, UNARY

from snapo.engine import Window, Xla
from snapo.engine.native import Native
from snapo.lanes.machine.threads import cores
from snapo.problem.actions import Box
from snapo.problem.noise import Stored
from snapo.problem.policies.rules import Constant
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

PATHS, STEPS = 19, 2
SIZES = (1, 2, 5, 6, 13, 20)  # in registers up to 12, in memory beyond
TOLERANCE = {"float32": 1e-5, "float64": 1e-11}
LEAST = 1e-4
ROUNDINGS = 20  # effects of one rounding of the inputs that all roundings together may have


class Random(Simulator):
    """A step function made from a number."""

    case: int = eqx.field(static=True)
    size: int = eqx.field(static=True)
    noise_size: int = eqx.field(static=True)
    horizon: int = eqx.field(static=True, default=STEPS)
    action: Box = eqx.field(default=Box(-np.inf, np.inf))

    def prepare(self, inputs):
        rng = np.random.default_rng(self.case)
        width = int(rng.choice([1, 4, 17, 33]))
        numbers = {
            "matrix": rng.normal(size=(width, self.size)) / 2,
            "back": rng.normal(size=(self.size, width)) / np.sqrt(width),
            "scale": rng.normal(size=self.size),
        }
        return Schedule(numbers, {"level": rng.normal(size=(STEPS, self.size))})

    def initial(self, constants, noise):
        return {"x": jnp.zeros(self.size), "count": jnp.array(0), "alive": jnp.array(True)}

    def observe(self, constants, now, state):
        return state["x"]

    def step(self, constants, now, state, action, noise, smooth):
        rng = np.random.default_rng(self.case + 1)
        hidden = jnp.tanh(constants["matrix"] @ state["x"])
        values = [state["x"], noise, now["level"], constants["scale"], constants["back"] @ hidden]
        for _ in range(int(rng.integers(2, 10))):
            one, other = (values[int(rng.integers(len(values)))] for _ in range(2))
            if rng.random() < 0.65:
                values.append(UNARY[int(rng.integers(len(UNARY)))](one))
            else:
                values.append(BINARY[int(rng.integers(len(BINARY)))](one, other))
        after = jnp.where(state["alive"], jnp.tanh(values[-1]), 0.2) + 0.1 * values[-2]
        count = state["count"] + (after[0] > 0)
        weights = jnp.arange(1, self.size + 1) / self.size
        out = jnp.sum(values[-1] * weights) + 0.1 * action[0] * count
        return {"x": after, "count": count, "alive": after.sum() < 2}, {"out": out}


class Problem(NamedTuple):
    """A simulator with everything that an engine needs, in numbers that float32 holds exactly."""

    simulator: Random
    schedule: Schedule
    table: Stored
    start: dict


def problem(case: int) -> Problem:
    rng = np.random.default_rng([case, 7])
    size = SIZES[case % len(SIZES)]
    simulator = Random(case, size, size)
    rounded = jax.tree.map(lambda a: a.astype(np.float32), simulator.prepare(None))
    noise = rng.normal(size=(STEPS, PATHS, size)).astype(np.float32)
    start = {
        "x": rng.normal(size=(PATHS, size)).astype(np.float32),
        "count": rng.integers(0, 9, PATHS),
        "alive": rng.random(PATHS) < 0.9,
    }
    return Problem(simulator, rounded, Stored(np.zeros((PATHS, 0)), noise), start)  # pyright: ignore


def run(engine, given: Problem, whole: bool = False):
    """Totals, final states and gradients, as arrays in float64; those of each path first. XLA goes
    primitive by primitive, or compiles the `whole`."""
    args = (
        given.simulator,
        Constant(np.full(1, 0.3, np.float32)),
        given.schedule,
        given.table,
        Exact(),
    )
    weights = {"out": np.linspace(0.5, 1, PATHS)}
    keyed = {"window": Window(0, STEPS), "start": given.start}
    if isinstance(engine, Xla):
        with jax.disable_jit(not whole):
            found = engine.adjoint(*args, weights, **keyed)
    else:
        found = engine.adjoint(*args, weights, **keyed)
    by_path, shared = (found.totals, found.start), (found.policy, found.schedule)
    return [[np.asarray(v, np.float64) for v in jax.tree.leaves(t)] for t in (by_path, shared)]


def gaps(expected, found) -> list[np.ndarray]:
    """Differences relative to the largest of each leaf; infinite where only one is not finite.

    A leaf that cancels to nothing, as the derivative of atan2(x, x) does, is all rounding: it counts
    as at least `LEAST` of the largest leaf.
    """
    result = []
    largest = max((np.abs(a[np.isfinite(a)]).max(initial=0) for a in expected), default=0.0)
    for a, b in zip(expected, found):
        usual = np.isfinite(a) & np.isfinite(b)
        size = max(np.abs(a[usual]).max(initial=0), LEAST * largest, 1e-9)
        with np.errstate(invalid="ignore"):
            same = (a == b) | (np.isnan(a) & np.isnan(b))
            result.append(np.where(usual, np.abs(a - b) / size, np.where(same, 0, np.inf)))
    return result


def worst(parts) -> float:
    return max((float(g.max(initial=0)) for part in parts for g in part), default=0.0)


def nudged(given: Problem, precision: str, rng) -> Problem:
    """Every number one unit in its last place up or down."""
    unit = np.finfo(precision).eps / 2

    def nudge(x):
        if not np.issubdtype(x.dtype, np.floating):
            return x
        return np.asarray(x, np.float64) * (1 + unit * rng.choice([-1.0, 1.0], np.shape(x)))

    return given._replace(
        schedule=jax.tree.map(nudge, given.schedule),
        table=jax.tree.map(nudge, given.table),
        start=jax.tree.map(nudge, given.start),
    )


def allowed(given: Problem, expected, precision: str) -> float:
    """What roundings change: found by nudging the inputs a few times.

    Where terms cancel to nothing, as in the derivative of atan2(x, x), nudging the inputs changes
    nothing, but every operation's rounding does: twice what they do to XLA's own answer.
    """
    rng = np.random.default_rng(0)

    def effect(other) -> float:
        return worst([gaps(a, b) for a, b in zip(expected, other)])

    nudging = max(effect(run(Xla("float64"), nudged(given, precision, rng))) for _ in range(4))
    own = effect(run(Xla(precision), given, whole=True))
    return max(TOLERANCE[precision], ROUNDINGS * nudging, 2 * own)


def compare(case: int) -> tuple[bool, str]:
    """Whether the engines agree, and a word on it where it took more than one comparison."""
    precision = ("float32", "float64")[case // len(SIZES) % 2]
    given = problem(case)
    expected, found = run(Xla("float64"), given), run(Native(precision), given)
    differences = [gaps(a, b) for a, b in zip(expected, found)]
    if worst(differences) <= TOLERANCE[precision]:
        return True, ""
    expected = run(Xla("float64"), given, whole=True)
    differences = [gaps(a, b) for a, b in zip(expected, found)]
    if worst(differences) <= TOLERANCE[precision]:
        return True, ""
    bound = allowed(given, expected, precision)
    if worst(differences) <= bound:
        return True, ""
    paths = np.zeros(PATHS, bool)
    for g in differences[0]:
        paths |= g.reshape(PATHS, -1).max(1, initial=0) > bound
    what = f"{worst(differences):.2g} (allowed {bound:.2g}) on {paths.sum()} of {PATHS} paths"
    if not 0 < paths.sum() <= 4:
        return False, what
    moved = given.start["x"].copy()
    moved[paths] += np.float32(0.011)
    given = given._replace(start=given.start | {"x": moved})
    expected, found = run(Xla("float64"), given), run(Native(precision), given)
    off = worst([gaps(a, b) for a, b in zip(expected, found)])
    return off <= allowed(given, expected, precision), f"{what}; off the margin {off:.2g}"


def some(cases: range) -> tuple[int, int]:
    """(differing, at a margin) among cases of one size, in a process of their own: XLA's kernels
    serve them all, then go with it."""
    failures = margins = 0
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder
        for number, case in enumerate(cases, 1):
            try:
                agree, word = compare(case)
            except Exception as error:
                agree, word = False, f"{type(error).__name__}: {error}"
            failures += not agree
            margins += agree and bool(word)
            if word:
                print(f"case {case} {'is at a margin' if agree else 'DIFFERS'}: {word}", flush=True)
            if number % 50 == 0:
                print(f"{number} of {len(cases)} cases like {cases[0]}", flush=True)
    return failures, margins


def main(count: int, first: int = 0) -> int:
    """Runs cases on all processors; gives the number of those on which the engines differ."""
    parts = [range(first + i, first + count, len(SIZES)) for i in range(min(count, len(SIZES)))]
    workers = cores()
    with ProcessPoolExecutor(workers, get_context("spawn"), max_tasks_per_child=1) as pool:
        failures, margins = map(sum, zip(*pool.map(some, parts)))
    print(f"{count} random step functions, {failures} differ, {margins} at a margin")
    return failures


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])) > 0)
