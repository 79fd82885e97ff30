"""Windows are chosen where the horizon is chaotic, by adjoints as they are measured, and told."""

from dataclasses import replace
from statistics import NormalDist

import jax
import numpy as np
import pytest
from tests.solver.twelve import Pendulum, problem

import snapo
from snapo.engine import Native, Xla
from snapo.engine.norms import Norms
from snapo.problem.policy import parameters
from snapo.solver import checkpoint
from snapo.solver.learning.conditioning import (
    FIRST,
    LONGER,
    Growth,
    erratic,
    fell_for_good,
    grows,
    is_chaotic,
    window_length,
)
from snapo.solver.learning.windows import UPDATES
from snapo.solver.train import Training, initial_progress, train

NORMALS = np.array([NormalDist().inv_cdf((path + 0.5) / 64) for path in range(64)])


def grown(rate, spread, steps=100):
    """Norms that grow by `rate` a step on their way back, with a spread that grows as well."""
    back = np.arange(steps)[:, None]
    return np.exp(rate * back + spread * back * NORMALS)[::-1]


def test_gradients_are_erratic_where_they_leap_up_and_down():
    steady = [1e6, 9e5, 8.5e5, 8e5, 7e5, 6e5]
    assert not erratic(steady)
    assert not erratic([*steady, 10.0])  # one fall alone is an explosion that is over
    assert erratic([2400, 2200, 4700, 970, 1500, 1200, 7100, 560])
    assert not erratic([1.0, 1.5, 0.9, 1.4, 1.0], paths=16)  # noise of few paths
    assert erratic([1.0, 1.5, 0.9, 1.4, 1.0], paths=64)
    assert not erratic([]) and not erratic([1.0])


def test_gradients_are_wild_where_they_leap_and_teach_where_they_fall_for_good():
    falling = np.geomspace(1e9, 1e3, 20)
    leaping = np.where(np.arange(20) % 2, 3.0, 1.0) * 1e3
    assert fell_for_good(falling) and not fell_for_good(leaping)
    assert fell_for_good(leaping * np.geomspace(1e6, 1.0, 20))  # an unstable plant, learning
    assert is_chaotic(leaping) and not is_chaotic(np.linspace(10, 8, 20))
    once = [1.0, 500.0, *[2.0] * 18]  # one leap and its fall
    assert is_chaotic(once) and not fell_for_good(once)


def test_an_unstable_plant_is_not_chaotic_and_paths_that_grow_apart_are():
    assert window_length(grown(0.1, 0.0)) is None  # e^10, alike on all paths
    assert window_length(grown(0.01, 0.0)) is None
    assert grows(grown(0.1, 0.0)) and not grows(grown(0.01, 0.0))
    assert window_length(np.zeros((100, 64))) is None
    # The largest of 64 normals is 2.42: e^(2.42 x .1 x steps) is more than ten after ten.
    assert window_length(grown(0.1, 0.1)) == 10 * LONGER
    assert window_length(grown(0.05, 0.05)) == 20 * LONGER
    bad = grown(0.1, 0.1)
    bad[:50, 3] = np.nan
    assert window_length(bad) is not None


def test_a_record_of_adjoints_names_the_step_and_the_state_where_they_explode():
    whole = np.ones((50, 4))
    whole[20] = [2.0, 2.0, 3.0, 5000.0]
    record = Growth.of(Norms(whole, {"level": 0.1 * whole, "price": 0.9 * whole}), 7)
    words = record.describe()
    assert "step 20 of 50" in words and "'price'" in words and "5,000-fold" in words
    assert "which is usual" in Growth.of(Norms(np.ones((5, 4)), {}), 0).describe()
    assert record.columns == ("step", "usual", "largest", "level", "price")
    assert record.table()[20] == (20, 2.5, 5000.0, *(record.leaves[n][20] for n in record.leaves))


SHORT = Training(steps=24, paths=64, validation_paths=64, validation_every=22, warmup=2)


@pytest.fixture(scope="module")
def swings():
    """A short training of a pendulum by each engine, with its states at every validation."""
    found = {}
    for engine in (Xla(), Native()):
        of, states = problem(Pendulum), []
        policy = snapo.MLP(hidden=(8,)).for_problem(of.interface, jax.random.key(0))
        done = train(of, initial_progress(policy, SHORT, of), SHORT, engine, [states.append])
        found[engine.__class__.__name__] = of, policy, done, states
    return found


@pytest.mark.prove
def test_a_pendulum_is_trained_on_windows_by_default_and_both_engines_choose_alike(swings):
    (_, policy, one, _), (_, _, other, _) = swings.values()
    assert one.window == other.window and one.window in range(5, 31)
    assert {record.window for record in one.history} == {0, one.window}
    assert one.growth.step == one.since <= FIRST
    assert set(one.growth.leaves) == {"angle", "speed"}
    np.testing.assert_allclose(one.growth.usual, other.growth.usual, rtol=1e-2)
    # Adam makes steps of one size of the rounding of gradients that are nearly zero.
    mine, theirs, start = (parameters(each) for each in (one.policy, other.policy, policy))
    assert np.abs(mine - theirs).mean() < 0.1 * np.abs(mine - start).mean()


@pytest.mark.prove
def test_windows_begin_with_a_warm_up_of_their_own(swings):
    """The schedule's count is of the updates since: at the full rate a critic that knows nothing
    led one Pendulum of seven to -766."""
    _, _, done, _ = swings["Native"]
    assert int(done.optimiser[-1].count) == UPDATES * (SHORT.steps - done.since)


@pytest.mark.prove
def test_a_run_that_chose_windows_resumes_with_the_same_bits(swings, tmp_path):
    of, policy, whole, states = swings["Xla"]
    checkpoint.save(states[0], tmp_path / "checkpoint.npz")
    resumed = checkpoint.load(tmp_path / "checkpoint.npz", initial_progress(policy, SHORT, of))
    assert resumed.step == 22 and resumed.window == whole.window
    assert resumed.growth == whole.growth
    again = train(of, resumed, SHORT, Xla())
    np.testing.assert_array_equal(parameters(again.policy), parameters(whole.policy))


@pytest.mark.prove
def test_windows_are_not_chosen_where_they_are_not_wanted_or_have_no_worth(swings):
    of, policy, _, _ = swings["Xla"]
    plan = replace(SHORT, steps=21)
    for one, training in (
        (of, replace(plan, window=None)),
        (replace(of, objective=snapo.CVaR("value", 0.5)), plan),
    ):
        done = train(one, initial_progress(policy, training, one), training, Xla())
        assert done.window is None and done.critic is None
