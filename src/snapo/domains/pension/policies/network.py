"""The network of a pension fund: its weights lie within bounds and groups by construction."""

import jax
import jax.numpy as jnp

from snapo.problem.inputs import Frozen
from snapo.problem.policy import Network, Policy, as_observation
from snapo.problem.simulator import Schedule, Simulator, probe
from snapo.problem.smooth import EXACT

from ..records.case import PensionCase
from .limits import AllocationLimits, present


class PensionPolicy(Policy):
    """A network around the present holdings of the fund.

    **Arguments:**

    - `features`: size of the observation; `hidden`: widths of the layers between.
    """

    network: Network
    limits: AllocationLimits
    start: Frozen

    def __init__(self, case: PensionCase, features: int, *, key, hidden: tuple[int, ...]):
        start = present(case)
        widths = (features, *hidden, len(start))
        self.network = Network(widths, key=key, activation=jax.nn.tanh)
        self.limits, self.start = AllocationLimits(case), Frozen(start)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        start = jnp.asarray(self.start.array, observation.dtype)
        return self.limits(start + self.network(observation), smooth)


def new_policy(case: PensionCase, simulator: Simulator, schedule: Schedule, key) -> PensionPolicy:
    """The network of a case, untrained: it keeps about the present holdings."""
    features = probe(simulator, schedule)[1].shape[0]
    return PensionPolicy(case, features, key=key, hidden=case.hidden)
