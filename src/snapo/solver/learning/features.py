"""Features that hardly vary are spread, so that a network can tell states apart from the start.

A feature that stays near one number is, to an untrained network, a constant: training first finds
the best decision that ignores it, and saturates there. So the first layer of a network that
nobody has made yet is drawn for features of mean zero and deviation one, as they vary over time
and paths under the untrained policy. Features that vary by more than one are left as they are:
under an untrained policy an unstable plant runs away.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from snapo.engine import Engine
from snapo.problem.policy import MLP, Policy, Residual
from snapo.problem.problem import Problem
from snapo.problem.smooth import Smooth

from ..windows.critic import observations

PATHS = 64
MOST = 20.0  # times that a feature is spread, at most


def spread(policy: Policy, problem: Problem, engine: Engine, temperature: float) -> Policy:
    """The untrained policy with the first layer of its network drawn for features as they are.

    A policy that is no `MLP` or `Residual` is left as it is (one with a memory has its own scale).
    """
    if not isinstance(policy, MLP | Residual) or policy.network is None:
        return policy
    draws = problem.sources.training.batch(0, PATHS, problem.simulator)
    smooth = Smooth(np.float32(temperature))
    rolled = engine.bind(problem).values(policy, draws, smooth, record=("state",))
    schedule, horizon = problem.schedule, problem.simulator.horizon
    states = rolled.record["state"]
    found = np.asarray(observations(problem.simulator, schedule.constants, schedule.steps, states))
    rows = found.reshape(horizon * found.shape[1], -1)
    rows = rows[np.isfinite(rows).all(1)]
    if not len(rows):
        return policy
    mean, deviation = rows.mean(0), rows.std(0)
    varies = deviation > 1e-6 * np.maximum(1.0, np.abs(mean))
    factor = np.where(varies, np.clip(1 / np.maximum(deviation, 1e-9), 1.0, MOST), 1.0)
    shift = np.where(varies & (deviation < 1), mean, 0.0)
    first = policy.network.weights[0] * jnp.asarray(factor, jnp.float32)
    bias = policy.network.biases[0] - first @ jnp.asarray(shift, jnp.float32)

    def layer(tree):
        return tree.network.weights[0], tree.network.biases[0]

    return eqx.tree_at(layer, policy, (first, bias))
