"""Bumps of a problem whose simulator holds a table that was built from the inputs."""

import threading
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.engine import Xla
from snapo.problem.scenarios import Sources
from snapo.solver.derivatives.bump import WIDE, Reaction, _Bumper, reactions
from snapo.solver.derivatives.interval import one_percent
from snapo.solver.derivatives.rebuilt import LONG, on_line, problems_at, rebuilt_once
from snapo.solver.statistics import Estimate

ENGINE = Xla("float64")


class Follows(snapo.Simulator):
    """The cost is the squared distance of the action from the target; a table names the target."""

    table: jax.Array
    horizon: int = 1
    noise_size: int = 1
    action: snapo.Box = snapo.Box(-np.inf, np.inf)

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.zeros(1)})

    def initial(self, constants, noise):
        return jnp.asarray(0.0)

    def observe(self, constants, now, state):
        return self.table

    def step(self, constants, now, state, action, noise, smooth):
        far = action[0] - constants["target"] ** 2
        return state, {"reward": 5.0 - far**2 + 0.1 * noise[0]}


class Reads(snapo.Policy):
    """The action is the only feature."""

    def __call__(self, features, smooth):
        return features


def built(problem):
    target = problem.inputs_by_name["target"].value
    return replace(problem, simulator=replace(problem.simulator, table=np.array([target**2])))


def follows(rebuild=built):
    inputs = {"target": snapo.Input(2.0)}
    bare = snapo.Problem(
        Follows(np.zeros(1)), inputs, snapo.Mean("reward"), Sources.of(None, 0), rebuild=rebuild
    )
    return built(bare)


def test_what_was_built_for_more_of_an_input_is_mirrored_for_less():
    problem = follows()
    less = on_line(problem, problem.at_values({"target": 2.02}), {"target": 1.98}, -1.0)
    assert less.inputs_by_name["target"].value == 1.98
    np.testing.assert_allclose(less.simulator.table, 2 * 4.0 - 2.02**2, rtol=1e-15)
    np.testing.assert_allclose(less.simulator.table, 1.98**2, rtol=3e-4)


def test_what_was_built_in_another_form_is_not_mirrored():
    problem, more = follows(), follows().at_values({"target": 2.02})
    longer = replace(more, simulator=replace(more.simulator, table=np.zeros(2)))
    assert on_line(problem, longer, {"target": 1.98}, -1.0) is None
    whole = replace(more, simulator=replace(more.simulator, table=np.array([4])))
    counted = replace(problem, simulator=replace(problem.simulator, table=np.array([5])))
    assert on_line(counted, whole, {"target": 1.98}, -1.0) is None


def test_a_table_on_a_line_is_that_of_the_moves_to_first_order():
    problem = follows()
    more = problem.at_values({"target": 2.02})
    for share in (-3.0, 0.5, 3.0):
        value = 2.0 + 0.02 * share
        moved = on_line(problem, more, {"target": value}, share)
        assert moved.inputs_by_name["target"].value == value
        np.testing.assert_allclose(moved.simulator.table, 4.0 + share * (2.02**2 - 4.0), rtol=1e-14)
        np.testing.assert_allclose(moved.simulator.table, value**2, rtol=2e-3)


@pytest.mark.parametrize(("horizon", "count"), [(LONG, 3), (LONG + 1, 1)])
def test_a_table_of_a_long_problem_is_rebuilt_once_for_each_input(horizon, count):
    builds = []

    def counted(problem):
        builds.append(problem)
        return built(problem)

    problem = follows(counted)
    problem = replace(problem, simulator=replace(problem.simulator, horizon=horizon))
    assert rebuilt_once(problem) == (count == 1)
    at_values, moves = problems_at(problem), (0.01, -0.01, 0.03)
    for move in moves:
        moved = at_values({"target": 2.0 + move})
        np.testing.assert_allclose(moved.simulator.table, (2.0 + move) ** 2, rtol=1e-3)
    assert len(builds) == count


