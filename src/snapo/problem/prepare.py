"""From inputs to the schedule, in float64: done once per problem, before anything per path."""

from collections.abc import Hashable

import jax
import numpy as np
from jaxtyping import PyTree

from . import inputs as inputs_
from .code.version import of_preparation, of_rollout, read_context
from .quickly import compiled_sooner
from .simulator import Schedule, Simulator


def prepare(simulator: Simulator, inputs: PyTree) -> Schedule:
    """The schedule in float64 NumPy."""
    with jax.enable_x64(True), read_context(of_preparation(simulator, inputs)):
        part, completed = simulator.prepared_apart()
        schedule = _prepare(part, inputs_.plain(inputs))
        return jax.tree.map(np.asarray, completed(schedule))


def all_versions(simulator: Simulator, inputs: PyTree) -> Hashable:
    """The versions of all of a simulator's code; one of its own where it cannot be run."""
    try:
        schedule = prepare(simulator, inputs)
        versions = of_preparation(simulator, inputs), of_rollout(simulator, None, schedule)
    except Exception:  # who runs it says why
        return object()
    return None if versions == (None, None) else versions


@compiled_sooner
def _prepare(simulator: Simulator, plain: PyTree):
    return simulator.prepare(plain)
