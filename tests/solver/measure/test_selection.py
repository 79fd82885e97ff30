"""The final choice: an exact rule is kept, a better one replaces a worse one, on fresh paths."""

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.engine import Xla
from snapo.solver.evaluate import path_totals
from snapo.solver.measure import selection
from snapo.solver.measure.selection import HIGHEST, NEWEST, PLAIN, START, TOP, fresh, select
from snapo.solver.statistics import mean

V, W = 2.0, 1.0
ENGINE = Xla("float64")


class Signal(snapo.Simulator):
    """x ~ N(0, v) is seen through noise of variance w; the cost is (x - action)^2."""

    horizon: int = 1
    noise_size: int = 0
    initial_noise_size: int = 2
    action: snapo.Box = snapo.Box(-np.inf, np.inf)

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.zeros(1)})

    def initial(self, constants, noise):
        hidden = jnp.sqrt(constants["v"]) * noise[0]
        return {"x": hidden, "seen": hidden + jnp.sqrt(constants["w"]) * noise[1]}

    def observe(self, constants, now, state):
        return state["seen"][None]

    def step(self, constants, now, state, action, noise, smooth):
        return state, {"reward": -((state["x"] - action[0]) ** 2)}


@pytest.fixture(scope="module")
def problem():
    inputs = {"v": snapo.Input(V), "w": snapo.Input(W)}
    return snapo.Problem(Signal(), inputs, snapo.Mean("reward"))


def rule(share: float):
    return snapo.Linear([[share]])


def test_a_better_policy_replaces_the_start_and_a_worse_one_does_not(problem):
    best, worse = rule(V / (V + W)), rule(0.4)
    found = select(problem, worse, {NEWEST: best, HIGHEST: rule(0.6)}, 16384, ENGINE)
    gain = (0.4 - V / (V + W)) ** 2 * (V + W)
    assert found.kind == NEWEST and found.policy is best
    assert abs(found.gain - gain) < 4 * found.error and found.error < gain / PLAIN
    assert (
        "Training gained" in found.description
        and "over the rule that it began with" in found.description
    )
    kept = select(problem, best, {NEWEST: worse}, 16384, ENGINE)
    assert kept.kind == START and kept.policy is best
    assert abs(kept.gain + gain) < 4 * kept.error
    assert "was kept: on fresh paths the trained policy is " in kept.description
    assert kept.description.endswith("below it.") and "-" not in kept.description


def test_a_history_that_begins_at_its_best_says_what_training_ended_at(problem):
    best, worse = rule(V / (V + W)), rule(0.4)
    kept = select(problem, best, {NEWEST: worse, HIGHEST: rule(V / (V + W))}, 16384, ENGINE)
    assert kept.kind == START
    loss = (0.4 - V / (V + W)) ** 2 * (V + W)
    assert abs(kept.gain + loss) < 4 * kept.error
    same = select(problem, best, {HIGHEST: rule(V / (V + W))}, 16384, ENGINE)
    assert same.kind == START and same.gain == 0.0


def test_a_candidate_that_is_not_surely_better_leaves_the_start(problem):
    near = {NEWEST: rule(V / (V + W) - 0.003)}
    found = select(problem, rule(V / (V + W) + 0.003), near, 4096, ENGINE)
    assert found.kind == START


def test_of_long_paths_a_candidate_that_is_plainly_below_is_valued_on_few(problem, monkeypatch):
    valued = []

    def counted(problem, policy, paths, **options):
        valued.append((policy, paths))
        return path_totals(problem, policy, paths, **options)

    monkeypatch.setattr(selection, "LONG", 0)
    monkeypatch.setattr(selection, "path_totals", counted)
    below, near = rule(0.0), rule(V / (V + W) + 0.003)
    found = select(problem, rule(V / (V + W)), {NEWEST: below, HIGHEST: near}, 4096, ENGINE)
    assert found.kind == START
    assert [paths for policy, paths in valued if policy is below] == [selection.FEWEST]
    assert max(paths for policy, paths in valued if policy is near) > selection.FEWEST


