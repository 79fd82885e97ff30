"""Steps and paths that nobody gave follow the horizon and the size of the policy."""

import json
import math
from dataclasses import asdict, replace

import jax
import pytest
from tests.solver.twelve import Regulator, policy, problem

import snapo
from snapo.problem.policy import widths
from snapo.problem.simulator import Interface
from snapo.solver.learning.settings import TrainingPlan, resolve_auto
from snapo.solver.train import Training


def numbers(horizon: int, hidden=(32, 32)) -> tuple[int, int]:
    of = problem(Regulator)
    of = replace(of, simulator=Regulator(horizon=horizon))
    made = snapo.MLP(hidden=hidden).for_problem(of.interface, jax.random.key(0))
    found = resolve_auto(Training(), of, made)
    return found.steps, found.paths


def test_a_short_horizon_has_more_steps_and_a_long_one_with_a_large_network_fewer_paths():
    assert numbers(12) == (3840, 512)
    assert numbers(100) == (960, 512)
    assert numbers(200) == (480, 512)
    steps, paths = numbers(365, (128, 128))
    assert steps > 240 and paths == 16


def test_the_rate_follows_the_steps_and_the_width_unless_one_of_them_is_given():
    of = problem(Regulator)
    made = snapo.MLP(hidden=(128, 128)).for_problem(of.interface, jax.random.key(0))
    narrow, wide = (resolve_auto(Training(), of, each) for each in (policy(of), made))
    # Half of the steps that a horizon of 20 has room for, 4,800, ten times 240.
    assert narrow.learning_rate == pytest.approx(0.01 * 10**0.5)
    noisy = (512 / wide.paths) ** 0.4
    assert wide.learning_rate == pytest.approx(0.01 * (0.5 * 10 * noisy) ** 0.5)
    assert resolve_auto(Training(steps=960), of, made).learning_rate == 0.01
    assert resolve_auto(Training(learning_rate=0.02), of, made).learning_rate == 0.02


def test_where_nothing_is_random_a_few_paths_do_in_as_many_steps():
    of = problem(Regulator)
    sure = replace(of, simulator=Regulator(noise_size=0, horizon=100))
    found = resolve_auto(Training(), sure, policy(of))
    assert (found.steps, found.paths) == (960, 64)
    # Decisions that explore make paths differ again.
    assert resolve_auto(Training(exploration=0.1), sure, policy(of)).paths == 512


def test_numbers_that_are_given_stay_and_the_rest_follows():
    of = problem(Regulator)
    assert Training().steps == Training().paths == "auto"
    found = resolve_auto(Training(steps=7), of, policy(of))
    assert found.steps == 7 and found.paths == 512
    assert set(found.automatic) == {
        "paths", "learning_rate", "decay", "exploration", "validation_every", "starts",
    }  # fmt: skip
    assert resolve_auto(found, of, policy(of)) == found
    assert Training(steps=0).steps == 0


def test_weights_decay_where_many_numbers_are_decided_unless_steps_or_decay_are_given():
    of = problem(Regulator)
    many, made = (
        replace(of, simulator=Regulator(action=snapo.Box(-math.inf, math.inf, 9))),
        policy(of),
    )
    found = resolve_auto(Training(), many, made)
    # The rate is half as large on average: a weight that nothing holds ends at a quarter.
    assert math.exp(-found.decay * found.learning_rate * found.steps / 2) == pytest.approx(0.25)
    assert resolve_auto(Training(), of, made).decay == 0
    assert resolve_auto(Training(steps=50), many, made).decay == 0
    assert resolve_auto(Training(steps=50, decay=0.3), many, made).decay == 0.3
    with pytest.raises(ValueError, match="decay is -1; it must be a number, 0 or more"):
        Training(decay=-1)


