"""Random step functions, composed from what the engine supports, on both engines.

A case is a number: it fixes the function, its inputs and the schedule. Engines may differ by what a
change of the inputs in the last place changes; a comparison that flips there is taken off its margin.

    python tests/native/fuzz.py 2000 [first]
"""

import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.engine import Window, Xla
from snapo.engine.native import Native
from snapo.policy import Constant
from snapo.scenarios import Pseudo
from snapo.simulator import Box, Schedule, Simulator
from snapo.smooth import Exact

PATHS, STEPS, STATE = 19, 3, 6

UNARY = [
    jnp.tanh, jax.nn.sigmoid, jnp.sin, jnp.cos, jnp.exp, jnp.abs, jnp.square, jnp.negative, jax.nn.softplus,
    lambda x: jnp.log(jnp.abs(x) + 0.5), lambda x: jnp.sqrt(jnp.abs(x) + 0.1), jnp.cumsum, jnp.sort,
    lambda x: x[::-1], lambda x: jnp.roll(x, 2), jax.nn.softmax, lambda x: jnp.maximum(x, 0.1),
    lambda x: x / 3, lambda x: jnp.clip(x, -1, 1), lambda x: jnp.where(x > 0.2, x, 0.5 * x),
    lambda x: x - x.mean(), lambda x: x[jnp.argmax(x)] * x, lambda x: jax.lax.cummax(x),
    lambda x: jax.lax.fori_loop(0, 3, lambda i, c: jnp.tanh(c + 0.1 * i), x),
    lambda x: jax.lax.cond(x[0] > 0.1, jnp.sin, lambda y: 0.5 * y, x),
    lambda x: x.at[1].add(x[0]).at[4].set(0.3), lambda x: jnp.outer(x, x)[2],
    lambda x: jax.checkpoint(lambda y: jnp.sin(y) * y)(x),
]  # fmt: skip
BINARY = [
    jnp.add, jnp.subtract, jnp.multiply, jnp.maximum, jnp.minimum, jnp.arctan2, jnp.logaddexp,
    lambda a, b: a / (1 + b**2), lambda a, b: jnp.where(a > b, a, 0.3 * b), lambda a, b: jnp.dot(a, b) * a,
    lambda a, b: jnp.interp(a, jnp.sort(jnp.linspace(-1, 1, STATE)), b),
    lambda a, b: jnp.concatenate([a[:3], b[3:]]), lambda a, b: jnp.stack([a, b]).max(0),
    lambda a, b: jnp.einsum("i,j->ij", a, b).sum(1),
]  # fmt: skip


class Random(Simulator):
    """A step function made from a number."""

    case: int = eqx.field(static=True)
    horizon: int = eqx.field(static=True, default=STEPS)
    action: Box = eqx.field(default=Box(1))
    noise_size: int = eqx.field(static=True, default=STATE)

    def prepare(self, inputs):
        rng = np.random.default_rng(self.case)
        width = int(rng.integers(1, 40))
        constants = {
            "matrix": jnp.asarray(rng.normal(size=(width, STATE)) / 2),
            "back": jnp.asarray(rng.normal(size=(STATE, width)) / np.sqrt(width)),
        }
        return Schedule(constants, {"level": jnp.asarray(rng.normal(size=(STEPS, STATE)))})

    def initial(self, constants, noise):
        return {"x": jnp.zeros(STATE)}

    def observe(self, constants, now, state):
        return state["x"]

    def step(self, constants, now, state, action, noise, smooth):
        rng = np.random.default_rng(self.case + 1)
        hidden = jnp.tanh(constants["matrix"] @ state["x"])
        values = [state["x"], noise, now["level"], constants["back"] @ hidden]
        for _ in range(int(rng.integers(3, 14))):
            one, other = (values[int(rng.integers(len(values)))] for _ in range(2))
            if rng.random() < 0.5:
                values.append(UNARY[int(rng.integers(len(UNARY)))](one))
            else:
                values.append(BINARY[int(rng.integers(len(BINARY)))](one, other))
        after = jnp.tanh(values[-1]) + 0.1 * values[-2]
        return {"x": jnp.clip(after, -5, 5)}, {
            "out": jnp.sum(values[-1] * jnp.arange(STATE) / STATE)
        }


def compare(case: int) -> float:
    """The largest difference of totals and gradients, relative to the largest of each leaf and to
    what a change in the last place of the start changes."""
    simulator = Random(case)
    rng = np.random.default_rng(case + 2)
    x = rng.normal(size=(PATHS, STATE))
    draws = Pseudo(case, False).draws(np.arange(PATHS), simulator)

    def run(engine, scale: float = 1.0):
        with engine.numbers():
            schedule = simulator.prepare(None)
        start = {"x": x * scale}
        weights = {"out": np.linspace(0.5, 1, PATHS)}
        keyed = {"window": Window(0, STEPS), "start": start}
        return engine.adjoint(simulator, Constant(0.0), schedule, draws, Exact(), weights, **keyed)

    expected, found = run(Xla("float64")), run(Native("float64"))
    nudged = run(Xla("float64"), 1 + 2.0**-50)
    worst = 0.0
    for a, b, c in zip(*(jax.tree.leaves(t) for t in (expected, found, nudged))):
        a, b, c = (np.asarray(v, np.float64) for v in (a, b, c))
        if not np.array_equal(np.isfinite(a), np.isfinite(b)):
            return np.inf
        usual = np.isfinite(a) & np.isfinite(c)
        if not usual.any():
            continue
        size = max(np.abs(a[usual]).max(), 1e-9)
        effect = np.abs(a - c)[usual].max() / size
        worst = max(worst, np.abs(a - b)[usual].max() / size / max(1e-11, 100 * effect))
    return float(worst)


def main(count: int, first: int = 0) -> int:
    failures = 0
    for case in range(first, first + count):
        worst = compare(1000 * case)
        if worst > 1:
            failures += 1
            print(f"case {case}: engines differ by {worst:.3g} times what is allowed", flush=True)
        elif case % 50 == 0:
            print(f"case {case}: agree", flush=True)
        jax.clear_caches()
    print(f"{count} random step functions, {failures} on which the engines differ")
    return failures


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])) > 0)
