"""The course of paths: the same totals as the value, in both engines, and as a data frame."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest
from tests.problem.reservoir import Reservoir, inputs

import snapo
from snapo.engine import Native
from snapo.problem.scenarios import Pseudo
from snapo.solver.evaluate import chunks


@pytest.fixture(scope="module")
def played():
    problem = snapo.Problem(Reservoir(), inputs, snapo.Mean("cash"))
    return problem, snapo.MLP().for_problem(problem.interface, jax.random.key(0))


@pytest.mark.prove
def test_the_course_adds_up_to_the_value(played):
    course = snapo.simulate(*played, paths=64)
    assert course.outputs["cash"].sum(0) == pytest.approx(course.totals["cash"])
    assert course.totals["cash"].mean() == pytest.approx(snapo.evaluate(*played, paths=64).value)
    water, price = course.states["water"], course.states["price"]
    assert water.shape == (53, 64) and course.actions["action"].shape == (52, 64)
    assert np.all(water[0] == 60) and np.all(price[0] == 50)
    released = np.minimum(10 * course.actions["action"], water[:-1])
    assert course.outputs["cash"] == pytest.approx(price[:-1] * released)
    # What is not released and does not spill is there a week later, with the rain.
    assert np.all(water[1:] >= np.minimum(water[:-1] - released, 100) - 1e-9)


@pytest.mark.prove
def test_both_engines_have_the_same_course(played):
    one, other = (
        snapo.simulate(*played, paths=32),
        snapo.simulate(*played, paths=32, engine=Native("float64")),
    )
    for kind in snapo.Simulation._fields:
        mine, theirs = getattr(one, kind), getattr(other, kind)
        assert mine.keys() == theirs.keys()
        for name, values in mine.items():
            assert theirs[name] == pytest.approx(values, rel=1e-9), name


@pytest.mark.prove
def test_a_row_for_every_path_and_step(played):
    course = snapo.simulate(*played, paths=4, smooth=snapo.Smooth(0.1))
    table = course.frame()
    assert list(table.columns) == ["path", "step", "price", "water", "action", "cash"]
    assert len(table) == 4 * 52
    row = table[(table.path == 2) & (table.step == 7)].iloc[0]
    assert row.water == course.states["water"][7, 2] and row.cash == course.outputs["cash"][7, 2]
    with pytest.raises(ValueError, match="it must be one of"):
        course.frame("excel")


@pytest.mark.parametrize(("horizon", "most"), [(365, 8192), (8760, 1915), (10**6, 512)])
def test_the_noise_of_long_paths_is_drawn_in_smaller_parts(horizon, most):
    """A year by the hour: 16,384 paths took 0.6 GB for each of their calls."""
    simulator = SimpleNamespace(horizon=horizon, noise_size=1, initial_noise_size=0)
    parts = chunks(Pseudo(0), 16_384, simulator)  # pyright: ignore[reportArgumentType]
    assert len(parts) == -(-16_384 // most) and max(map(len, parts)) <= most
    assert np.array_equal(np.concatenate(parts), np.arange(16_384))
