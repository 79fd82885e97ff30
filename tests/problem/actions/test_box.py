"""Sets of actions: bounds of all components or one of each, and ways into them."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.engine import Xla
from snapo.engine.native import Native, unsupported
from snapo.problem.actions import Box, Integers, Simplex
from snapo.problem.inputs import Input
from snapo.problem.policies.rules import Constant
from snapo.problem.policy import MLP, Residual
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact, Smooth

INF = math.inf
MIXED = Box([0.0, -2.0, -INF, -INF], [1.0, INF, 3.0, INF])


def test_one_bound_for_all_is_the_same_set_as_equal_bounds_for_each():
    assert Box([0, 0], np.ones(2)) == Box(0.0, 1.0, 2)
    assert hash(Box([0, 0], [1, 1])) == hash(Box(0.0, 1.0, 2))
    assert Box([0.0, 0.5], 1.0).low == (0.0, 0.5)
    assert hash(MIXED) == hash(Box(MIXED.low, MIXED.high, 4)) and Box(-INF, INF, 4) != MIXED


@pytest.mark.parametrize("kind", [Box, Integers])
def test_the_size_is_that_of_the_bounds_or_one(kind):
    """Low and high first, as in Gymnasium; `size` where they are scalars."""
    assert kind(0.0, 5.0).size == 1
    assert kind(low=0.0, high=5.0, size=3) == kind([0, 0, 0], 5.0) == kind(0.0, np.full(3, 5))
    assert kind([0.0, -1.0], 5.0).size == kind(-1.0, np.array([2.0, 3.0])).size == 2
    assert kind((0.0, -1.0), (INF, 5.0), 2).bounds()[1].tolist() == [INF, 5.0]
    for missing in ((), (3,)):
        with pytest.raises(TypeError, match="high"):
            kind(*missing)


def test_squash_goes_component_by_component():
    """Each component as the box of its own bounds, value and derivative, to rounding."""
    raw = jnp.asarray([-1.3, 0.4, 2.0, -30.0], jnp.float32)
    each = [Box(low, high) for low, high in zip(*MIXED.bounds())]

    def apart(raw):
        return jnp.concatenate([b.squash(x[None]) for b, x in zip(each, raw)])

    def both(squash):
        return jax.jit(lambda x: (squash(x), jax.grad(lambda x: squash(x).sum())(x)))

    together = both(MIXED.squash)
    (found, slope), (expected, parts) = together(raw), both(apart)(raw)
    np.testing.assert_allclose(found, expected, rtol=1e-7)
    np.testing.assert_allclose(slope, parts, rtol=1e-6)
    far, _ = together(np.full(4, 500.0, np.float32))
    assert far.dtype == jnp.float32 and np.isfinite(far).all()


def test_a_residual_stays_within_bounds_of_its_own():
    residual = Residual(Constant(jnp.full(4, 0.9)), MIXED, 2, key=jax.random.key(0), scale=1e4)
    low, high = MIXED.bounds()
    for smooth in (Exact(), Smooth(0.1)):
        action = np.asarray(eqx.filter_jit(residual)(jnp.asarray([3.0, -2.0]), smooth))
        assert np.all((low <= action) & (action <= high)), action


@pytest.mark.parametrize(
    "arguments, message",
    [
        ((0.0, 1.0, 0), "size is 0"),
        ((1.0, 1.0, 2), "low is 1.0 and high is 1.0"),
        (([0.0, 2.0], 1.0), r"low\[1\] is 2.0 and high\[1\] is 1.0"),
        ((0.0, math.nan), "high is nan"),
        ((0.0, 1.0, (2, 2)), r"size is \(2, 2\); .* after the bounds"),
        ((0.0, "much", 2), "high is 'much'"),
        ((None, 1.0), "low is None"),
        (([0.0, 1.0], 2.0, 3), r"low has shape \(2,\), but size is 3"),
        (([0.0, 1.0], [2.0, 3.0, 4.0]), r"high has shape \(3,\), but size is 2"),
        ((0.0, np.ones((2, 1))), r"high has shape \(2, 1\)"),
        (([], []), "size is 0"),
    ],
)
def test_a_box_that_makes_no_sense_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Box(*arguments)
    with pytest.raises(ValueError, match="at least 2"):
        Simplex(1)


class Mixer(Simulator):
    """Four actions, each within bounds of its own, all of them in one output."""

    horizon: int = 3
    action: Box = MIXED
    noise_size: int = 1

    def prepare(self, inputs):
        return Schedule({}, {"price": inputs.price})

    def initial(self, constants, noise):
        return {"x": jnp.ones(())}

    def observe(self, constants, now, state):
        return jnp.stack([state["x"], now["price"]])

    def step(self, constants, now, state, action, noise, smooth):
        x = state["x"] * 0.9 + 0.1 * noise[0] + 0.1 * action[0]
        cash = now["price"] * jnp.tanh(action).sum() - 0.1 * (action[1] - x) ** 2 * action[3]
        return {"x": x}, {"cash": cash}


class Prices(eqx.Module):
    price: Input


@pytest.mark.parametrize("residual", [False, True], ids=["network", "residual"])
def test_both_engines_take_bounds_of_each_component(residual):
    """Totals and gradients of the compiled kernel are those of XLA: 1e-12 in float64."""
    simulator = Mixer()
    schedule = prepare(simulator, Prices(Input([1.0, 2.0, 0.5])))
    key, base = jax.random.key(0), Constant(jnp.full(4, 0.9))
    policy = Residual(base, MIXED, 2, key=key, scale=20.0) if residual else MLP(MIXED, 2, key=key)
    draws, smooth = Pseudo(0).draws(np.arange(16), simulator), Smooth(np.float64(0.1))
    assert unsupported(simulator, schedule, policy, smooth) is None
    weights = {"cash": np.full(16, 1 / 16)}
    given = (simulator, policy, schedule, draws, smooth)
    found = [engine("float64").adjoint(*given, weights) for engine in (Xla, Native)]
    np.testing.assert_allclose(found[0].totals["cash"], found[1].totals["cash"], rtol=1e-12)
    for a, b in zip(*(jax.tree.leaves((f.policy, f.schedule)) for f in found)):
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-13)
