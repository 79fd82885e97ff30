"""Trainings that end at doing nothing: seen, begun anew, or said."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.solver.learning.idle_store import INPUTS as IDLE
from tests.solver.learning.idle_store import IdleStore

import snapo
from snapo.solver import checkpoint
from snapo.solver.learning.log import start_notes
from snapo.solver.learning.progress import Record, initial_progress
from snapo.solver.learning.settings import TrainingPlan
from snapo.solver.verdict.constant import DRAWN, caught, equal_on_all_paths, exploring

DATES = 16
FEW = snapo.Evaluation(paths=2048, sensitivity_paths=0, smooth_paths=0, judge_paths=0)


class Store(snapo.Simulator):
    """A store of sixteen dates and four steps to fill it, for a price that reverts to its forward."""

    horizon: int = DATES
    noise_size: int = 1
    action: snapo.Box = snapo.Box(-1.0, 1.0)

    def prepare(self, inputs):
        t = jnp.arange(float(DATES))
        stays = inputs["stays"]
        variance = inputs["deviation"] ** 2 * (1 - stays ** (2 * t)) / (1 - stays**2)
        steps = {"forward": inputs["curve"], "half": variance / 2, "left": 1 - t / DATES}
        return snapo.Schedule({n: inputs[n] for n in ("deviation", "stays")}, steps)

    def initial(self, constants, noise):
        return {"x": jnp.zeros(()), "gas": jnp.zeros(())}

    def observe(self, constants, now, state):
        price = now["forward"] * jnp.exp(state["x"] - now["half"])
        turn, gas = 2 * jnp.pi * now["left"], 2 * state["gas"]
        return jnp.stack(
            [price / 4 - 5, gas - 1, now["left"], jnp.sin(turn), jnp.cos(turn), gas * jnp.cos(turn)]
        )

    def step(self, constants, now, state, action, noise, smooth):
        price = now["forward"] * jnp.exp(state["x"] - now["half"])
        put = smooth.minimum(0.25 * smooth.positive_part(action[0], 1.0), 1.1 - state["gas"], 0.25)
        taken = smooth.minimum(0.25 * smooth.positive_part(-action[0], 1.0), state["gas"], 0.25)
        cash = (price - 0.2) * taken - (price + 0.3) * put
        x = constants["stays"] * state["x"] + constants["deviation"] * noise[0]
        return {"x": x, "gas": state["gas"] + put - taken}, {"cash": cash}


CURVE = 20 + 4 * np.sin(2 * np.pi * np.arange(DATES) / DATES - 2.2)
STORE = {
    "curve": snapo.Input(CURVE), "deviation": snapo.Input(0.12), "stays": snapo.Input(0.8)
}  # fmt: skip


PROBLEM = snapo.Problem(IdleStore(), IDLE, snapo.Mean("cash"))
PLAN = snapo.Training(steps=100, paths=8)


def stands(step, alike, **more):
    """A training of a store after a step, with so many validations in a row that are all alike."""
    policy = snapo.MLP(hidden=(4,)).for_problem(PROBLEM.interface, jax.random.key(0))
    line = Record(0, 0.0, 1.0, 0.02, 0, 0.0, 0.0, 0.0)
    history = tuple(line._replace(step=number + 1) for number in range(step))
    found = {"step": step, "unchanged": alike, "history": history, **more}
    return replace(initial_progress(policy, PLAN, PROBLEM), **found)


def test_two_validations_that_are_the_same_on_every_path_are_a_training_that_does_nothing():
    assert caught(stands(20, 2), PLAN)
    assert not caught(stands(20, 1), PLAN)
    assert not caught(stands(60, 2), PLAN)  # too late
    assert not caught(stands(40, 2, redrawn=(5, 10, 20)), PLAN)  # often enough
    same = {"cash": np.array([0.7, 0.7 + 1e-16, 0.7, np.nextafter(0.7, 1)])}
    assert equal_on_all_paths(PROBLEM, same)
    # Antithetic pairs of a linear payoff have no error, and differ.
    assert not equal_on_all_paths(PROBLEM, {"cash": np.array([1.0, -1.0, 2.0, -2.0])})
    assert not equal_on_all_paths(PROBLEM, {"cash": np.array([0.0, np.nan])})


def test_a_checkpoint_and_the_notes_know_where_training_began_anew(tmp_path):
    progress = stands(20, 1, redrawn=(10, 20))
    checkpoint.save(progress, tmp_path / "state.npz")
    again = checkpoint.load(tmp_path / "state.npz", progress)
    assert (again.redrawn, again.unchanged) == ((10, 20), 1)
    (said,) = start_notes(progress)
    assert said == (
        "Training restarted from other initial weights at steps 10 and 20, since every path earned "
        "the same (0)."
    )


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 3, 5])
def test_a_store_that_does_nothing_begins_anew_and_is_trained(seed):
    """7.627 by dynamic programming. Seeds 3 and 5 ended at 0 ± 0, "trained, converged"."""
    training = snapo.Training(seed=seed, steps=600, learning_rate=0.04)
    solution = snapo.solve(Store(), STORE, training=training, evaluation=FEW)
    assert solution.value > 7.4
    assert any("restarted" in note for note in solution.notes) == (seed > 0)


@pytest.mark.prove
def test_a_training_that_still_does_nothing_says_so():
    """A rule of one's own is never replaced: a store at rest stays there, and is no good result."""
    problem = snapo.Problem(IdleStore(), IDLE, snapo.Mean("cash"))
    training = snapo.Training(steps=0, paths=8)
    solution = snapo.solve(
        problem, policy=snapo.Constant([0.0, 0.0]), training=training, evaluation=FEW
    )
    assert (solution.value, solution.standard_error) == (0.0, 0.0)
    assert solution.convergence == "constant"
    (note,) = [each for each in solution.notes if "Every path earns the same (0)" in each]
    assert "another seed" in note


def test_it_begins_anew_with_decisions_drawn_where_they_have_bounds():
    plan = TrainingPlan(steps=100, paths=8)
    assert exploring(plan, snapo.Box(0.0, 1.0, 2)).exploration == DRAWN
    assert exploring(replace(plan, exploration=0.5), snapo.Box(0.0, 1.0)).exploration == 0.5
    assert exploring(plan, snapo.Box(0.0, np.inf)) is plan
