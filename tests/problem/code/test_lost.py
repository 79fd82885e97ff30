"""Inputs whose derivative is lost on every way to the outputs, and those of which it is not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.engine import Xla
from snapo.problem.policies.rules import Constant
from snapo.problem.simulator import Schedule, Simulator
from snapo.solver.evaluate import path_totals
from snapo.solver.sensitivity import sensitivities

INPUTS = {"size": snapo.Input(3.5, "units"), "price": snapo.Input(2.0, "EUR/unit")}


class Sales(Simulator):
    """Sales of a number that is made of `size` and of noise."""

    horizon: int = 2
    action: snapo.Box = snapo.Box(0.0, 1.0)
    noise_size: int = 1

    def prepare(self, inputs):
        return Schedule(dict(inputs), {})

    def initial(self, constants, noise):
        return {"sold": jnp.zeros(()), "day": jnp.zeros(())}

    def observe(self, constants, now, state):
        return jnp.stack([state["sold"], constants["size"]])

    def step(self, constants, now, state, action, noise, smooth):
        sold = self.sold(constants["size"], snapo.noise.uniform(noise[0]), smooth, state)
        after = {"sold": state["sold"] + sold, "day": state["day"] + 1.0}
        return after, {"cash": constants["price"] * sold + 0.0 * action[0]}

    def sold(self, size, uniform, smooth, state):
        return jnp.floor(size * uniform)


class Rounded(Sales):
    def sold(self, size, uniform, smooth, state):
        return jnp.round(size * uniform)


class Whole(Sales):
    def sold(self, size, uniform, smooth, state):
        return (size * uniform).astype(int) * 1.0


class Sign(Sales):
    def sold(self, size, uniform, smooth, state):
        return jnp.sign(size * uniform - 1.0)


class Threshold(Sales):
    def sold(self, size, uniform, smooth, state):
        return jnp.where(uniform * 5.0 > size, 1.0, 0.0)


class Loop(Sales):
    def sold(self, size, uniform, smooth, state):
        body = lambda total, x: (total + jnp.floor(size * x), None)  # noqa: E731
        return jax.lax.scan(body, 0.0, uniform[None])[0]


class Alone(Sales):
    """No noise is in it."""

    def sold(self, size, uniform, smooth, state):
        return jnp.floor(size) * uniform


class Prepared(Sales):
    def prepare(self, inputs):
        return Schedule({**inputs, "size": jnp.ceil(inputs["size"])}, {})

    def sold(self, size, uniform, smooth, state):
        return size * uniform


class Smoothly(Sales):
    """Exact by a comparison, and smooth with a slope."""

    def sold(self, size, uniform, smooth, state):
        return smooth.indicator(size - 5.0 * uniform)


class Interpolated(Sales):
    """A straight line between whole numbers."""

    def sold(self, size, uniform, smooth, state):
        x = size * uniform
        low = jnp.floor(x)
        table = jnp.arange(9.0) ** 2
        left, right = table[low.astype(int)], table[low.astype(int) + 1]
        return left + (x - low) * (right - left)


class Drawn(Sales):
    """Its derivative is right in the mean."""

    def sold(self, size, uniform, smooth, state):
        return snapo.noise.Poisson(size, maximum=20).draw(jnp.stack([uniform]))


class Stopped(Sales):
    def sold(self, size, uniform, smooth, state):
        return jnp.floor(jax.lax.stop_gradient(size) * uniform)


class Dated(Sales):
    """The number of the day is rounded, and no input."""

    def sold(self, size, uniform, smooth, state):
        return size * uniform * jnp.floor(state["day"] / 2)


class Switch(Sales):
    """A choice between two formulas, by an input alone."""

    def sold(self, size, uniform, smooth, state):
        return jnp.where(size > 1.0, uniform, 0.0)


class SeenOnly(Sales):
    """The input moves decisions alone."""

    def sold(self, size, uniform, smooth, state):
        return uniform


def problem(kind: type[Sales]) -> snapo.Problem:
    return snapo.Problem(kind(), INPUTS, snapo.Mean("cash"))


@pytest.mark.parametrize("kind", [Sales, Rounded, Whole, Sign, Threshold, Loop, Alone, Prepared])
def test_what_is_rounded_or_compared_on_every_way_is_lost(kind):
    assert problem(kind).lost == ("size",)


@pytest.mark.parametrize("kind", [Smoothly, Interpolated, Drawn, Stopped, Dated, Switch, SeenOnly])
def test_where_a_way_stays_open_or_nothing_is_asked_nothing_is_lost(kind):
    assert problem(kind).lost == ()


def test_a_lost_derivative_is_not_known_and_never_zero():
    """E floor(3 u) = (0 + 1 + 2) / 3 = 1 and E floor(4 u) = (0 + 1 + 2 + 3) / 4 = 1.5."""
    own = problem(Sales)
    policy = Constant(np.array([0.5]), own.action)
    engine = Xla("float64")
    table = sensitivities(
        own, policy, paths=256, smooth=snapo.Smooth(0.1), smooth_paths=64, engine=engine
    )
    for found in (table.held, table.smooth):
        assert found is not None and np.isnan(found["size"].value)
    price, size = table.rows()
    assert np.isnan([size.value, size.held, size.held_error]).all()
    sold = path_totals(own, policy, 256, engine=engine)["cash"] / 2.0
    assert price.held == pytest.approx(sold.mean(), rel=1e-12)
    low, high = (own.at({"size": x}) for x in (3.0, 4.0))
    moved = [path_totals(each, policy, 4096, engine=engine)["cash"].mean() for each in (low, high)]
    # Two days at a price of 2: 2 for one unit more, with an error of 0.05 on 4,096 paths.
    assert moved[1] - moved[0] == pytest.approx(2.0, abs=0.15)
