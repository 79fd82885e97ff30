"""Features that no decision moves have mean 0 and deviation 1 for a network that is drawn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.problem.smooth import Exact
from snapo.solver.learning.features import fixed, on_one_scale

HORIZON, LEVEL, SPREAD = 12, 60.0, 15.0


class Store(snapo.Simulator):
    """Sees a price, its stock, the stock of the step before, the two's product and a constant."""

    horizon: int = HORIZON
    action: snapo.Box = snapo.Box(1, -1.0, 1.0)
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
    mean, deviation = found
    np.testing.assert_allclose(mean[0], LEVEL, atol=4 * SPREAD / np.sqrt(32 * HORIZON))
    np.testing.assert_allclose(deviation[0], SPREAD, rtol=0.15)
    assert mean[4] == pytest.approx((HORIZON - 1) / 2)
    assert deviation[4] == pytest.approx(np.arange(HORIZON).std())
    assert not mean[[1, 2, 3, 5]].any() and (deviation[[1, 2, 3, 5]] == 1).all()


@pytest.mark.prove
def test_a_network_that_is_drawn_sees_the_scaled_features():
    of = problem()
    plain = snapo.MLP().for_problem(of.interface, jax.random.key(0))
    mean, deviation = fixed(of) or (0.0, 1.0)
    seen = np.array([70.0, 2.0, 1.0, 140.0, 3.0, 3.0])
    scaled = np.asarray((seen - mean) / deviation, np.float32)
    np.testing.assert_allclose(
        on_one_scale(plain, of)(jnp.asarray(seen, jnp.float32), Exact()),
        plain(jnp.asarray(scaled), Exact()),
        atol=1e-6,
    )


class Blind(Store):
    """Sees its stock alone."""

    def observe(self, constants, now, state):
        return jnp.stack([state["stock"]])


@pytest.mark.prove
def test_where_decisions_move_all_features_the_policy_is_left_as_it_is():
    of = problem(Blind)
    plain = snapo.MLP().for_problem(of.interface, jax.random.key(0))
    assert fixed(of) is None and on_one_scale(plain, of) is plain
    rule = snapo.Linear([[1.0]])
    assert on_one_scale(rule, of) is rule
