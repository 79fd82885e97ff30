"""Mistakes of a first simulator whose own message says little: the finding names the cause."""

import jax.numpy as jnp
import pytest

import snapo
from snapo.checker.check import check

INPUTS = {"spot": snapo.Input(100.0)}


class Hedge(snapo.Simulator):
    horizon, noise_size = 3, 1
    action = snapo.Product(hold=snapo.Box(0.0, 1.0), lend=snapo.Box(0.0, 1.0))

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.arange(3.0)})

    def initial(self, constants, noise):
        return {"spot": constants["spot"] / 100}

    def observe(self, constants, now, state):
        return state["spot"][None]

    def step(self, constants, now, state, action, noise, smooth):
        parts = self.action.parts(action)
        spot = state["spot"] * jnp.exp(0.1 * noise[0])
        return {"spot": spot}, {"cash": parts["hold"][0] * (spot - 1) + 0.1 * parts["lend"][0]}


class ByKey(Hedge):
    def step(self, constants, now, state, action, noise, smooth):
        return {"spot": state["spot"] * noise[0]}, {"cash": action["hold"][0] * 1.0}


class NoNoise(Hedge):
    noise_size = 0


class NoFirstNoise(Hedge):
    def initial(self, constants, noise):
        return {"spot": constants["spot"] / 100 + noise[0]}


@pytest.mark.parametrize(
    "simulator, fix",
    [
        (ByKey(), "self.action.parts(action)"),
        (NoNoise(), ", noise_size is 0"),
        (NoFirstNoise(), "initial_noise_size is 0"),
        (Hedge, "Hedge()"),
    ],
)
def test_the_likely_cause_is_named(simulator, fix):
    (found,) = check(simulator, INPUTS)
    assert found.severity == "error" and fix in found.fix, found
    assert str(check(Hedge, INPUTS)).startswith("Hedge: 1 error")


def test_a_class_in_place_of_its_object_is_refused_by_solve():
    with pytest.raises(ValueError, match=r"Hedge is a class; pass an object of it, Hedge\(\)"):
        snapo.solve(Hedge, INPUTS, objective=snapo.Mean("cash"))  # pyright: ignore


@pytest.mark.prove
def test_one_limit_needs_no_tuple():
    few = {
        "training": snapo.Training(steps=1, paths=8, validation_paths=8),
        "evaluation": snapo.Evaluation(8, 0, 0, 0, search_paths=0),
    }
    one = snapo.AtMost("cash", 1.0)
    solution = snapo.solve(
        Hedge(), INPUTS, objective=snapo.Mean("cash"), constraints=one, engine="xla", **few
    )
    assert len(solution.constraints) == 1
