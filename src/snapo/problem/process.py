"""Exogenous dynamics: prices, weather, demand, which no decision of a simulator affects.

A `Process` describes ONE path in plain `jax.numpy`, like a simulator, but without decisions. A
simulator holds one, so that the same price serves a gas store, a battery and a swing contract:

    prepare:  prices = self.price.prepare(inputs.price)          # constants and per-step arrays
    initial:  state = self.price.initial(constants.price, noise)
    observe:  self.price.observe(constants.price, now.price, state.price)
    step:     spot = self.price.level(constants.price, now.price, state.price)
              after = self.price.step(constants.price, now.price, state.price, noise)
"""

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .record import AbstractVar, Input, Schedule, TreeRecord, field
from .record.arrays import Array, Float, Int, PyTree, jnp

State = PyTree


class Process(TreeRecord):
    """One path of an exogenous process. Subclass it and implement every method.

    **Attributes:**

    - `noise_size`: standard normals per step; `initial_noise_size`: those that `initial` uses.
    - `martingale`: whether the expectation of `level` is `forward` exactly, under every policy.
      Then the sum of any weights fixed in advance times `innovation` is a control variate.
    """

    noise_size: AbstractVar[int]
    martingale: AbstractVar[bool]

    @property
    def initial_noise_size(self) -> int:
        return 0

    @abc.abstractmethod
    def prepare(self, inputs: PyTree) -> Schedule:
        """Constants and per-step arrays from the inputs (plain arrays instead of `Input`)."""

    @abc.abstractmethod
    def initial(self, constants: PyTree, noise: Float[Array, " initial_noise"]) -> State:
        """The state at the first step."""

    @abc.abstractmethod
    def step(self, constants: PyTree, now: PyTree, state: State, noise) -> State:
        """The state one step later; `now` is the row of this step, `noise` has `noise_size`."""

    @abc.abstractmethod
    def level(self, constants: PyTree, now: PyTree, state: State) -> Float[Array, "..."]:
        """The quantity on which decisions depend at this step: the spot price, in its unit."""

    @abc.abstractmethod
    def forward(self, constants: PyTree, now: PyTree) -> Float[Array, "..."]:
        """The expectation of this step's level today; exact for a `martingale`."""

    @abc.abstractmethod
    def observe(self, constants: PyTree, now: PyTree, state: State) -> Float[Array, " features"]:
        """The part of the state that a policy needs, in numbers of order one."""

    @abc.abstractmethod
    def describe(self) -> str:
        """One sentence for a report."""

    def weight(self, state: State) -> Float[Array, ""]:
        """The likelihood ratio of the path so far: the number 1, with the derivative of the log
        probability of draws without a pathwise derivative, such as regimes. A simulator multiplies
        every output by it."""
        return jnp.ones(())

    def in_mean(self) -> tuple[str, ...]:
        """Names of the inputs of the probabilities of such draws: their derivative is correct only
        in the mean of many paths."""
        return ()

    def innovation(self, constants: PyTree, now: PyTree, state: State) -> Float[Array, "..."]:
        """The level minus the forward price; its expectation is zero for a `martingale`."""
        return self.level(constants, now, state) - self.forward(constants, now)


class Factors(NamedTuple):
    """Numbers of a `FactorPrice` at its T times.

    - `forward` [T]: expected price, positive.
    - `mean_reversion` [F]: per unit of time, at least 0.
    - `loading` [T, F]: volatilities of the price at each time, per square root of a unit of time.
    - `correlation` [F, F]: correlations of the factors.
    """

    forward: Float[Array, " T"]
    mean_reversion: Float[Array, " F"]
    loading: Float[Array, "T F"]
    correlation: Float[Array, "F F"]


class FactorConstants(NamedTuple):
    """`first_shock` [F, F]: shock up to the first time; `size` [F]: typical size of a factor."""

    first_shock: Float[Array, "F F"]
    size: Float[Array, " F"]


class FactorStep(NamedTuple):
    """One time: forward price, loadings [F], variance of ln S, and the transition to the next."""

    forward: Array
    loading: Array
    variance: Array
    next_decay: Array
    next_shock: Array


class Gaps(TreeRecord):
    """The distinct intervals between successive times, the first of which begins today.

    - `length` [n]: the length of each interval; `none`: whether it is 0.
    - `which` [T]: index of the interval that ends at each time.
    """

    length: Float[np.ndarray, " n"]
    which: Int[np.ndarray, " T"]
    none: tuple[bool, ...] = field(static=True)

    @classmethod
    def of(cls, times: Sequence[float] | Array) -> "Gaps":
        """The intervals between rising times; times before today count as today."""
        gaps = np.diff(np.maximum(times, 0.0), prepend=0.0)
        _, first, which = np.unique(np.round(gaps, 12), return_index=True, return_inverse=True)
        length = gaps[first]
        return cls(length, which, tuple(item <= 0 for item in length.tolist()))

    def shocks(self, correlation, pair) -> list[Float[Array, "F F"]]:
        """The lower Cholesky factor of the covariance of each interval; 0 for an empty one."""
        return [
            jnp.zeros_like(pair) if none else jnp.linalg.cholesky(correlation * integral(pair, gap))
            for none, gap in zip(self.none, jnp.asarray(self.length))
        ]


