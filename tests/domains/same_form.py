"""For guards of forms: the programs of problems as text, constants included, and their solving."""

from collections.abc import Callable, Hashable, Iterable
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import pytest

from snapo.problem.code.version import path, text
from snapo.problem.inputs import plain
from snapo.problem.problem import Problem

Shape = jax.ShapeDtypeStruct
# How many pairs are compared: thirty find a form that leaves a rule out of it; the study takes all.
PAIRS = pytest.mark.parametrize(
    "enough",
    [pytest.param(30, marks=pytest.mark.prove), pytest.param(200, marks=pytest.mark.study)],
)


def programs(problem: Problem):
    """Of `prepare`, and of one path's start, step and end: traced, and nothing is compiled."""
    with jax.enable_x64(True):
        simulator = problem.simulator
        leaves, structure = jax.tree.flatten(simulator)
        rest, on_step = jax.tree.flatten(simulator.on_paths().on_step())

        def rolled(leaves, constants, now, *noise):
            own = jax.tree.unflatten(on_step, leaves)
            return path(own, None)(constants, now, *noise)

        def schedule(leaves, values):
            return jax.tree.unflatten(structure, leaves).prepare(values)

        numbers = leaves, plain(problem.inputs)
        prepared = text(schedule, *numbers)
        shapes = jax.eval_shape(schedule, *numbers)
        constants = jax.tree.map(lambda leaf: Shape(leaf.shape, leaf.dtype), shapes.constants)
        now = jax.tree.map(lambda leaf: Shape(leaf.shape[1:], leaf.dtype), shapes.steps)
        sizes = simulator.initial_noise_size, simulator.noise_size, simulator.action.size
        vectors = [jnp.zeros(size) for size in sizes]
        return prepared, text(rolled, rest, constants, now, *vectors)


def same_programs(problems: Iterable[Problem], enough: int) -> int:
    """How many problems have the form of an earlier one, up to `enough`; each is its program."""
    first: dict[Hashable, Callable[[], Any]] = {}
    pairs = 0
    for problem in problems:
        program = cache(partial(programs, problem))
        earlier = first.setdefault(problem.form, program)
        if earlier is not program:
            assert program() == earlier()
            pairs += 1
        if pairs >= enough:
            break
    return pairs
