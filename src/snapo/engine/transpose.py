"""Derivatives with respect to the inputs, from the derivatives with respect to the schedule."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.lanes.machine.threads import cores, in_thread
from snapo.problem import inputs as inputs_
from snapo.problem.code.version import of_preparation, read_context
from snapo.problem.quickly import compiled_sooner
from snapo.problem.simulator import Simulator

MAX_THREADS = 8  # each needs the memory of one transpose
LARGE = 2**20  # numbers of a leaf, whose zeros as a cotangent are made where they are used


def pull_back(
    simulator: Simulator, inputs: PyTree, schedules: list[PyTree]
) -> dict[str, np.ndarray]:
    """Transforms derivatives from the schedule to the inputs: {name: [len(schedules), *shape]}.
    This is the transpose of `prepare`.
    """
    values, version = inputs_.values(inputs), of_preparation(simulator, inputs)
    bare = inputs_.unnamed(inputs)

    def one(schedule: PyTree) -> PyTree:
        # Both are each thread's own.
        with jax.enable_x64(True), read_context(version):
            cotangent = jax.tree.map(_without_zeros, schedule)
            return jax.tree.map(np.asarray, _pull_back(simulator, bare, values, cotangent))

    # One by one: all at once would be compiled for every number of them, in far more time than the
    # calls take. The first compiles; the others share the processors.
    moved = [one(item) for item in schedules[:1]]
    if len(schedules) > 1:
        with ThreadPoolExecutor(min(MAX_THREADS, cores())) as threads:
            moved += threads.map(one, schedules[1:])
    names = [entry.name for entry in inputs_.named_inputs(inputs)]
    return {name: np.stack(leaves) for name, leaves in zip(names, zip(*moved))}


def compiled_meanwhile(
    simulator: Simulator, inputs: PyTree, schedule: PyTree
) -> AbstractContextManager[None]:
    """Compiles the transpose for a schedule like this one while the block runs.

    A failure is ignored here: `pull_back` reports it.
    """
    nothing = jax.tree.map(_zeros, eqx.filter(schedule, eqx.is_inexact_array))
    return in_thread(lambda: pull_back(simulator, inputs, [nothing]))


def _zeros(leaf) -> np.ndarray:
    """Zeros like a leaf; for a large leaf a single zero, broadcast to its shape."""
    large = np.size(leaf) > LARGE
    return np.broadcast_to(np.zeros(()), np.shape(leaf)) if large else np.zeros(np.shape(leaf))


def _without_zeros(leaf) -> np.ndarray | None:
    """A cotangent in float64; None for a large one that is a single zero."""
    array = np.asarray(leaf)
    if array.size > LARGE and not any(array.strides) and not array.flat[0]:
        return None
    return np.asarray(array, np.float64)


@compiled_sooner
def _pull_back(simulator: Simulator, inputs: PyTree, values: list, cotangent: PyTree):
    def schedule(values):
        # Plain numbers next to the inputs are arrays in a prepared schedule, and so here.
        made = jax.tree.map(jnp.asarray, simulator.prepare(inputs_.replace(inputs, values)))
        return eqx.filter(made, eqx.is_inexact_array)

    made, pull = jax.vjp(schedule, values)

    # A leaf that the author made in float32 takes its cotangent in float32.
    def of(leaf, value):
        return jnp.zeros_like(leaf) if value is None else value.astype(leaf.dtype)

    leaves, tree = jax.tree.flatten(made)
    return pull(jax.tree.unflatten(tree, map(of, leaves, tree.flatten_up_to(cotangent))))[0]
