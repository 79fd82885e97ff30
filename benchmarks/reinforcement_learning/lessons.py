"""How a Pendulum is taught: two trainings, the second one from the policy of the first."""

import numpy as np

import snapo
from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants.pendulum import Pendulum

# Disturbances of the speed (rad/s), steps, paths, and rate of each lesson.
LESSONS = ((0.6, 80, 256, 0.02), (0.0, 190, 768, 0.015))
HORIZON = 90  # steps


def lessons(seed: int, validation_every: int) -> list[tuple[snapo.Problem, snapo.Training]]:
    """Both, on starts around the bottom, where most of what is lost is lost.

    Which way to swing, and how often, is a choice that a path's own derivative does not see. Under
    large disturbances it becomes a matter of degree: the first lesson. The second one, without
    them, needs many paths, as few of them pass a ridge. Half of the horizon is enough: nearly all
    of the rest is spent upright.
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
    """The Pendulum of these inputs, and its mean reward."""
    made = Pendulum(inputs, horizon=horizon)  # pyright: ignore[reportCallIssue]
    return snapo.Problem(made, inputs, snapo.Mean("reward"))
