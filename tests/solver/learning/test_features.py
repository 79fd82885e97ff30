"""Features that no decision moves have mean 0 and deviation 1 for a network that is drawn."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from examples import american_put

import snapo
from snapo.problem.smooth import Exact
from snapo.solver.learning.features import Scale, fixed, scale_of
from snapo.solver.learning.following import fitted

HORIZON, LEVEL, SPREAD = 12, 60.0, 15.0


class Store(snapo.Simulator):
    """Sees a price, its stock, the stock of the step before, the two's product and a constant."""

    horizon: int = HORIZON
    action: snapo.Box = snapo.Box(12, -1.0, 1.0)
    noise_size: int = 1
    initial_noise_size: int = 1

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.arange(float(self.horizon))})

    def initial(self, constants, noise):
        stock = jnp.zeros(())
        return {"price": constants["level"] + SPREAD * noise[0], "stock": stock, "before": stock}

    def observe(self, constants, now, state):
        price, stock = state["price"], state["stock"]
        return jnp.stack([price, stock, state["before"], price * stock, now["t"], 0 * price + 3])

    def step(self, constants, now, state, action, noise, smooth):
        stock = smooth.clip(state["stock"] + action[0], 0.0, 4.0)
        price = constants["level"] + SPREAD * noise[0]
        after = {"price": price, "stock": stock, "before": state["stock"]}
        return after, {"cash": -state["price"] * action[0]}


def problem(kind=Store):
    return snapo.Problem(kind(), {"level": snapo.Input(LEVEL)}, snapo.Mean("cash"))


@pytest.mark.prove
def test_the_price_and_the_time_are_put_on_one_scale_and_the_stock_is_left():
    """Also the stock a step later and its product with the price; and a constant is left."""
    found = fixed(problem())
    assert found is not None
    mean, deviation = map(np.asarray, found)
    np.testing.assert_allclose(mean[0], LEVEL, atol=4 * SPREAD / np.sqrt(32 * HORIZON))
    np.testing.assert_allclose(deviation[0], SPREAD, rtol=0.15)
    assert mean[4] == pytest.approx((HORIZON - 1) / 2)
    assert deviation[4] == pytest.approx(np.arange(HORIZON).std())
    assert not mean[[1, 2, 3, 5]].any() and (deviation[[1, 2, 3, 5]] == 1).all()


SCALE = Scale((LEVEL, 0.0, 0.0, 0.0, 5.5, 0.0), (SPREAD, 1.0, 1.0, 1.0, 3.5, 1.0))
SEEN = jnp.array([70.0, 2.0, 1.0, 140.0, 3.0, 3.0], jnp.float32)


@pytest.mark.prove
def test_a_network_that_is_drawn_sees_the_scaled_features():
    of = problem()
    drawn = snapo.MLP().for_problem(of.interface, jax.random.key(0))
    scaled = (SEEN - jnp.asarray(SCALE.mean)) / jnp.asarray(SCALE.deviation)
    plain = SCALE.plain(drawn)
    np.testing.assert_allclose(plain(SEEN, Exact()), drawn(scaled, Exact()), atol=1e-6)
    for mine, again in zip(jax.tree.leaves(drawn), jax.tree.leaves(SCALE.scaled(plain))):
        np.testing.assert_allclose(again, mine, atol=1e-5)


@pytest.mark.prove
def test_the_gradient_by_scaled_numbers_is_that_of_the_chain_rule():
    of = problem()
    drawn = snapo.MLP().for_problem(of.interface, jax.random.key(1))

    def value(policy):
        return policy(SEEN, Exact())[0]

    by_plain = jax.grad(value)(SCALE.plain(drawn))
    by_scaled = jax.grad(lambda policy: value(SCALE.plain(policy)))(drawn)
    for found, true in zip(jax.tree.leaves(SCALE.slope(by_plain)), jax.tree.leaves(by_scaled)):
        np.testing.assert_allclose(found, true, rtol=1e-4, atol=1e-7)


def test_a_scale_is_read_again_from_plain_data():
    assert Scale.read(json.loads(json.dumps(SCALE))) == SCALE and Scale.read(None) is None


class Blind(Store):
    """Sees its stock alone."""

    def observe(self, constants, now, state):
        return jnp.stack([state["stock"]])


@pytest.mark.prove
def test_where_decisions_move_all_features_there_is_no_scale():
    of = problem(Blind)
    assert scale_of(snapo.MLP().for_problem(of.interface, jax.random.key(0)), of) is None
    assert scale_of(snapo.Linear(np.eye(1)), of) is None


class One(Store):
    """Decides one number."""

    action: snapo.Box = snapo.Box(1, -1.0, 1.0)


def test_where_few_numbers_are_decided_there_is_no_scale():
    of = problem(One)
    assert scale_of(snapo.MLP().for_problem(of.interface, jax.random.key(0)), of) is None


def test_where_the_decision_is_when_to_stop_price_and_time_are_scaled():
    put = american_put.Put()  # pyright: ignore[reportCallIssue]
    of = snapo.Problem(put, american_put.inputs, snapo.Mean("cash"))
    found = scale_of(snapo.MLP().for_problem(of.interface, jax.random.key(0)), of)
    assert found is not None
    # The time left is 1, .98, ..., .02 on every path.
    left = 1 - np.arange(50) / 50
    assert found.mean[1] == pytest.approx(left.mean(), rel=1e-5)
    assert found.deviation[1] == pytest.approx(left.std(), rel=1e-5)
    assert fitted(snapo.Training(), of, snapo.MLP()).learning_rate == 0.01
