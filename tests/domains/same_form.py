"""The programs of a problem as text, constants included, for the guard of forms."""

import jax
import jax.numpy as jnp

from snapo.problem.code.version import path, text
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
            {name: given.value for name, given in problem.inputs_by_name.items()},
        )
        sizes = simulator.initial_noise_size, simulator.noise_size, simulator.action.size
        now = jax.tree.map(lambda leaf: jnp.asarray(leaf)[0], schedule.steps)
        constants = jax.tree.map(jnp.asarray, schedule.constants)
        vectors = [jnp.zeros(size) for size in sizes]
        return prepared, text(rolled, leaves, constants, now, *vectors)
