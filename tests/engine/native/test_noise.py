"""Noise drawn inside the kernel against `snapo.problem.noise.counter`: the same words, normals to rounding."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.engine.native import Native
from snapo.problem.actions import Box
from snapo.problem.noise import counter as noise
from snapo.problem.policies.rules import Constant
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact


class Echo(Simulator):
    """Keeps its noise, so that a record of the state shows it."""

    noise_size: int = eqx.field(static=True)
    initial_noise_size: ClassVar[int] = 3
    horizon: int = eqx.field(static=True, default=7)
    action: Box = eqx.field(default=Box(-np.inf, np.inf))

    def prepare(self, inputs):
        return Schedule({}, {"day": jnp.arange(self.horizon, dtype=jnp.float32)})

    def initial(self, constants, noise):
        return {"first": noise, "noise": jnp.zeros(self.noise_size)}

    def observe(self, constants, now, state):
        return state["noise"]

    def step(self, constants, now, state, action, noise, smooth):
        return {"first": state["first"], "noise": noise}, {"sum": jnp.sum(noise)}


def words(key, size: int, paths, steps, antithetic: bool) -> np.ndarray:
    """The words that `noise` draws, [steps, paths, size]."""
    pairs = (size + 1) // 2
    numbers = paths >> 1 if antithetic else paths
    counters = steps[:, None, None] * np.uint32(pairs) + np.arange(pairs, dtype=np.uint32)
    shape = (len(steps), len(paths), pairs)
    first = jnp.broadcast_to(jnp.asarray(numbers)[:, None], shape)
    pair = noise.threefry(key, first, jnp.broadcast_to(counters, shape))
    return np.stack(pair, -1).reshape(len(steps), len(paths), -1)[..., :size]


def exact(words: np.ndarray, dtype) -> np.ndarray:
    """The formula of `noise.normal` in extended precision, with its rounded coefficients."""
    wide = np.longdouble
    tables = noise._PPND16 if dtype == np.float64 else noise._PPND7
    m = (words & 0x7FFFFFFF).astype(wide)
    tail, q = (m + wide(0.5)) * wide(2) ** -32, (0x7FFFFFFF - m) * wide(2) ** -32 + wide(2) ** -33

    def ratio(table, x):
        top, bottom = (sum(wide(dtype(c)) * x**i for i, c in enumerate(part)) for part in table)
        return top / bottom

    centre = q * ratio(tables[0], wide(dtype(0.180625)) - q * q)
    outer = ratio(tables[1], np.sqrt(-np.log(tail)) - wide(dtype(1.6)))
    z = np.where(q <= wide(dtype(0.425)), centre, outer)
    return np.where(words >> 31 == 1, -z, z)


# float32 within 4 units in the last place of the formula, float64 within 5; XLA's own evaluation
# is within 6, so a wrong word could not hide.
BOUND = {"float32": 4, "float64": 5}


class Later(Echo):
    """Begins on the calendar's step 4, and receives the noise of its first five."""

    first_step: ClassVar[int] = 4
    initial_steps: ClassVar[int] = 5

    @property
    def initial_noise_size(self) -> int:
        return 5 * self.noise_size


@pytest.mark.parametrize(("size", "antithetic"), [(1, True), (3, False), (17, True)])
def test_noise_of_the_calendar(size, antithetic):
    """The steps before and from the start are those of a simulator that began earlier."""
    paths, rows = np.arange(1000, 1045, dtype=np.uint32), []
    for simulator in (Echo(size, horizon=11), Later(size)):
        draws = Pseudo(5, antithetic).draws(paths, simulator)
        rollout = Native("float64").values(
            simulator, Constant(0.0), simulator.prepare(None), draws, Exact(), record=("state",)
        )
        last = np.asarray(rollout.state["noise"])[None]
        steps = np.concatenate([np.asarray(rollout.record["state"]["noise"])[1:], last])
        rows.append((np.asarray(rollout.state["first"]), steps))
    (_, early), (first, late) = rows
    np.testing.assert_array_equal(first.reshape(len(paths), 5, size), early[:5].swapaxes(0, 1))
    np.testing.assert_array_equal(late, early[4:])
    draws = Pseudo(5).counter(paths, 4, 2)
    with pytest.raises(ValueError, match="initial_noise_size, 3, is not"):
        Native().values(Echo(2), Constant(0.0), Echo(2).prepare(None), draws, Exact())


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(("size", "antithetic"), [(1, True), (3, False), (4, True), (31, False)])
def test_the_same_normals(precision, size, antithetic):
    simulator, dtype = Echo(size), np.dtype(precision).type
    paths = np.arange(1000, 1045, dtype=np.uint32)
    draws = Pseudo(5, antithetic).draws(paths, simulator)
    steps, start = words(draws.keys[0], size, paths, np.arange(7, dtype=np.uint32), antithetic), 3
    first = words(draws.keys[1], start, paths, np.zeros(1, np.uint32), antithetic)[0]
    sign = np.where((paths & 1 == 1) & antithetic, -1, 1)[:, None]
    engine = Native(precision)
    with engine.numbers():
        schedule = simulator.prepare(None)
    rollout = engine.values(simulator, Constant(0.0), schedule, draws, Exact(), record=("state",))
    found = np.concatenate(
        [np.asarray(rollout.record["state"]["noise"])[1:], np.asarray(rollout.state["noise"])[None]]
    )
    assert ulps(found, sign * exact(steps, dtype)) <= BOUND[precision]
    assert ulps(np.asarray(rollout.state["first"]), sign * exact(first, dtype)) <= BOUND[precision]


def ulps(found: np.ndarray, expected: np.ndarray) -> float:
    assert found.shape == expected.shape
    unit = np.spacing(np.abs(expected.astype(found.dtype))).astype(np.longdouble)
    return float(np.max(np.abs(found - expected) / unit))
