"""The plants with a twin in Gymnasium: the same states and rewards, step by step."""

import jax
import numpy as np
import pytest

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.domains.control import DOMAIN
from snapo.domains.control.chapters.baselines import check_same
from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants.mountain_car import MountainCar
from snapo.domains.control.plants.pendulum import Pendulum
from snapo.domains.control.study import objective_of, plant_at
from snapo.problem.inputs import plain
from snapo.problem.smooth import Exact

gymnasium = pytest.importorskip("gymnasium")

# Starts from which 40 random actions meet every limit: top speed, both walls, the goal.
STARTS = {
    Pendulum: [(3.0, 0.5), (0.1, 7.9), (-2.0, -7.9), (40.0, 0.0)],
    MountainCar: [(-0.5, 0.0), (-1.19, -0.06), (0.4, 0.06), (0.44, -0.001), (-0.2, 0.069)],
}


@pytest.mark.prove
@pytest.mark.parametrize("plant", STARTS)
def test_a_step_is_that_of_gymnasium(plant):
    """Transitions of the real environment under random actions, each made again in float32."""
    seen = transitions(plant)
    inputs = make_inputs(plant)
    made, values = plant(inputs), plain(inputs)
    names = list(plant.states)

    def once(before, action):
        state = dict(zip(names, before))
        if plant is MountainCar:
            state["alive"] = 1.0
        after, outputs = made.step(values, {}, state, action, np.zeros(0), Exact())
        return [after[name] for name in names], outputs["reward"], after.get("alive", 1.0)

    before, actions = (np.asarray(seen[key], np.float32) for key in ("before", "action"))
    limit = values["plant"].get("torque", 1.0)
    after, rewards, alive = jax.jit(jax.vmap(once))(before, (actions / limit).astype(np.float32))
    # A few units in the last place of the largest angle (40) and of the largest reward (17).
    assert np.allclose(np.stack(after, 1), seen["after"], rtol=1e-6, atol=1e-6)
    assert np.allclose(rewards, seen["reward"], rtol=2e-6, atol=4e-5)
    assert np.array_equal(np.asarray(alive) < 0.5, seen["ended"])
    if plant is MountainCar:
        assert np.any(seen["ended"]) and np.any(np.isclose(seen["after"][:, 0], -1.2))


@pytest.mark.parametrize("size", ("pendulum", "mountain-car"))
def test_a_template_is_compared_with_gymnasium(size):
    file, data = load(DOMAIN.templates[size] / "case.toml")
    case = DOMAIN.read(file, data)
    check_same(plant_at(case), case.inputs, objective_of(case))


@pytest.mark.parametrize(
    ("table", "keys", "message"),
    [
        ("plant", {"mass": 1.2}, "plant.mass: got 1.2; it must be 1, as in Pendulum-v1"),
        ("plant", {"horizon": 100}, "plant.horizon: got 100; it must be 200, as in Pendulum-v1"),
        ("start", {"speed": {"at": 0.5}},
         "start.speed: got { at = 0.5 }; it must be { low = -1, high = 1 }, as in Pendulum-v1"),
        ("measurement", {"speed": 0.1}, "no noise"),
        ("objective", {"kind": "cvar", "level": 0.9}, "the case has another objective"),
    ],
)  # fmt: skip
def test_another_problem_than_gymnasiums_is_refused(table, keys, message):
    file, data = load(DOMAIN.templates["pendulum"] / "case.toml")
    changed = {"training": {}, table: data.get(table, {}) | keys}
    case = DOMAIN.read(file, data | changed)
    with pytest.raises(CaseError) as caught:
        check_same(plant_at(case), case.inputs, objective_of(case))
    assert message in str(caught.value) and "\n" not in str(caught.value)


def transitions(plant) -> dict[str, np.ndarray]:
    """State, action, next state, reward and end of each step of the real environment."""
    random = np.random.default_rng(0)
    found = {key: [] for key in ("before", "action", "after", "reward", "ended")}
    environment = gymnasium.make(plant.twin, disable_env_checker=True).unwrapped
    for start in STARTS[plant]:
        environment.reset(seed=0)
        environment.state = np.array(start)
        for _ in range(40):
            before = np.array(environment.state)
            action = random.uniform(*(environment.action_space.low, environment.action_space.high))
            _, reward, ended, _, _ = environment.step(action.astype(np.float32))
            row = before, action, np.array(environment.state), reward, ended
            for key, each in zip(found, row):
                found[key].append(each)
            if ended:
                break
    return {key: np.array(rows) for key, rows in found.items()}
