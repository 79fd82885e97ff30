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
    given, moved = inputs_.values(inputs), []
    with jax.enable_x64(True):
        # One after another: all at once is compiled anew for every number of them, in far more
        # time than the calls take.
        for each in schedules:
            cotangent = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), each)
            moved.append(jax.tree.map(np.asarray, _pull_back(simulator, inputs, given, cotangent)))
    names = [entry.name for entry in inputs_.named(inputs)]
    return {name: np.stack(leaves) for name, leaves in zip(names, zip(*moved))}


@eqx.filter_jit
def _pull_back(simulator: Simulator, inputs: PyTree, values: list, cotangent: PyTree):
    def schedule(values):
        # Plain numbers beside the inputs are arrays in a prepared schedule, and so here.
        made = jax.tree.map(jnp.asarray, simulator.prepare(inputs_.replace(inputs, values)))
        return eqx.filter(made, eqx.is_inexact_array)

    made, pull = jax.vjp(schedule, values)
    # A leaf that the author made in float32 takes its cotangent in float32.
    return pull(jax.tree.map(lambda c, leaf: c.astype(leaf.dtype), cotangent, made))[0]
