"""The decision of the first step, at which a policy with a memory remembers nothing yet."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.problem.policies.memory import Memory
from snapo.problem.policy import Policy
from snapo.problem.smooth import Exact


def first_decision(policy: Policy, seen: Float[Array, " features"]) -> Float[Array, " size"]:
    """The exact decision at an observation of the first step."""
    if isinstance(policy, Memory):
        return policy.decide(seen, jnp.zeros(policy.memory, seen.dtype), Exact())[0]
    return policy(seen, Exact())
