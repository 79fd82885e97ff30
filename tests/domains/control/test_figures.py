"""Training figures in Gymnasium's own environments, on common starts; docs/control.md states them."""

import pytest

import snapo
from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants.mountain_car import MountainCar
from snapo.domains.control.plants.pendulum import Pendulum
from snapo.domains.control.twin import agent

pytest.importorskip("gymnasium")
import snapo.gym

pytestmark = pytest.mark.study

# Half of Pendulum's horizon: nearly all of the second half is spent upright, and teaches little.
# A mountain car that gets home in 500 steps gets home in 999.
RECIPES = {
    Pendulum: (100, {"steps": 150, "paths": 256, "learning_rate": 0.02, "window": 25}),
    MountainCar: (
        500,
        {"steps": 100, "paths": 64, "learning_rate": 0.005, "temperature_start": 0.03,
         "temperature_end": 0.02},
    ),
}  # fmt: skip


def real_mean(kind, seed: int, starts: int) -> float:
    """The mean reward in the real environment of a policy trained with this seed."""
    horizon, settings = RECIPES[kind]
    inputs = make_inputs(kind)
    plant = kind(inputs, horizon=horizon)
    training = snapo.Training(seed=seed, validation_paths=1024, validation_every=25, **settings)
    solution = snapo.solve(
        plant, inputs, objective=snapo.Mean("reward"), training=training,
        evaluation=snapo.Evaluation(paths=256, sensitivity_paths=0),
    )  # fmt: skip
    assert solution.policy is not None
    played = snapo.gym.play(agent(plant, solution.policy, inputs), kind.twin, starts)
    return played.mean


@pytest.mark.parametrize("seed", range(10))
def test_pendulum_in_the_real_environment(seed):
    """Seen: -144.2 to -146.6; the settings were chosen on seeds 1 and 2."""
    assert real_mean(Pendulum, seed, 2000) > -147


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_mountain_car_in_the_real_environment(seed):
    assert real_mean(MountainCar, seed, 100) > 94
