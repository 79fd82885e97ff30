"""Dot products in tiles: zeros at the end of rows, and memory that their rounds fetch."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.engine.native.call import forget_kernels
from snapo.lanes.emit.code import Ahead, Code
from snapo.lanes.emit.module import Module
from snapo.lanes.emit.storage import Layout
from snapo.lanes.emit.values import EmittedValues, Workspace
from snapo.lanes.machine.pipeline import host
from snapo.lanes.program.flatten import flatten
from snapo.lanes.program.passes import optimize
from snapo.lanes.rules import dots
from snapo.problem.actions import Box
from snapo.problem.noise import Stored
from snapo.problem.policies.rules import Constant
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

PATHS, FACTORS = 37, 21


def matrix(size: int) -> np.ndarray:
    """Rows that end in zeros, also negative ones, one after `size` steps, one at once."""
    result = np.tril(np.random.default_rng(3).normal(size=(FACTORS, size)), 30) / size
    result[1:3, -5:], result[8] = -0.0, 0.0
    result[12], result[13, 20:40] = 1 / size, 0.0
    return result.astype(np.float32)


class Correlated(Simulator):
    """Factors moved by a matrix times noise, or times a part of it."""

    part: int = eqx.field(static=True)
    noise_size: int = eqx.field(static=True)
    horizon: int = eqx.field(static=True, default=3)
    action: Box = eqx.field(default=Box(-np.inf, np.inf))

    def prepare(self, inputs):
        return Schedule({"matrix": matrix(self.part)}, {"day": np.zeros(self.horizon, np.float32)})

    def initial(self, constants, noise):
        return jnp.zeros(FACTORS)

    def observe(self, constants, now, state):
        return state[:1]

    def step(self, constants, now, state, action, noise, smooth):
        state = 0.5 * state + constants["matrix"] @ noise[: self.part]
        return state, {"sum": jnp.tanh(state).sum()}


@pytest.mark.prove
@pytest.mark.parametrize(("part", "size"), [(72, 72), (71, 71), (68, 90)])
def test_zeros_at_the_end_of_rows_are_left_out(part, size, monkeypatch):
    """With the same bits: they add nothing. Even numbers of normals are drawn on the tape."""
    simulator = Correlated(part=part, noise_size=size)
    schedule, draws = simulator.prepare(None), Pseudo(1).draws(np.arange(PATHS), simulator)
    weights = {"sum": np.linspace(0.5, 1.0, PATHS)}
    given = simulator, Constant(0.0), schedule, draws, Exact()
    found, totals = Native().adjoint(*given, weights), Native().values(*given).totals
    forget_kernels()
    monkeypatch.setattr(dots, "LONG", 1000)
    every = Native().adjoint(*given, weights)
    forget_kernels()
    reference = Xla("float64").adjoint(*given, weights)
    np.testing.assert_array_equal(found.totals["sum"], every.totals["sum"])
    np.testing.assert_array_equal(found.totals["sum"], totals["sum"])
    moved, same, exact = (x.schedule.constants["matrix"] for x in (found, every, reference))
    np.testing.assert_array_equal(moved, same)
    np.testing.assert_allclose(found.totals["sum"], reference.totals["sum"], atol=2e-5)
    np.testing.assert_allclose(moved, exact, atol=2e-5 * np.abs(exact).max())


def test_a_nan_times_zero_is_nan():
    """Noise that is supplied may have one, and zeros are multiplied by it."""
    simulator = Correlated(part=72, noise_size=72)
    noise = np.random.default_rng(1).normal(size=(3, PATHS, 72)).astype(np.float32)
    noise[1, 5, -1] = np.nan
    draws = Stored(np.zeros((PATHS, 0)), noise)
    totals = (
        Native()
        .values(simulator, Constant(0.0), simulator.prepare(None), draws, Exact())
        .totals["sum"]
    )
    np.testing.assert_array_equal(np.isnan(totals), np.arange(PATHS) == 5)


@pytest.mark.parametrize(
    ("contract", "shapes", "path"),
    [
        ("ij,j->i", [(20, 9), (9,)], [False, True]),
        ("ij,i->j", [(13, 30), (13,)], [False, True]),
        ("j,kij->ki", [(12,), (3, 5, 12)], [True, True]),
        ("nij,nj->ni", [(2, 17, 8), (2, 8)], [False, True]),
        ("ij,jk->ik", [(6, 5), (5, 4)], [True, False]),
    ],
)
def test_every_round_of_a_dot_product_is_counted(contract, shapes, path):
    """Memory is divided by the number of rounds that fetch it."""
    closed = jax.make_jaxpr(lambda a, b: jnp.einsum(contract, a, b))(*map(jnp.zeros, shapes))
    program = optimize(flatten(closed, path))
    module = Module(host().lanes("float32"), host().register)
    code = Code(module.lanes, module)
    values = EmittedValues(code, Workspace("%work"))
    for value in program.inputs:
        layout = Layout(module.lanes if value.path else 1)
        layout.add(0, value.shape, value.dtype)
        values.bind(value, layout.address(0, "%given"))
    (op,) = [op for op in program.ops if op.name == "dot_general"]
    code.ahead = Ahead(code, "%row", 4096, dots.rounds(code, op), False)
    dots.dot(values, op)
    assert dots.tiles(op)
    assert code.ahead.taken == dots.rounds(code, op) > 0
