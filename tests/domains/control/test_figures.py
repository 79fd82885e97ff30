"""Training figures in Gymnasium's own environments, on common starts; docs/control.md states them."""

import numpy as np
import pytest

import snapo
from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants.mountain_car import MountainCar
from snapo.domains.control.plants.pendulum import Pendulum
from snapo.domains.control.twin import agent

pytest.importorskip("gymnasium")
import snapo.gym

pytestmark = pytest.mark.study


def pendulum(seed: int):
    """A policy in two lessons on starts around the bottom, where most of what is lost is lost.

    Which way to swing, and how often, is a choice that a path's own derivative does not see. Under
    large disturbances it becomes a matter of degree: the first lesson. The second one, without
    them, needs many paths, as few of them pass a ridge. Half of the horizon is enough: nearly all
    of the rest is spent upright.
    """
    policy = None
    for noise, steps, paths, rate in ((0.6, 80, 256, 0.02), (0.0, 190, 768, 0.015)):
        inputs = make_inputs(Pendulum)
        inputs["start"]["angle"] = {"mean": np.pi, "deviation": 0.8}
        inputs["noise"] = {"speed": noise}
        training = snapo.Training(
            seed=seed, steps=steps, paths=paths, learning_rate=rate, window=40,
            validation_paths=1024, validation_every=40,
        )  # fmt: skip
        policy = trained(Pendulum(inputs, horizon=90), inputs, training, policy)
    return policy


def mountain_car(seed: int):
    """A car that gets home in 500 steps gets home in 999."""
    inputs = make_inputs(MountainCar)
    training = snapo.Training(
        seed=seed, steps=100, paths=64, learning_rate=0.005, temperature_start=0.03,
        temperature_end=0.02, validation_paths=1024, validation_every=25,
    )  # fmt: skip
    return trained(MountainCar(inputs, horizon=500), inputs, training)


def trained(plant, inputs, training, policy=None):
    """The policy of one training; without derivatives."""
    solution = snapo.solve(
        plant, inputs, objective=snapo.Mean("reward"), training=training, policy=policy,
        evaluation=snapo.Evaluation(paths=256, sensitivity_paths=0),
    )  # fmt: skip
    return solution.policy


def real_mean(kind, policy, starts: int) -> float:
    """The mean reward of a policy in the real environment."""
    inputs = make_inputs(kind)
    return snapo.gym.play(agent(kind(inputs), policy, inputs), kind.twin, starts).mean


@pytest.mark.parametrize("seed", range(10))
def test_pendulum_in_the_real_environment(seed):
    """Seen: -140.7 to -144.0, -141.9 on average; the settings were chosen on seeds 0 to 5, on other starts."""
    assert real_mean(Pendulum, pendulum(seed), 2000) > -147


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_mountain_car_in_the_real_environment(seed):
    assert real_mean(MountainCar, mountain_car(seed), 100) > 94