def test_decisions_explore_where_many_numbers_are_decided_unless_steps_or_a_share_are_given():
    of = problem(Regulator)
    made = policy(of)

    def share(training=Training(), action=snapo.Box(-1.0, 1.0, 9)):
        return resolve_auto(
            training, replace(of, simulator=Regulator(action=action)), made
        ).exploration

    assert share() == share(action=snapo.Integers(0, 4, 9)) == share(action=snapo.Simplex(9)) == 0.1
    assert resolve_auto(Training(), of, made).exploration == 0
    assert share(Training(steps=50)) == 0
    assert share(Training(steps=50, exploration=0.3)) == 0.3
    assert share(Training(exploration=0.0)) == 0


def test_none_explore_that_have_no_bounds_or_a_temperature_that_stays():
    of = problem(Regulator)
    unbounded = replace(of, simulator=Regulator(action=snapo.Box(-math.inf, math.inf, 9)))
    choices = replace(of, simulator=Regulator(action=snapo.Choice(9)))
    bounded = replace(of, simulator=Regulator(action=snapo.Box(-1.0, 1.0, 9)))
    for each in (unbounded, choices):
        assert resolve_auto(Training(), each, policy(of)).exploration == 0
    assert resolve_auto(Training(temperature_start=0.005), bounded, policy(of)).exploration == 0


def test_hidden_layers_grow_with_the_numbers_that_are_decided():
    assert (
        widths(snapo.Box(-math.inf, math.inf))
        == widths(snapo.Box(-math.inf, math.inf, 8))
        == (32, 32)
    )
    assert widths(snapo.Box(-math.inf, math.inf, 9)) == (64, 64)
    assert widths(snapo.Box(-math.inf, math.inf, 1000)) == (128, 128)


@pytest.mark.parametrize("count, hidden", [(1, 32), (12, 64), (40, 128)])
def test_so_do_the_networks_of_residuals_and_of_recurrent_policies(count, hidden):
    interface = Interface(snapo.Box(-math.inf, math.inf, count), 3)
    key = jax.random.key(0)
    residual = snapo.Residual(snapo.Constant()).for_problem(interface, key)
    recurrent = snapo.GRU().for_problem(interface, key)
    assert residual.hidden == (hidden, hidden) and residual.network.weights[1].shape[0] == hidden
    assert recurrent.memory == hidden // 2 and recurrent.for_problem(interface, key) is recurrent
    assert snapo.GRU(hidden=5).for_problem(interface, key).memory == 5
    assert snapo.GRU().memory == 0


def test_a_training_by_default_is_told_from_one_of_numbers():
    """It was equal to, hashed and was printed as one of numbers, and was trained differently."""
    plain, numbers = Training(), Training(learning_rate=0.01, decay=0.0, exploration=0.0)
    assert plain != numbers and hash(plain) != hash(numbers) and repr(plain) != repr(numbers)
    assert plain == Training() and hash(plain) == hash(Training())
    assert Training(paths=64) == Training(paths=64) != Training(paths=65)


@pytest.mark.parametrize(
    "training", [Training(), Training(steps=7), Training(learning_rate=0.02, clip=None, window=5)]
)
def test_a_training_that_was_written_as_json_is_the_same_training(training):
    """Of the default one the steps were 0: nothing was trained."""
    of = problem(Regulator)
    again = Training(**json.loads(json.dumps(asdict(training))))
    assert again == training
    plan = resolve_auto(training, of, policy(of))
    assert resolve_auto(again, of, policy(of)) == plan
    assert plan.steps == (3840 if training.steps == "auto" else training.steps)
    assert TrainingPlan(**json.loads(json.dumps(asdict(plan)))) == plan


def test_what_may_be_automatic_is_said():
    for name, value, words in (
        ("steps", -1, "a whole number of at least 0 or 'auto'"),
        ("steps", "many", "a whole number of at least 0 or 'auto'"),
        ("learning_rate", "high", "a number above 0 or 'auto'"),
        ("warmup", "auto", "a whole number of at least 0"),
        ("average", "auto", "a number above 0, at most 1"),
    ):
        with pytest.raises(ValueError) as error:
            Training(**{name: value})
        assert str(error.value) == f"Training: {name} is {value!r}; it must be {words}."
    with pytest.raises(
        ValueError, match="steps is 'auto'; it must be a whole number of at least 0"
    ):
        TrainingPlan(steps="auto")
