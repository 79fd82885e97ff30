"""Several starts: they differ in their networks alone, and after every round the better half stays."""

import json
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.solver.twelve import Regulator, policy, problem

import snapo
from snapo.problem.policy import parameters
from snapo.problem.problem import Problem
from snapo.solver.learning import starts
from snapo.solver.learning.progress import Round
from snapo.solver.learning.settings import resolve_auto
from snapo.solver.train import Training, initial_progress

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
    one, ran = initial_progress(policy(of), Training()), []
    begun = [replace(one, best_value=float(value)) for value in (3, 5, 4, 1, 2)]

    def run(progress, until):
        ran.append((progress.best_value, until))
        return replace(progress, step=until)

    left, rounds = starts.race(begun, 200, run)
    assert left.best_value == 5.0 and left.step == 60
    assert ran == [
        *((value, 20) for value in (3, 5, 4, 1, 2)), (5, 40), (4, 40), (3, 40), (5, 60), (4, 60),
    ]  # fmt: skip
    assert [each.step for each in rounds] == [20, 40, 60]
    assert rounds[1].values == ((1, 5.0), (2, 4.0), (0, 3.0))
    assert starts.describe(rounds) == (
        "Of 5 starts, of which the worse half was dropped every 20 steps, number 2 remained: the "
        "values of the others were 80 % lower to 20 % "
        "lower at step 20; the values of the others were 40 % lower to 20 % lower at step 40; the "
        "value of the other was 20 % "
        "lower at step 60. The result depends on the initial weights: try more of them (starts=10)."
    )
    assert starts.race(begun[:1], 200, run) == (begun[0], ())
    assert Round.read(json.loads(json.dumps(rounds[0]))) == rounds[0]


def test_starts_are_compared_at_equal_steps_also_where_the_winner_was_behind():
    """What a start had when it fell out is no news of how far it would have come."""
    rounds = (Round(10, ((1, 2.01), (0, 2.0), (2, 1.985))), Round(20, ((0, 3.0), (1, 2.99))))
    words = starts.describe(rounds)
    assert (
        "remained: the values of the others were 0.75 % lower to 0.5 % higher at step 10" in words
    )
    assert "the value of the other was 0.33 % lower at step 20" in words and "starts=" not in words
    none = (Round(10, ((0, 0.0), (1, -1.0))),)
    assert "some starts had no value for a comparison" in starts.describe(none)


@pytest.mark.parametrize(
    "action, several",
    [
        (snapo.Choice(2), True),
        (snapo.Integers(0, 5), True),
        (snapo.Stop(), True),
        (snapo.Product(run=snapo.Choice(2), size=snapo.Box(0.0, 1.0)), True),
        (snapo.Box(0.0, 1.0), False),
        (snapo.Simplex(3), False),
    ],
)
def test_decisions_of_few_values_have_several_starts_where_nobody_chose(action, several):
    of = Problem(Press(action=action), {"one": snapo.Input(1.0)}, snapo.Mean("cash"))
    one = snapo.MLP().for_problem(of.interface, jax.random.key(0))

    def chosen(fresh=True, **given):
        return resolve_auto(Training(**given), of, one, fresh).starts

    assert chosen() == (4 if several else 1)
    assert chosen(starts=1) == 1 and chosen(starts=2) == 2
    # Weights of one's own, and a number of steps, are a choice.
    assert chosen(fresh=False) == chosen(steps=100) == 1


def test_a_short_training_is_validated_at_its_quarters():
    of = problem(Regulator)
    every = {
        steps: resolve_auto(Training(steps=steps), of, policy(of)).validation_every
        for steps in (1, 10, 60, 200, 240, 3840)
    }
    assert every == {1: 1, 10: 3, 60: 15, 200: 50, 240: 50, 3840: 50}
    assert (
        resolve_auto(Training(steps=60, validation_every=50), of, policy(of)).validation_every == 50
    )


def test_a_race_tells_the_last_two_starts():
    begun = initial_progress(policy(problem(Regulator)), Training())
    assert begun.last_two is None
    rounds = (Round(10, ((2, 4.0), (0, 3.0), (1, 2.0))), Round(20, ((0, 6.0), (2, 5.5))))
    assert replace(begun, raced=rounds).last_two == (6.0, 5.5)


class Press(snapo.Simulator):
    """Earns what is pressed."""

    horizon: int = 2
    action: snapo.Box = snapo.Box(0.0, 1.0)
    noise_size: int = 1

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.arange(2.0)})

    def initial(self, constants, noise):
        return {"x": constants["one"]}

    def observe(self, constants, now, state):
        return jnp.stack([state["x"]])

    def step(self, constants, now, state, action, noise, smooth):
        return {"x": state["x"] + 0 * noise[0]}, {"cash": action[0]}


@pytest.mark.prove
def test_several_starts_leave_one_that_is_caught():
    """At a score of -200 the way to 1 has no slope in single precision; others begin at scores of
    that size, and half of them above zero."""
    of = Problem(Press(), {"one": snapo.Input(1.0)}, snapo.Mean("cash"))
    made = snapo.MLP(hidden=()).for_problem(of.interface, jax.random.key(0))
    caught = eqx.tree_at(lambda each: each.network.weights[0], made, jnp.full((1, 1), -200.0))
    plan = Training(steps=20, paths=8, validation_paths=8, validation_every=10)
    alone, several = (
        snapo.solve(of, policy=caught, training=replace(plan, starts=n), evaluation=SMALL)
        for n in (1, 4)
    )
    assert alone.value < 1e-9 and several.value > 1.99
    assert "Of 4 starts" in " ".join(several.notes)


@pytest.mark.prove
def test_solve_runs_several_starts_and_says_which_one_went_on():
    """The last one's training is that of one start: as many steps, from its own weights."""
    of = problem(Regulator)
    plan = Training(steps=20, paths=32, validation_paths=128, starts=3)
    kind = snapo.MLP(hidden=(8,))
    solution = snapo.solve(of, policy=kind, training=plan, evaluation=SMALL, engine="xla")
    assert "Of 3 starts, of which the worse half was dropped every 2 steps" in " ".join(
        solution.notes
    )
    assert len(solution.history) == 20
    made = kind.for_problem(of.interface, jax.random.key(0))
    given = snapo.solve(of, policy=made, training=plan, evaluation=SMALL, engine="xla")
    assert "Of 3 starts" in " ".join(given.notes)
