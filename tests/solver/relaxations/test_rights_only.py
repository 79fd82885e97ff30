"""Which simulators have a bound as a stopping problem: those whose decisions move only the rights.

An American put that pays into an account, S = K = 40, r = 6 %, volatility 20 %, one year, 50 dates:
2.314 (Longstaff and Schwartz 2001, table 1), and 2.066 as a European put."""

import jax
import jax.numpy as jnp
import pytest

import snapo
from snapo.solver.relaxations.value import NotStopping, decisions

DATES, STRIKE, RATE, VOLATILITY = 50, 40.0, 0.06, 0.2
STEP = 1 / DATES


class IntoAnAccount(snapo.Simulator):
    """Collects the payoff in an account, which is paid at the end; at the money it is 0 today."""

    horizon: int = DATES
    noise_size: int = 1
    action: snapo.Stop = snapo.Stop()

    def prepare(self, inputs):
        return snapo.Schedule({"spot": inputs["spot"]}, {"left": 1 - STEP * jnp.arange(DATES)})

    def initial(self, constants, noise):
        zero = jnp.zeros(())
        return {"spot": constants["spot"], "account": zero, "right": self.action.initial()}

    def observe(self, constants, now, state):
        return jnp.stack([state["spot"], now["left"]])

    def step(self, constants, now, state, action, noise, smooth):
        right, used = self.action.use(state["right"], action)
        paid = used * jnp.maximum(STRIKE - state["spot"], 0.0)
        drift = (RATE - VOLATILITY**2 / 2) * STEP
        return {
            "spot": state["spot"] * jnp.exp(drift + VOLATILITY * STEP**0.5 * noise[0]),
            "account": (state["account"] + paid) * jnp.exp(RATE * STEP),
            "right": right,
        }, {}

    def terminal(self, constants, state, smooth):
        unused = self.action.alive(state["right"])
        paid = unused * jnp.maximum(STRIKE - state["spot"], 0.0)
        return {"cash": jnp.exp(-RATE) * (state["account"] + paid)}


class Apart(IntoAnAccount):
    """The same payoffs without an account. A compiled function returns the rights together with the
    price, which does not depend on decisions."""

    def initial(self, constants, noise):
        return {"spot": constants["spot"], "right": self.action.initial()}

    def step(self, constants, now, state, action, noise, smooth):
        @jax.jit
        def both(spot, rights, action):
            right, used = self.action.use(rights, action)
            return spot * jnp.exp(VOLATILITY * STEP**0.5 * noise[0]), right, used

        spot, right, used = both(state["spot"], state["right"], action)
        cash = used * jnp.maximum(STRIKE - state["spot"], 0.0)
        return {"spot": spot, "right": right}, {"cash": cash}

    def terminal(self, constants, state, smooth):
        unused = self.action.alive(state["right"])
        return {"cash": unused * jnp.maximum(STRIKE - state["spot"], 0.0)}


class Forgotten(Apart):
    """Its decisions move nothing."""

    def step(self, constants, now, state, action, noise, smooth):
        cash = action[0] * jnp.maximum(STRIKE - state["spot"], 0.0)
        return state | {"spot": state["spot"] + noise[0]}, {"cash": cash}


def problem(simulator) -> snapo.Problem:
    return snapo.Problem(simulator, {"spot": snapo.Input(STRIKE)}, snapo.Mean("cash"))


@pytest.mark.parametrize("rights", [1, 2])
def test_a_state_that_later_decisions_move_is_refused(rights):
    simulator = IntoAnAccount(action=snapo.Stop(rights=rights))
    with pytest.raises(NotStopping, match=r"change the state .*account.*, not only rights"):
        decisions(problem(simulator))


def test_a_state_beside_the_rights_in_a_compiled_function_is_not_moved():
    assert decisions(problem(Apart())).right == 0


def test_rights_that_no_decision_moves_are_refused():
    with pytest.raises(NotStopping, match=r"no state that `Stop.use` moves"):
        decisions(problem(Forgotten()))
