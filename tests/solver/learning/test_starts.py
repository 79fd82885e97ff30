"""Several starts: they differ in their networks alone, and after every round the better half stays."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from tests.solver.twelve import Regulator, policy, problem

import snapo
from snapo.problem.policy import parameters
from snapo.solver.learning import starts
from snapo.solver.train import Training, begin

SMALL = snapo.Evaluation(paths=256, sensitivity_paths=0, smooth_paths=0, judge_paths=0)


def test_other_starts_have_other_weights_of_the_same_size_and_the_first_is_the_policy_itself():
    of = problem(Regulator)
    one = policy(of)
    found = starts.others(one, 3, seed=0)
    assert found[0] is one
    weights = [np.asarray(each.network.weights[1]) for each in found]
    assert not np.allclose(weights[1], weights[2])
    for each in weights[1:]:
        assert np.sqrt(np.mean(each**2)) == pytest.approx(
            np.sqrt(np.mean(weights[0] ** 2)), rel=0.2
        )
    for again, before in zip(starts.others(one, 3, seed=0), found):
        np.testing.assert_array_equal(parameters(again), parameters(before))


def test_a_policy_without_a_network_has_one_start():
    with pytest.raises(ValueError, match="Linear has no network"):
        starts.others(snapo.Linear([[1.0]]), 2, seed=0)
    with pytest.raises(ValueError, match="starts"):
        Training(starts=0)


def test_the_better_half_goes_on_until_one_is_left():
    of = problem(Regulator)
    one, ran = begin(policy(of), Training()), []
    begun = [replace(one, best_value=float(value)) for value in (3, 5, 4, 1, 2)]

    def run(progress, until):
        ran.append((progress.best_value, until))
        return replace(progress, step=until)

    left, values = starts.race(begun, 200, run)
    assert left.best_value == 5.0 and left.step == 60
    assert ran == [
        *((value, 20) for value in (3, 5, 4, 1, 2)), (5, 40), (4, 40), (3, 40), (5, 60), (4, 60),
    ]  # fmt: skip
    assert values == (3.0, 5.0, 4.0, 1.0, 2.0)
    words = starts.words(values, 200)
    assert "Of 5 starts" in words and "number 2" in words and "every 20 steps" in words
    assert starts.race(begun[:1], 200, run)[0] is begun[0]


@pytest.mark.prove
def test_solve_runs_several_starts_and_says_which_one_went_on():
    """The last one's training is that of one start: as many steps, from its own weights."""
    of = problem(Regulator)
    plan = Training(steps=20, paths=32, validation_paths=128, starts=3)
    kind = snapo.MLP(hidden=(8,))
    solution = snapo.solve(of, policy=kind, training=plan, evaluation=SMALL, engine="xla")
    assert "Of 3 starts, halved every 2 steps" in " ".join(solution.notes)
    assert len(solution.history) == 20
    made = kind.for_problem(of.interface, jax.random.key(0))
    given = snapo.solve(of, policy=made, training=plan, evaluation=SMALL, engine="xla")
    assert "Of 3 starts" in " ".join(given.notes)