def test_the_search_is_made_where_something_may_be_gained(problem):
    best, searched = rule(V / (V + W)), []

    def top(share: float):
        return lambda: searched.append(share) or rule(share)

    best_share = V / (V + W)
    kept = select(problem, best, {NEWEST: rule(0.4)}, 4096, ENGINE, top(best_share))
    assert kept.kind == START and not searched and kept.search == (0.0, 0.0)
    # Where its gain is needed in any case, the choice is the same.
    same = select(problem, best, {NEWEST: rule(0.4)}, 4096, ENGINE, top(best_share), search=True)
    assert same._replace(search=kept.search) == kept and searched == [best_share]
    gain = (0.4 - best_share) ** 2 * (V + W)
    assert abs(same.search[0] - gain) < 4 * same.search[1]
    for search in (False, True):
        newest = {NEWEST: rule(0.6)}
        found = select(problem, rule(0.4), newest, 4096, ENGINE, top(best_share), search=search)
        assert found.kind == TOP and searched.pop() == best_share and found.search[0] > 0


def test_the_paths_of_the_choice_are_of_no_other_use(problem):
    source = fresh(problem.sources.validation)
    others = (problem.sources.validation, problem.sources.evaluation, problem.sources.training)
    assert all(source != other for other in others)


def solved(problem, start, seed: int):
    training = snapo.Training(
        steps=120, paths=64, learning_rate=0.05, seed=seed, validation_every=10,
        validation_paths=256,
    )  # fmt: skip
    alone = snapo.Evaluation(paths=16384, sensitivity_paths=0)
    return snapo.solve(problem, policy=start, training=training, evaluation=alone)


def worse_than(problem, policy, start) -> bool:
    """Whether a policy is below its start by more than two paired errors, on many other paths."""
    source = snapo.Pseudo(4711)
    own, other = (
        np.asarray(path_totals(problem, each, 131072, source=source)["reward"])
        for each in (policy, start)
    )
    difference = mean(own - other, source.groups(np.arange(131072)))
    return difference.value < -2 * difference.standard_error


@pytest.mark.prove
def test_an_exact_rule_is_not_given_away(problem):
    """Training can only make it worse; the highest of thirteen noisy values is not it."""
    start = rule(V / (V + W))
    solution = solved(problem, start, 0)
    assert solution.selected == START and solution.convergence == "start kept"
    assert any("The starting rule was kept" in note for note in solution.notes)


@pytest.mark.prove
def test_a_trained_network_is_not_a_network_drawn_at_random(problem):
    """It begins as it ended, whether it is trained further or only valued."""
    first = solved(problem, None, 0)
    assert first.selected != START
    none = snapo.Training(steps=0, paths=64, validation_paths=256)
    few = snapo.Evaluation(paths=4096, sensitivity_paths=0)
    for policy in (first, first.policy):
        again = snapo.solve(problem, policy=policy, training=none, evaluation=few)
        assert again.convergence == "start kept"
        assert not any("drawn at random" in note for note in again.notes)
    drawn = snapo.solve(problem, training=none, evaluation=few)
    assert drawn.convergence == "barely moved"
    assert any("drawn at random" in note for note in drawn.notes)


@pytest.mark.prove
def test_exact_rules_are_kept_with_ten_seeds(problem):
    start = rule(V / (V + W))
    assert sum(worse_than(problem, solved(problem, start, s).policy, start) for s in range(10)) <= 1


@pytest.mark.parametrize("scenarios", [snapo.Pseudo(3), snapo.Sobol(3)])
def test_totals_on_the_first_paths_are_not_rolled_again(problem, scenarios):
    policy, name = rule(0.6), "reward"
    options = {"engine": ENGINE, "source": scenarios}
    few = path_totals(problem, policy, 128, **options)
    marked = {name: np.where(np.arange(128) < 2, 7.0, few[name])}
    whole, later = (path_totals(problem, policy, 512, before=x, **options) for x in (few, marked))
    np.testing.assert_array_equal(whole[name], path_totals(problem, policy, 512, **options)[name])
    np.testing.assert_array_equal(later[name], np.r_[7.0, 7.0, whole[name][2:]])
