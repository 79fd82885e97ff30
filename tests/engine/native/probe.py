"""Functions of arrays, run and differentiated path by path on both engines, and compared."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.engine import Window, Xla
from snapo.engine.native import Native
from snapo.problem.actions import Box
from snapo.problem.policies.rules import Constant
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

PATHS = 33
# Of a positive and a negative zero IEEE 754-2008 lets max and min give either; a product of a
# negative number and a truth value that is false is -0, where XLA makes a selection of it.
EITHER_ZERO = ("max", "min", "relu", "clamp", "one_hot")


class Named(dict):
    """A dictionary that a static field of a module can hold."""

    def __hash__(self):
        return hash(tuple(self))


class Probe(Simulator):
    """Applies functions to arrays in the state; each has inputs of its own, so none disturbs another.

    `functions` take a table that all paths share, then their own arrays of the given `shapes`.
    """

    functions: Named = eqx.field(static=True)
    shapes: Named = eqx.field(static=True)
    horizon: int = eqx.field(static=True, default=1)
    action: Box = eqx.field(default=Box(-np.inf, np.inf))
    noise_size: int = eqx.field(static=True, default=0)

    def prepare(self, inputs):
        return Schedule(
            {"table": jnp.linspace(-1.0, 2.0, 40) ** 2}, {"day": jnp.zeros(self.horizon)}
        )

    def initial(self, constants, noise):
        inputs = {name: [jnp.zeros(s) for s in self.shapes[name]] for name in self.functions}
        results = {name: jnp.zeros(r.shape, r.dtype) for name, r in self.results(constants).items()}
        return {"x": inputs, "y": results}

    def results(self, constants):
        return {
            name: jax.eval_shape(f, constants["table"], *(jnp.zeros(s) for s in self.shapes[name]))
            for name, f in self.functions.items()
        }

    def observe(self, constants, now, state):
        return jnp.zeros(1)

    def step(self, constants, now, state, action, noise, smooth):
        y = {name: f(constants["table"], *state["x"][name]) for name, f in self.functions.items()}
        floats = [r for r in y.values() if jnp.issubdtype(r.dtype, jnp.floating)]
        # Weights that differ: the derivative of a softmax's plain sum is zero.
        total = sum(jnp.sum(r * jnp.cos(jnp.arange(r.size)).reshape(r.shape)) for r in floats)
        return {"x": state["x"], "y": y}, {"total": total}


def run(engine, probe: Probe, x: dict):
    """Results of every function, gradients path by path, and the gradient of the shared table."""
    with engine.numbers():
        schedule = probe.prepare(None)
        results = probe.results(schedule.constants)
        start = {
            "x": x,
            "y": {name: np.zeros((PATHS, *r.shape), r.dtype) for name, r in results.items()},
        }
    draws = Pseudo(0, False).draws(np.arange(PATHS), probe)
    args = (probe, Constant(np.zeros(1)), schedule, draws, Exact())
    keyed = {"window": Window(0, 1), "start": start}
    values = engine.values(*args, **keyed).state["y"]
    gradient = engine.adjoint(*args, {"total": np.ones(PATHS)}, **keyed)
    return values, gradient.start["x"], gradient.schedule.constants["table"]


def same(expected, found, tolerance: float, name: str) -> None:
    """Equal to rounding, and NaN and infinity where XLA has them.

    What is infinite in one engine may be within a factor of four of the largest number in the
    other: sums in another order overflow a little earlier or later.
    """
    a, b = np.asarray(expected), np.asarray(found)
    assert a.shape == b.shape and a.dtype == b.dtype, name
    if a.dtype.kind != "f":
        np.testing.assert_array_equal(a, b, err_msg=name)
        return
    np.testing.assert_array_equal(np.isnan(a), np.isnan(b), err_msg=name)
    infinite = np.isinf(a) | np.isinf(b)
    largest = np.finfo(a.dtype).max / 4
    near = infinite & (np.where(np.isinf(a), largest, np.abs(a)) >= largest)
    np.testing.assert_array_equal(a[infinite & ~near], b[infinite & ~near], err_msg=name)
    usual = np.isfinite(a) & np.isfinite(b)
    np.testing.assert_allclose(b[usual], a[usual], tolerance, tolerance / 10, err_msg=name)


def zeros_alike(expected, found, name: str) -> None:
    """Zeros have the signs they have in XLA."""
    a, b = np.asarray(expected), np.asarray(found)
    if a.dtype.kind == "f":
        both_zero = (a == 0) & (b == 0)
        np.testing.assert_array_equal(
            np.signbit(a[both_zero]), np.signbit(b[both_zero]), err_msg=f"sign of zero: {name}"
        )


def both(probe: Probe, x: dict, precision: str, tolerance: float, table: bool = True) -> None:
    """Every function and derivative on both engines; `table` where no path spoils the shared sum."""
    x = {name: [a.astype(precision) for a in arrays] for name, arrays in x.items()}
    expected = run(Xla(precision), probe, x)
    found = run(Native(precision), probe, x)
    for name in probe.functions:
        same(expected[0][name], found[0][name], tolerance, name)
        if name not in EITHER_ZERO:
            zeros_alike(expected[0][name], found[0][name], name)
        for a, b in zip(expected[1][name], found[1][name]):
            same(a, b, tolerance, f"derivative of {name}")
    if table:
        same(expected[2], found[2], tolerance * 10, "derivative of the table")