def test_a_move_in_another_direction_has_a_table_of_its_own():
    """An input of two numbers: a move of the second says nothing about one of the first."""
    start = np.array([2.0, 3.0])
    inputs, simulator = {"target": snapo.Input(start)}, Follows(np.zeros(1), horizon=LONG + 1)
    problem = snapo.Problem(
        simulator, inputs, snapo.Mean("reward"), Sources.of(None, 0), rebuild=built
    )
    at_values = problems_at(built(problem))
    for move in ([0.01, 0.0], [0.0, 0.01]):
        moved = at_values({"target": start + move})
        np.testing.assert_array_equal(moved.simulator.table, [(start + move) ** 2])


def test_a_table_that_is_built_anew_shows_no_reaction_of_an_optimal_policy():
    """The held derivative is 0, and so is the bump; a table that stands still costs (2 x h)^2."""
    builds = []

    def counted(problem):
        builds.append(problem)
        return built(problem)

    problem = follows(counted)
    held = snapo.sensitivities(problem, Reads(), paths=4096, engine=ENGINE).held
    found = reactions(problem, Reads(), 4096, held, rollouts=0, engine=ENGINE)["target"]
    assert abs(found.estimate[0]) < 1e-6
    assert len(builds) == 1


@pytest.mark.parametrize(("value", "moves"), [(5.0, [1.0]), (1e-8, [1.0, WIDE])])
def test_an_input_without_effect_on_the_value_gets_no_wider_move(monkeypatch, value, moves):
    """A rate of zero over a week: all of the change is far below the value's precision."""
    taken, noise = [], np.random.default_rng(0).standard_normal(32)

    def moved(self, name, by, held, count):
        taken.append(float(by[0]))
        return Reaction(held, 1e-10 * (2 + noise[:count]), 0.0, 0.0, 0.0, 1e-12, True)

    monkeypatch.setattr(_Bumper, "_moved", moved)
    bumper = object.__new__(_Bumper)
    bumper.blocks, bumper.value = [np.arange(4)] * 32, value
    screened = moved(bumper, "rate", np.zeros(1), np.full(32, 1e-7), 4)
    bumper.refined("rate", np.ones(1), screened)
    assert taken[1:] == moves


class FollowsBoth(Follows):
    def step(self, constants, now, state, action, noise, smooth):
        far = action[0] - constants["left"] ** 2 - constants["right"] ** 3
        return state, {"reward": 5.0 - far**2 + 0.1 * noise[0]}


def test_problems_rebuilt_in_a_thread_give_the_same_bits_as_one_after_the_other():
    threads = []

    def rebuilt(problem):
        threads.append(threading.current_thread().name)
        values = {name: item.value for name, item in problem.inputs_by_name.items()}
        table = np.array([values["left"] ** 2 + values["right"] ** 3])
        return replace(problem, simulator=replace(problem.simulator, table=table))

    inputs = {"left": snapo.Input(2.0), "right": snapo.Input(1.5), "unused": snapo.Input(1.0)}
    sources, mean = Sources.of(None, 0), snapo.Mean("reward")
    simulator = FollowsBoth(np.zeros(1))
    problem = rebuilt(snapo.Problem(simulator, inputs, mean, sources, rebuild=rebuilt))
    held = {name: Estimate(np.zeros(32)) for name in inputs}
    threads.clear()
    found = reactions(problem, Reads(), 256, held, rollouts=0, engine=ENGINE)
    assert list(found) == ["left", "right", "unused"]
    assert len(threads) == 2 and all(name.startswith("rebuild") for name in threads)
    bumper = _Bumper(problem, Reads(), 256, 32, None, None, ENGINE)
    for name in ("left", "right"):
        by = 0.01 * problem.inputs_by_name[name].value
        alone = bumper._moved(name, by, np.zeros(32), bumper.few, mirrored=True)
        np.testing.assert_array_equal(found[name].reaction, alone.reaction)


def test_a_failure_while_a_table_is_rebuilt_is_raised():
    def failing(problem):
        raise ArithmeticError("no table")

    problem = follows(failing)
    held = {"target": Estimate(np.zeros(32))}
    with pytest.raises(ArithmeticError, match="no table"):
        reactions(problem, Reads(), 256, held, rollouts=0, engine=ENGINE)


def test_an_input_may_state_its_bump():
    assert one_percent(snapo.Input([4.0, 5.0])).tolist() == [0.04, 0.05]
    assert one_percent(snapo.Input([4.0, 5.0], judge_bump=0.2)).tolist() == [0.2, 0.2]
