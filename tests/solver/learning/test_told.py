"""Adjoints that grow: the share that goes on, the sentence that tells of them, and the bound."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.engine.norms import Norms
from snapo.problem.policies.rules import Linear
from snapo.problem.problem import Problem
from snapo.problem.simulator import Schedule, Simulator
from snapo.solver.learning.conditioning import Growth, share_kept
from snapo.solver.learning.log import start_notes
from snapo.solver.learning.progress import Record, initial_progress

STEPS = 40
TRAINING = snapo.Training(steps=4, paths=16, validation_paths=64, validation_every=2)


class Runaway(Simulator):
    """A state that grows by `factor` a step, against which the decision can do little."""

    factor: float = 1.3
    horizon: int = STEPS
    action: snapo.Box = snapo.Box(-1.0, 1.0)
    noise_size: int = 1

    def prepare(self, inputs):
        return Schedule(dict(inputs), {"t": jnp.zeros(self.horizon)})

    def initial(self, constants, noise):
        return {"x": constants["start"]}

    def observe(self, constants, now, state):
        return jnp.stack([jnp.tanh(state["x"])])

    def step(self, constants, now, state, action, noise, smooth):
        x = self.factor * state["x"] + 0.01 * (action[0] + noise[0])
        return {"x": x}, {"value": -jnp.tanh(x)}


def problem(factor=1.3):
    return Problem(Runaway(factor), {"start": snapo.Input(1e-6)}, snapo.Mean("value"))


RULE = Linear(np.zeros((1, 1)), action=Runaway().action)
FEW = snapo.Evaluation(paths=256, sensitivity_paths=0, smooth_paths=0, judge_paths=0)


def growing(times, paths=8, steps=101):
    """Norms [T, N] that grow alike on all paths, `times`-fold from the last step to the first."""
    return np.repeat(np.geomspace(times, 1.0, steps)[:, None], paths, axis=1)


def test_a_third_is_left_after_the_steps_in_which_adjoints_grow_a_hundredfold():
    """10,000-fold over 100 steps: a hundredfold over 50, one more to be above it."""
    assert share_kept(growing(1e4)) == pytest.approx(3 ** (-1 / 51))
    assert share_kept(growing(90.0)) == 1.0
    exploded = growing(1e4)
    exploded[:90] = np.nan
    assert share_kept(exploded) == pytest.approx(3 ** (-1 / 11))


def grown(times):
    return Growth.of(Norms(growing(times), {"angle": growing(times)}), 20)


def ended(times, window=None, clip=None, keep=1.0):
    """A training of 30 steps that bounded adjoints from step 20 on."""
    line = Record(1, 0.0, 1.0, 0.02, 0, 0.0, 0.0, 0.0)
    later = line._replace(window=window or 0, clip=clip or 0.0, keep=keep)
    begun = initial_progress(RULE, TRAINING, problem())
    history = (*(line,) * 20, *(later,) * 10)
    return replace(begun, growth=grown(times), window=window, clip=clip, keep=keep, history=history)


@pytest.mark.parametrize(
    "how, said",
    [({"clip": 12.3}, "bounded, by 12.3 at the end (Training(clip=None) turns this off)"),
     ({"window": 25}, "From step 20 of the training on, windows of 25 steps"),
     ({"clip": 2.0, "keep": 0.9}, "every backward step kept only a share of 0.9 of the adjoint"),
     ({}, "Training did not respond to this")],
)  # fmt: skip
def test_large_growth_is_told_with_step_state_and_bound(how, said):
    (told,) = start_notes(ended(5000.0, **how))
    assert "5,000-fold" in told and "before step" in told and "'angle'" in told
    assert said in told and ("step 20 of the training" in told or not how)


def test_a_bound_that_was_lifted_is_told_with_its_steps():
    (told,) = start_notes(replace(ended(5000.0, clip=12.3), clip=None))
    said = (
        "From step 20 of the training on until step 30, after which adjoints no longer grew, each"
    )
    assert said in told and "at the end" not in told


def test_a_quiet_horizon_is_not_told_of():
    """As of a storage or a fund, whose adjoints add up over a year of steps at most."""
    assert start_notes(ended(99.0, clip=3.0)) == ()
    assert start_notes(initial_progress(RULE, TRAINING, problem())) == ()


@pytest.mark.prove
def test_a_window_of_ones_own_has_its_record_too(tmp_path):
    """It went unmeasured: the growth is that of the trained rule, in solution, file and notes."""
    plan = replace(TRAINING, window=10)
    found = snapo.solve(problem(), policy=RULE, training=plan, evaluation=FEW, engine="xla")
    assert found.growth is not None and found.growth.step == 4 and found.growth.large
    assert found.window == 10 and found.clip is None
    assert any("windows of 10 steps" in note and "'x'" in note for note in found.notes)
    found.save(tmp_path)
    again = snapo.Solution.load(tmp_path)
    assert (again.window, again.clip, again.keep) == (10, None, 1.0)
    assert found.summary()["adjoints"] == found.growth.describe()
    bounded = replace(TRAINING, clip=2.0, keep=0.9)
    found = snapo.solve(problem(), policy=RULE, training=bounded, evaluation=FEW, engine="xla")
    assert (found.clip, found.keep) == (2.0, 0.9) and found.growth is not None
    assert {record.clip for record in found.history} == {2.0}
    assert found.summary()["clip"] == 2.0 and "by 2 at the end" in " ".join(found.notes)


@pytest.mark.prove
def test_the_record_of_a_training_left_alone_is_empty():
    quiet = snapo.solve(problem(1.0), policy=RULE, training=TRAINING, evaluation=FEW, engine="xla")
    assert quiet.growth is None and (quiet.window, quiet.clip, quiet.keep) == (None, None, 1.0)
    assert not any("Adjoints" in note for note in quiet.notes)
