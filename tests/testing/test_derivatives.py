"""The derivative check of domains' tests, on a tank that drains: right, and with a way cut."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import snapo
from snapo.testing.derivatives import wrong_derivatives


class Inputs(eqx.Module):
    rate: snapo.Input
    prices: snapo.Input


class Tank(snapo.Simulator):
    """Sells a share of what is left each day at a noisy price; the rest leaks at `rate`."""

    cut: bool = eqx.field(static=True, default=False)
    horizon: int = eqx.field(static=True, default=3)
    noise_size: int = eqx.field(static=True, default=1)
    action: snapo.Box = eqx.field(static=True, default=snapo.Box(0.0, 1.0))

    def prepare(self, inputs):
        rate = jax.lax.stop_gradient(inputs.rate) if self.cut else inputs.rate
        return snapo.Schedule(rate, inputs.prices)

    def initial(self, constants, noise):
        return jnp.ones(())

    def observe(self, constants, now, state):
        return jnp.stack([state, now])

    def step(self, constants, now, state, action, noise, smooth):
        sold = action[0] * state
        left = (state - sold) * jnp.exp(-constants)
        return left, {"cash": sold * now * jnp.exp(0.1 * noise[0])}

    def terminal(self, constants, state, smooth):
        return {"cash": jnp.zeros_like(state)}


def problem(cut: bool) -> snapo.Problem:
    inputs = Inputs(
        snapo.Input(np.array(0.05), unit="1/day"),
        snapo.Input(np.array([1.0, 1.1, 1.3]), unit="EUR/MWh", labels=("d1", "d2", "d3")),
    )
    return snapo.Problem(Tank(cut=cut), inputs, snapo.Mean("cash"))


def test_right_derivatives_have_no_complaints():
    made = problem(cut=False)
    policy = snapo.MLP(made.action, made.features, key=jax.random.key(0), hidden=(4,))
    assert wrong_derivatives(made, policy, paths=16, every=True) == []


def test_a_cut_way_is_named():
    made = problem(cut=True)
    policy = snapo.Constant(np.array([0.4]))
    (complaint,) = wrong_derivatives(made, policy, paths=16)
    assert complaint.startswith("rate ") and "0 by the adjoint" in complaint
