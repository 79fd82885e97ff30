"""The derivative of an objective, or of a limit's measure, by all numbers of a policy."""

import jax
import numpy as np

from snapo.engine import BoundEngine
from snapo.problem.noise import Draws
from snapo.problem.objective import Objective
from snapo.problem.policy import Policy, trainable

from ..adjoint import weighted_adjoint


def slope_of(
    bound_engine: BoundEngine, policy: Policy, draws: Draws, smooth, objective: Objective
) -> np.ndarray:
    """In one row, in float64."""
    result = weighted_adjoint(bound_engine, policy, draws, smooth, objective, wrt=("policy",))[1]
    leaves = jax.tree.leaves(trainable(result.policy)[0])
    return np.concatenate([np.ravel(np.asarray(leaf, np.float64)) for leaf in leaves])