class FactorPrice(Process):
    """A positive price around its forward curve, moved by correlated mean-reverting factors.

    S(t) = F(t) exp(sum_i s_i(t) f_i(t) - variance(t) / 2), df_i = -a_i f_i dt + dW_i, f_i = 0
    today, dW_i dW_j = rho_ij dt, so that E[S(t)] = F(t). Transitions are exact over any interval:
    Cov(f_i, f_j) = rho_ij (1 - exp(-(a_i + a_j) t)) / (a_i + a_j). The state is f [F]. A subclass
    defines which inputs contain the numbers of the factors.

    **Arguments:**

    - `times`: the times of the T steps, rising, counted from today in any unit (years, hours). At
      time 0 the price is the forward price.
    - `time_scale`: the time after which a factor's standard deviation counts as its typical size.
    """

    times: AbstractVar[Sequence[float] | Array]
    time_scale: AbstractVar[float]

    @abc.abstractmethod
    def parameters(self, inputs: PyTree) -> Factors:
        """The factors' numbers, from inputs with plain arrays."""

    @property
    def gaps(self) -> "Gaps":
        """The intervals between the times; a subclass with times as arguments stores them."""
        return Gaps.of(self.times)

    @property
    def martingale(self) -> bool:
        return True

    @property
    def initial_noise_size(self) -> int:
        return self.noise_size

    def prepare(self, inputs: PyTree) -> Schedule:
        return self.schedule(self.parameters(inputs))

    def schedule(self, p: Factors) -> Schedule:
        """Constants and steps of given numbers."""
        gaps = self.gaps
        pair = p.mean_reversion[:, None] + p.mean_reversion[None, :]
        shock = jnp.stack(gaps.shocks(p.correlation, pair))[gaps.which]
        decay = jnp.exp(-p.mean_reversion * gaps.length[gaps.which][:, None])
        variance = jnp.einsum("ti,tij,tj->t", p.loading, self.covariance(p), p.loading)
        # Nothing follows the last time: its row repeats the transition that led to it.
        after = np.minimum(np.arange(1, len(self.times) + 1), len(self.times) - 1)
        size = jnp.sqrt(jnp.diagonal(integral(pair, self.time_scale)))
        steps = FactorStep(p.forward, p.loading, variance, decay[after], shock[after])
        return Schedule(FactorConstants(shock[0], size), steps)

    def covariance(self, p: Factors) -> Float[Array, "T F F"]:
        """The covariance of the factors at each time."""
        pair = p.mean_reversion[:, None] + p.mean_reversion[None, :]
        return p.correlation * integral(pair, jnp.asarray(self.times)[:, None, None])

    def initial(self, constants, noise):
        return constants.first_shock @ noise

    def step(self, constants, now, state, noise):
        return now.next_decay * state + now.next_shock @ noise

    def level(self, constants, now, state):
        return now.forward * jnp.exp(jnp.sum(now.loading * state) - now.variance / 2)

    def forward(self, constants, now):
        return now.forward

    def observe(self, constants, now, state):
        return state / constants.size


class SchwartzInputs(TreeRecord):
    """The market of a `Schwartz` price: forward curve [T], volatility and mean reversion []."""

    forward: Input
    volatility: Input
    mean_reversion: Input


class Schwartz(FactorPrice):
    """One mean-reverting factor around a forward curve, with `SchwartzInputs`.

    Source: Schwartz (1997), "The stochastic behavior of commodity prices", model 1, fitted to the
    curve; the volatility of a forward price falls as exp(-a (T - t)).
    """

    times: tuple[float, ...] = field(static=True, converter=lambda x: tuple(map(float, x)))
    time_scale: float = field(static=True, default=1.0)
    noise_size: int = field(static=True, default=1)

    def parameters(self, inputs: Any) -> Factors:
        loading = jnp.broadcast_to(inputs.volatility, (len(self.times), 1))
        return Factors(inputs.forward, inputs.mean_reversion[None], loading, jnp.eye(1))

    def describe(self) -> str:
        return "One mean-reverting factor around the forward curve"


def integral(rate, time):
    """(1 - exp(-rate time)) / rate, which is `time` at rate 0; differentiable there."""
    x = rate * time
    small = jnp.abs(x) < 1e-5
    safe = jnp.where(small, 1.0, x)
    return time * jnp.where(small, 1 - x / 2 + x * x / 6, -jnp.expm1(-safe) / safe)
