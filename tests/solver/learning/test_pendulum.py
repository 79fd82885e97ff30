"""Pendulum-v1 by default settings: two hundred steps whose adjoints are chaotic."""

import time

import jax
import jax.numpy as jnp
import pytest

import snapo


class Pendulum(snapo.Simulator):
    """Gymnasium's Pendulum-v1, its angle unwrapped and its cost periodic."""

    horizon: int = 200
    action: snapo.Box = snapo.Box(-2.0, 2.0)
    noise_size: int = 0
    initial_noise_size: int = 2

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.zeros(self.horizon)})

    def initial(self, constants, noise):
        angle, speed = 2 * jax.scipy.special.ndtr(noise) - 1
        return {"angle": jnp.pi * angle, "speed": speed}

    def observe(self, constants, now, state):
        return jnp.append(snapo.angle_features(state["angle"]), state["speed"] / 4)

    def step(self, constants, now, state, action, noise, smooth):
        angle, speed, torque = state["angle"], state["speed"], action[0]
        cost = snapo.wrap_angle(angle) ** 2 + 0.1 * speed**2 + 0.001 * torque**2
        turn = 1.5 * constants["gravity"] * jnp.sin(angle) + 3 * torque
        speed = jnp.clip(speed + 0.05 * turn, -8.0, 8.0)
        return {"angle": angle + 0.05 * speed, "speed": speed}, {"value": -cost}


@pytest.mark.study
@pytest.mark.parametrize("seed", range(10))
def test_a_pendulum_by_default_settings_is_swung_up(seed):
    """At least -160 on the mean of 8,192 starts (dynamic programming: -137.9, SAC -157), in less
    than 60 seconds of all processors together."""
    evaluation = snapo.Evaluation(paths=8192, sensitivity_paths=0, smooth_paths=0, judge_paths=0)
    started = time.process_time()
    solution = snapo.solve(
        Pendulum(),
        {"gravity": snapo.Input(10.0)},
        training=snapo.Training(seed=seed),
        evaluation=evaluation,
    )
    spent = time.process_time() - started
    print(f"seed {seed}: {solution.value:.2f} in {spent:.0f} s of processor time")
    assert spent < 60
    assert solution.value > -160
    assert "windows of" in " ".join(solution.notes)
    assert solution.growth is not None and "a hundredfold before step" in solution.growth.describe()


@pytest.mark.prove
def test_a_leap_before_the_choice_does_not_hide_the_chaos():
    """With seed 9 a gradient leaps at step 19 and brings a bound, one step before windows are
    chosen; without them the pendulum ended at -460."""
    few = snapo.Evaluation(paths=64, sensitivity_paths=0, smooth_paths=0, judge_paths=0)
    training = snapo.Training(seed=9, steps=25)
    solution = snapo.solve(
        Pendulum(), {"gravity": snapo.Input(10.0)}, training=training, evaluation=few
    )
    found = [(record.clip > 0, record.window > 0) for record in solution.history]
    assert found[19] == (True, False) and found[-1] == (False, True)
