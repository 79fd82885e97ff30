"""What `solve` asks of a simulator before anything compiles: all that `check` sees by tracing."""

import random
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.checker.check import check, simulator_mistakes
from snapo.problem.simulator import Schedule, Simulator

INPUTS = {"rate": snapo.Input(0.5)}
TINY = {
    "training": snapo.Training(steps=1, paths=8),
    "evaluation": snapo.Evaluation(paths=8, sensitivity_paths=0, smooth_paths=0, judge_paths=0),
}


class Plain(Simulator):
    """A state that stays, and what `moved` makes of it."""

    horizon: int = 3
    action: snapo.Box = snapo.Box(0.0, 1.0)
    noise_size: int = 2

    def prepare(self, inputs):
        return Schedule({"rate": inputs["rate"]}, {})

    def initial(self, constants, noise):
        return jnp.ones(())

    def observe(self, constants, now, state):
        return state[None]

    def step(self, constants, now, state, action, noise, smooth):
        return state, {"cash": action[0] * self.moved(constants["rate"] * state, noise, smooth)}

    def moved(self, x, noise, smooth):
        return x


class Normal(Plain):
    def moved(self, x, noise, smooth):
        return x + np.random.normal()


class Drawn(Plain):
    def moved(self, x, noise, smooth):
        return x + random.random()


def drawing(total, x):
    """The body of a loop, whose program JAX keeps."""
    return total + np.random.normal() * x, None


class InALoop(Plain):
    def moved(self, x, noise, smooth):
        return jax.lax.scan(drawing, x, noise)[0]


class Clock(Plain):
    def moved(self, x, noise, smooth):
        return x + time.perf_counter()


class OnlySmooth(Plain):
    def moved(self, x, noise, smooth):
        return x + (np.random.normal() if isinstance(smooth, snapo.Smooth) else 0.0)


class Seeded(Plain):
    """The same numbers every time."""

    def moved(self, x, noise, smooth):
        return x + np.random.default_rng(0).normal()


class While(Plain):
    def moved(self, x, noise, smooth):
        return jax.lax.while_loop(lambda v: v < 10.0, lambda v: v + 1.0, x)


class Traced(Plain):
    def moved(self, x, noise, smooth):
        return jax.lax.fori_loop(0, jnp.int32(x), lambda i, v: v + 1.0, x)


class Counted(Plain):
    """A loop over whole numbers, which no derivative meets."""

    def moved(self, x, noise, smooth):
        return x + jax.lax.while_loop(lambda v: v < 10, lambda v: v + 1, jnp.int32(x))


class Rounds(Plain):
    def moved(self, x, noise, smooth):
        return jax.lax.fori_loop(0, 3, lambda i, v: v + 1.0, x)


class Floor(Plain):
    def moved(self, x, noise, smooth):
        return jnp.floor(4.0 * x * snapo.noise.uniform(noise[0]))


PLACE = 0


def body(total, x):
    """JAX keeps its program by the function."""
    return total + jnp.arange(3.0)[PLACE] * x, None


class Placed(Plain):
    def moved(self, x, noise, smooth):
        return jax.lax.scan(body, x, noise)[0]


class Dictionary(Plain):
    def observe(self, constants, now, state):
        return {"x": state}


class Scalar(Plain):
    def observe(self, constants, now, state):
        return state


class ShortSlice(Plain):
    def moved(self, x, noise, smooth):
        return x + jnp.sum(noise[0:5])


def refused(kind, **more):
    with pytest.raises(ValueError) as error:
        snapo.solve(kind(), INPUTS, **TINY, **more)
    return str(error.value)


@pytest.mark.parametrize("kind", [Normal, Drawn, InALoop, Clock, OnlySmooth])
def test_numbers_drawn_in_python_are_refused(kind):
    text = refused(kind)
    assert "error: step" in text and "Two calls with the same arguments differ" in text
    assert "Use the noise argument of step" in text


@pytest.mark.parametrize("kind", [While, Traced])
def test_a_loop_that_nothing_passes_backwards_is_refused_by_its_line(kind):
    text = refused(kind)
    assert "error: step, " in text and "test_first.py:" in text
    assert f"In: return jax.lax.{'while_loop' if kind is While else 'fori_loop'}" in text
    assert "jax.lax.scan with a fixed number of iterations" in text
    assert "jax.lax.while_loop" in str(check(kind(), INPUTS))


@pytest.mark.parametrize("kind", [Plain, Seeded, Counted, Rounds])
def test_what_is_right_has_no_finding(kind):
    assert not len(simulator_mistakes(kind(), INPUTS)), str(simulator_mistakes(kind(), INPUTS))


@pytest.mark.prove
def test_a_lost_derivative_is_named_with_its_line():
    for findings in (simulator_mistakes(Floor(), INPUTS), check(Floor(), INPUTS)):
        found = [each for each in findings.warnings if "Its derivative is lost" in each.subject]
        assert len(found) == 1 and not findings.errors
        assert found[0].where.startswith("input rate (") and "test_first.py:" in found[0].where
        assert "In: return jnp.floor(4.0 * x * snapo.noise.uniform(noise[0]))" in found[0].subject


@pytest.mark.prove
def test_no_adjoint_derivative_of_a_lost_one_is_shown():
    """No adjoint sees through the rounding: a bump of the exact simulator is reported, not 0 ± 0."""
    settings = snapo.Evaluation(paths=4096, sensitivity_paths=4096, smooth_paths=64, search_paths=0)
    inputs = {"rate": snapo.Input(0.6)}  # at 0.5 floor(4 x u) has a corner: u is below one
    solution = snapo.solve(Floor(), inputs, training=TINY["training"], evaluation=settings)
    assert solution.sensitivities is not None
    (row,) = solution.sensitivities.rows()
    assert row.source == "through the policy" and np.isnan([row.held, row.smooth]).all()
    assert row.low < row.value < row.high
    assert [note for note in solution.notes if "Its derivative is lost" in note]


def test_a_global_that_changed_is_checked_as_it_is_now(monkeypatch):
    assert not len(simulator_mistakes(Placed(), INPUTS))
    monkeypatch.setitem(globals(), "PLACE", 7)
    for found in (simulator_mistakes(Placed(), INPUTS), check(Placed(), INPUTS)):
        assert "The array has 3 entries" in str(found), str(found)
    monkeypatch.undo()
    assert not len(simulator_mistakes(Placed(), INPUTS))


@pytest.mark.parametrize("kind", [Dictionary, Scalar])
def test_an_observation_that_is_no_vector_is_refused(kind):
    text = refused(kind)
    assert text.count("error:") == 1 and "error: observe" in text
    assert "Return one vector of floating numbers: jnp.stack([…])." in text


def test_an_init_that_sets_what_is_no_field_says_what_is_missing():
    class Sets(Plain):
        def __init__(self):
            self.rate = 0.5

    with pytest.raises(TypeError, match="__init__ sets 'rate', which is not a field"):
        Sets()

    class Declared(Plain):
        rate: float = 0.0

        def __init__(self):
            self.rate = 0.5

    assert Declared().rate == 0.5


@pytest.mark.prove
def test_warnings_are_notes_of_the_solution():
    solution = snapo.solve(ShortSlice(), INPUTS, **TINY)
    (note,) = [each for each in solution.notes if "slice" in each]
    assert note.startswith("step, ") and "[0:5] is taken from an array of 2 entries" in note
    other = snapo.solve(ShortSlice(), INPUTS, **TINY, check=False)
    assert not [each for each in other.notes if "slice" in each]
