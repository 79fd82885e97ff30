"""The common part of all Gaussian factor prices; each kind says which parameters it has."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.problem.process import FactorPrice, Gaps
from snapo.problem.simulator import Schedule

from .process import GaussianFactors, PriceProcess, Times


class StorageStep(NamedTuple):
    """A row of the core's `FactorStep`, and the variance of ln S without the fast factor."""

    forward: Array
    loading: Array
    variance: Array
    next_decay: Array
    next_shock: Array
    slow_variance: Array


class FactorPrices(FactorPrice, PriceProcess):
    """Correlated mean-reverting factors around the forward curve; see the core's `FactorPrice`."""

    delivery: eqx.AbstractVar[Times]
    fast_factor: eqx.AbstractVar[int]  # which reverts fastest, among those that move prices
    proportional = True
    time_scale = 1.0

    @property
    def times(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.delivery.years

    @property
    def gaps(self) -> Gaps:
        return self.delivery.gaps

    def prepare(self, inputs) -> Schedule:
        numbers = self.parameters(inputs)
        rows = self.schedule(numbers)
        slow = numbers.loading * (np.arange(self.noise_size) != self.fast_factor)
        variance = jnp.einsum("ti,tij,tj->t", slow, self.covariance(numbers), slow)
        return Schedule(rows.constants, StorageStep(**rows.steps._asdict(), slow_variance=variance))

    def state_at(self, constants, now, spot):
        loading = now.loading[self.fast_factor]
        moved = jnp.log(spot / now.forward) + now.variance / 2
        moved = moved / jnp.where(loading > 0, loading, 1.0)
        state = jnp.zeros(self.noise_size)
        return state.at[self.fast_factor].set(jnp.where(loading > 0, moved, 0.0))

    def fast(self, state):
        return state[self.fast_factor]

    def gaussian(self, state):
        return state

    def slow_level(self, constants, now, state):
        slow = np.arange(self.noise_size) != self.fast_factor
        if not slow.any():
            return jnp.asarray(1.0)
        return jnp.exp(jnp.sum((now.loading * state)[slow]) - now.slow_variance / 2)

    def factors(self, schedule):
        steps, first = schedule.steps, schedule.constants.first_shock
        return GaussianFactors(
            steps.loading,
            steps.variance,
            np.concatenate([np.ones_like(steps.next_decay[:1]), steps.next_decay[:-1]]),
            np.concatenate([first[None], steps.next_shock[:-1]]),
            self.fast_factor,
        )
