"""From derivatives at the schedule back to the inputs: the end of every adjoint's road."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.problem import inputs as inputs_
from snapo.problem.simulator import Simulator


def pull_back(
    simulator: Simulator, inputs: PyTree, schedules: list[PyTree]
) -> dict[str, np.ndarray]:
    """Carries derivatives at the schedule on to the inputs: {name: [len(schedules), *shape]}.

    The transpose of `prepare`.
    """
    with jax.enable_x64(True):
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves).astype(np.float64), *schedules)
        moved = _pull_back(simulator, inputs, inputs_.values(inputs), stacked)
        return {entry.name: np.asarray(leaf) for entry, leaf in zip(inputs_.named(inputs), moved)}


@eqx.filter_jit
def _pull_back(simulator: Simulator, inputs: PyTree, values: list, cotangents: PyTree):
    def schedule(values):
        # Plain numbers beside the inputs are arrays in a prepared schedule, and so here.
        made = jax.tree.map(jnp.asarray, simulator.prepare(inputs_.replace(inputs, values)))
        return eqx.filter(made, eqx.is_inexact_array)

    made, pull = jax.vjp(schedule, values)

    def carry(cotangent):
        # A leaf that the author made in float32 takes its cotangent in float32.
        return pull(jax.tree.map(lambda c, leaf: c.astype(leaf.dtype), cotangent, made))[0]

    return jax.vmap(carry)(cotangents)
