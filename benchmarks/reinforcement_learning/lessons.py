"""The training of a Pendulum in two lessons, the second from the policy of the first."""

import numpy as np

import snapo
from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants.pendulum import Pendulum

# Disturbances of the speed (rad/s), steps, paths, and rate of each lesson.
LESSONS = ((0.6, 80, 256, 0.02), (0.0, 190, 768, 0.015))
HORIZON = 90  # steps


def lessons(seed: int, validation_every: int) -> list[tuple[snapo.Problem, snapo.Training]]:
    """Both lessons, on starts around the bottom, where most of the reward is lost.

    Which way to swing, and how often, is a choice that a path's own derivative does not see. Under
    large disturbances, in the first lesson, the outcome changes gradually with the decisions. The
    second lesson, without disturbances, needs many paths, since few of them are near a change of
    the choice. Half of the horizon is enough: in nearly all of the rest the pendulum is upright.
    """
    found = []
    for noise, steps, paths, rate in LESSONS:
        inputs = make_inputs(Pendulum)
        inputs["start"]["angle"] = {"mean": np.pi, "deviation": 0.8}
        inputs["noise"] = {"speed": noise}
        training = snapo.Training(
            seed=seed, steps=steps, paths=paths, learning_rate=rate, window=40,
            validation_paths=1024, validation_every=validation_every,
        )  # fmt: skip
        found.append((plant(inputs, HORIZON), training))
    return found


def plant(inputs, horizon: int) -> snapo.Problem:
    """The Pendulum with these inputs, and its mean reward."""
    made = Pendulum(inputs, horizon=horizon)  # pyright: ignore[reportCallIssue]
    return snapo.Problem(made, inputs, snapo.Mean("reward"))
