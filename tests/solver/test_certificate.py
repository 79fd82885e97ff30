"""The certificate of derivatives: no false alarm on right ones, and every planted fault is found."""

import jax.numpy as jnp
import numpy as np
import pytest

from snapo import Box, Constant, Input, Mean, Problem, Pseudo, Simulator
from snapo.problem.scenarios import Sources
from snapo.problem.simulator import Schedule
from snapo.solver import certificate
from snapo.solver.certificate import certify_derivatives

DAYS = 365


class Leaking(Simulator):
    """A store that loses a share a day and is sold along a curve: the loss compounds."""

    horizon, noise_size = DAYS, 1
    action = Box(0.0, 1.0)

    def prepare(self, inputs):
        constants = {"loss": inputs["loss"], "stock": inputs["stock"]}
        return Schedule(constants, {"price": inputs["curve"]})

    def initial(self, constants, noise):
        return {"stock": constants["stock"]}

    def observe(self, constants, now, state):
        return jnp.stack([state["stock"] / 1000])

    def step(self, constants, now, state, action, noise, smooth):
        kept = state["stock"] * (1 - constants["loss"])
        sold = smooth.minimum(action[0], kept)
        price = now["price"] * jnp.exp(0.02 * noise[0] - 0.0002)
        return {"stock": kept - sold}, {"profit": price * sold}

    def terminal(self, constants, state, smooth):
        return {"profit": 20.0 * state["stock"]}


def leaking() -> Problem:
    curve = 20 + 3 * np.sin(np.arange(DAYS) / 58)
    inputs = {"loss": Input(0.0), "stock": Input(1000.0), "curve": Input(curve)}
    sources = Sources(*(Pseudo(seed) for seed in (1, 2, 3)))
    return Problem(Leaking(), inputs, Mean("profit"), sources)


def certified(problem: Problem):
    return {bump.input: bump for bump in certify_derivatives(problem, Constant([0.5]), paths=16)}


def test_a_loss_that_compounds_is_no_false_alarm():
    """Within a step of 1e-5 it bends by 2e-6 of its derivative, which is no fault of the adjoint."""
    found = certified(leaking())
    assert set(found) == {"loss", "stock", "curve"}
    assert all(bump.passed and bump.judged for bump in found.values())
    exact = -sum(0.5 * day for day in range(DAYS))  # of the stock, to first order in what is sold
    assert found["loss"].adjoint < 20 * exact


def wrong_sign(gradient):
    return gradient | {"loss": -gradient["loss"]}


def a_thousandth(gradient):
    return gradient | {"loss": 1.001 * gradient["loss"]}


def a_dropped_term(gradient):
    return gradient | {"stock": np.zeros_like(gradient["stock"])}


def one_wrong_entry(gradient):
    curve = gradient["curve"].copy()
    curve[DAYS // 2] *= 1.01
    return gradient | {"curve": curve}


@pytest.mark.parametrize(
    ("fault", "of"),
    [
        (wrong_sign, "loss"),
        (a_thousandth, "loss"),
        (a_dropped_term, "stock"),
        (one_wrong_entry, "curve"),
    ],
)
def test_a_planted_fault_is_found_and_nothing_else(monkeypatch, fault, of):
    right = certificate._Replay.gradient
    monkeypatch.setattr(certificate._Replay, "gradient", lambda *given: fault(right(*given)))
    found = certified(leaking())
    assert [name for name, bump in found.items() if not bump.passed] == [of]


class Tied(Simulator):
    """Cash with two kinks at the limit of zero that cancel, and on some paths one that does not."""

    horizon, noise_size = 1, 1
    action = Box(0.0, 1.0)

    def prepare(self, inputs):
        return Schedule({"limit": inputs["limit"]}, {})

    def initial(self, constants, noise):
        return {"up": noise[0] if noise.size else jnp.zeros(())}

    def observe(self, constants, now, state):
        return jnp.zeros(1)

    def step(self, constants, now, state, action, noise, smooth):
        limit = constants["limit"]
        above = jnp.maximum(jnp.maximum(limit, 0.0), 0.0)  # at a tie a quarter of the slope
        cancelled = above + jnp.minimum(limit, 0.0)
        seen = jnp.where(noise[0] > 0, jnp.maximum(limit, 0.0), 0.0)
        return state, {"profit": 3.0 * cancelled + seen}


def test_kinks_that_cancel_are_no_false_alarm_and_a_fault_there_is_found(monkeypatch):
    sources = Sources(*(Pseudo(seed) for seed in (1, 2, 3)))
    tied = Problem(Tied(), {"limit": Input(0.0, move=1.0)}, Mean("profit"), sources)
    found = certify_derivatives(tied, Constant([0.5]), paths=16)
    assert 0 < found[0].crossing < 1 and not found[0].judged  # the tie is seen on some paths only
    assert found[0].error > found[0].allowed
    assert [bump.direction for bump in found] == ["", "nearby"] and found[1].passed
    assert found[1].judged and 3.0 < found[1].adjoint < 4.0
    right = certificate._Replay.gradient

    def wrong(*given):
        return {"limit": 1.01 * right(*given)["limit"]}

    monkeypatch.setattr(certificate._Replay, "gradient", wrong)
    assert not certify_derivatives(tied, Constant([0.5]), paths=16)[1].passed
