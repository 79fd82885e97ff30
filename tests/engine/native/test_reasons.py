"""What the engine says when it cannot, and arrays without elements."""

import sys
from collections import OrderedDict

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.engine.native.problems import Store, Tanh, difference

from snapo.engine import Window, Xla
from snapo.engine.choose import choose
from snapo.engine.native import Native, Unsupported, unsupported
from snapo.lanes import body
from snapo.problem.actions import Box
from snapo.problem.objective import Mean
from snapo.problem.policies.rules import Constant
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

POLICY = Tanh((4, 14, 2))


def endless(x):
    return jax.lax.while_loop(lambda y: y < 1.0, lambda y: 2 * y + 0.1, jnp.abs(x))


class Odd(Store):
    """Asks for what the engine does not have."""

    def step(self, constants, now, state, action, noise, smooth):
        return state, {"cash": jax.lax.stop_gradient(endless(state["x"]))}


class OddScale(Store):
    def state_scale(self, constants):
        return {"x": endless(constants["reversion"]), "level": 1.0, "count": 1}


class OddSlack(Store):
    def slack(self, constants, now, state, outputs):
        return {"room": jnp.sort(state["x"] * jnp.arange(200.0)).sum()}


class OddStart(Store):
    def initial(self, constants, noise):
        return Store.initial(self, constants, noise) | {"x": endless(noise[0])}


REASONS = {Odd: "while", OddScale: "while", OddSlack: "sort", OddStart: "while"}


@pytest.mark.parametrize("kind", REASONS)
def test_every_part_of_a_simulator_names_the_primitive_and_the_line(kind):
    """The step, the scales of clipping, the slacks of records and the start alike."""
    simulator = kind()
    schedule = simulator.prepare(None)
    reason = unsupported(simulator, schedule, POLICY, Exact())
    assert reason is not None and REASONS[kind] in reason and "test_reasons.py:" in reason
    problem = Problem(simulator, None, Mean("cash"))
    assert choose("auto", problem, POLICY).name == "xla"
    with pytest.raises(ValueError, match="native cannot run this simulator"):
        choose("native", problem, POLICY)


def test_what_can_be_compiled_has_no_reason():
    store = Store()
    assert unsupported(store, store.prepare(None), POLICY, Exact()) is None


def test_the_engine_itself_raises_the_reason():
    simulator = Odd()
    draws = Pseudo(0).draws(np.arange(4), simulator)
    with pytest.raises(Unsupported, match=r"while.*test_reasons\.py"):
        Native().values(simulator, POLICY, simulator.prepare(None), draws, Exact())


def test_an_accident_in_the_emitter_is_a_reason(monkeypatch):
    def broken(*args):
        raise IndexError("out of range")

    monkeypatch.setattr(body, "single", broken)
    monkeypatch.setattr(sys.modules[unsupported.__module__], "_reasons", OrderedDict())
    store = Store()
    reason = unsupported(store, store.prepare(None), POLICY, Exact())
    assert reason is not None and "out of range" in reason and "problems.py:" in reason


class Empty(Simulator):
    """Arrays without elements wherever one can stand."""

    horizon: int = eqx.field(static=True, default=3)
    action: Box = eqx.field(default=Box(-np.inf, np.inf))
    noise_size: int = eqx.field(static=True, default=0)

    def prepare(self, inputs):
        constants = {"none": jnp.zeros((0, 3)), "matrix": jnp.ones((2, 2))}
        return Schedule(constants, {"day": jnp.arange(3.0), "no": jnp.zeros((3, 0))})

    def initial(self, constants, noise):
        return {"x": jnp.ones(2), "e": jnp.zeros(0), "i": jnp.zeros((2, 0), int)}

    def observe(self, constants, now, state):
        return jnp.concatenate([state["x"], state["e"], now["no"]])

    def step(self, constants, now, state, action, noise, smooth):
        e, x = state["e"] * 2 + noise, state["x"]
        nothing = jnp.array([], int)
        y = jnp.concatenate([jnp.ones(20) * x[0], e, jnp.sin(e)]).sum() + e.sum() + jnp.prod(e)
        y = y + jnp.max(e, initial=3.0) + (jnp.zeros((2, 0)) @ e).sum() + jnp.pad(e, 1).sum()
        y = y + e.at[nothing].add(1).sum() + x.at[nothing].set(2.0).sum() + x[:0].sum()
        y = y + jnp.sort(e).sum() + jnp.cumsum(e).sum() + jnp.stack([e, e]).sum()
        z = constants["matrix"] @ (x + constants["none"].sum(0)[:2]) + state["i"].sum()
        return {"x": jnp.tanh(z), "e": e, "i": state["i"] + 1}, {"out": y * action[0]}


@pytest.mark.prove
def test_arrays_without_elements():
    simulator, weights = Empty(), {"out": np.ones(5)}
    draws = Pseudo(0).draws(np.arange(5), simulator)
    args = (simulator, Constant(np.ones(1)), simulator.prepare(None), draws, Exact())
    start = {"x": np.ones((5, 2)), "e": np.zeros((5, 0)), "i": np.zeros((5, 2, 0), int)}
    # 1e-5 is what float32 is held to: a curve may be some units in the last place off.
    for extra in ({}, {"window": Window(1, 2), "start": start}):
        expected = Xla().values(*args, record=("state",), **extra)
        assert difference(expected, Native().values(*args, record=("state",), **extra)) < 1e-5
        expected = Xla().adjoint(*args, weights, **extra)
        assert difference(expected, Native().adjoint(*args, weights, **extra)) < 1e-5
