"""The programs of a problem as text, constants included, for the guard of forms."""

from collections.abc import Hashable, Iterable

import jax
import jax.numpy as jnp

from snapo.problem.code.version import path, text
from snapo.problem.inputs import plain
from snapo.problem.problem import Problem


def programs(problem: Problem):
    """Of `prepare`, and of one path's start, step and end."""
    with jax.enable_x64(True):
        simulator, schedule = problem.simulator, problem.schedule
        leaves, structure = jax.tree.flatten(simulator)

        def rolled(leaves, constants, now, *noise):
            own = jax.tree.unflatten(structure, leaves)
            return path(own, None)(constants, now, *noise)

        prepared = text(
            lambda leaves, values: jax.tree.unflatten(structure, leaves).prepare(values),
            leaves,
            plain(problem.inputs),
        )
        sizes = simulator.initial_noise_size, simulator.noise_size, simulator.action.size
        now = jax.tree.map(lambda leaf: jnp.asarray(leaf)[0], schedule.steps)
        constants = jax.tree.map(jnp.asarray, schedule.constants)
        vectors = [jnp.zeros(size) for size in sizes]
        return prepared, text(rolled, leaves, constants, now, *vectors)


def same_programs(problems: Iterable[Problem], enough: int) -> int:
    """How many pairs of problems have one form, up to `enough`; all of them are one program."""
    known: dict[Hashable, list[Problem]] = {}
    pairs = 0
    for problem in problems:
        others = known.setdefault(problem.form, [])
        if others:
            assert programs(problem) == programs(others[-1])
            pairs += 1
        others.append(problem)
        if pairs >= enough:
            break
    return pairs
