"""The critic: a network that tells the worth of all outputs that come after a state.

It learns by least squares from whole paths of the present policy, so that it is right on average
whatever the window; its derivative is the worth of a change of the state.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PyTree

from snapo.engine import Rollout
from snapo.problem.code.version import of_rollout, read_context
from snapo.problem.objective import Objective
from snapo.problem.policy import Network
from snapo.problem.problem import Problem
from snapo.problem.simulator import Schedule, Simulator

from ..adjoint import flat_weights, float64

HIDDEN, RATE = (64, 64), 3e-3  # of the critic
FIRST_FITS, FITS, SAMPLE = 300, 4, 2048  # regression steps at the start and later; samples of each
_ADAM = optax.adam(RATE)


class Critic(eqx.Module):
    """The worth of all outputs from here on, in the units of the objective."""

    network: Network
    shift: Float[Array, ""]
    scale: Float[Array, ""]

    @property
    def features(self) -> int:
        """The length of an observation."""
        return self.network.weights[0].shape[1] - 1

    def __call__(self, observed: Float[Array, " features"], left: Float[Array, ""]):
        return self.shift + self.scale * self.network(jnp.append(observed, left))[0]


class Learner(NamedTuple):
    """The critic and the state of its regression."""

    critic: Critic
    optimiser: PyTree


def has_worth_ahead(problem: Problem) -> bool:
    """Whether the objective is a mean of sums, what lies ahead of a state having a worth."""
    objective, kinds = problem.objective, problem.simulator.totals()
    return objective.linear and all(kinds.get(n, "sum") == "sum" for n in objective.outputs)


def learner(problem: Problem, seed: int) -> Learner:
    """A critic that knows nothing yet.

    **Raises:** `ValueError` where the objective is no mean of sums, which alone has a worth ahead.
    """
    if not has_worth_ahead(problem):
        objective = problem.objective
        raise ValueError(
            "Training: window needs an objective that is a mean of outputs summed over the path; "
            f"{type(objective).__name__} of {', '.join(objective.outputs)} has no worth ahead."
        )
    return blank(problem.features, seed)


def blank(features: int, seed: int = 0) -> Learner:
    """A critic of observations with so many features, whose weights are the first ones."""
    key = jax.random.fold_in(jax.random.key(seed), 1)  # the policy's weights have the key itself
    network = Network((features + 1, *HIDDEN, 1), key=key, activation=jnp.tanh)
    critic = Critic(network, jnp.zeros(()), jnp.zeros(()))
    return Learner(critic, _ADAM.init(eqx.filter(network, eqx.is_inexact_array)))


def continuation_value(objective: Objective, rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """The worth of all outputs from each step on, [T, N], and which paths [N] are finite."""
    totals = float64(rollout.totals)
    paths = next(iter(totals.values())).size
    value = np.zeros((len(jax.tree.leaves(rollout.record["state"])[0]), paths))
    for name, weight in flat_weights(objective, paths).items():
        # An output of `terminal` alone lies ahead of every step.
        earned = float64(rollout.record["outputs"]).get(name, np.zeros(()))
        with np.errstate(invalid="ignore"):  # a path that exploded is left out below
            before = np.cumsum(earned, axis=0) - earned if earned.ndim else earned
            value += paths * weight * (totals[name] - before)
    return value, np.asarray(np.isfinite(value).all(0))


def fitted_critic(
    problem: Problem, available: Learner, states, value, valid, firsts, length: int, step: int
) -> Learner:
    """The critic after some steps of regression on states at the ends of windows."""
    endpoints = np.unique(firsts[firsts + length < problem.simulator.horizon] + length)
    if not endpoints.size or not valid.any():
        return available
    target = value[endpoints][:, valid]
    critic = available.critic
    if not float(critic.scale):
        spread = max(float(target.std()), 1e-12)
        scale = (jnp.asarray(x, jnp.float32) for x in (target.mean(), spread))
        critic = Critic(critic.network, *scale)
    left = (problem.simulator.horizon - endpoints) / problem.simulator.horizon
    selected = jax.tree.map(lambda leaf: leaf[endpoints][:, valid], states)
    nows = jax.tree.map(lambda leaf: np.asarray(leaf)[endpoints], problem.schedule.steps)
    displayed = observations(problem.simulator, problem.schedule.constants, nows, selected)
    lefts = np.broadcast_to(left[:, None, None], (*target.shape, 1))
    x = np.concatenate([displayed, lefts], axis=2).reshape(target.size, -1)
    y = (target.reshape(-1) - float(critic.shift)) / float(critic.scale)
    rng = np.random.default_rng((step, 1))
    fits = FITS if step else FIRST_FITS
    rows = rng.integers(0, y.size, (fits, min(SAMPLE, y.size)))
    values = jnp.asarray(x[rows], jnp.float32), jnp.asarray(y[rows], jnp.float32)
    network, optimiser = _regress(critic.network, available.optimiser, *values)
    return Learner(Critic(network, critic.shift, critic.scale), optimiser)


def observations(simulator: Simulator, constants, nows, states) -> Array:
    """Observations [ends, paths, features]."""
    with read_context(of_rollout(simulator, None, Schedule(constants, nows))):
        return _observations(simulator, constants, nows, states)


@eqx.filter_jit
def _observations(simulator: Simulator, constants, nows, states) -> Array:

    def one(now, state):
        return simulator.observe(constants, now, state)

    return jax.vmap(jax.vmap(one, (None, 0)))(nows, states)


@eqx.filter_jit
def _regress(network: Network, state, x: Float[Array, "K n f"], y: Float[Array, "K n"]):
    """K steps of least squares."""

    def error(network, x, y):
        return jnp.mean((jax.vmap(network)(x)[:, 0] - y) ** 2)

    moving, fixed = eqx.partition(network, eqx.is_inexact_array)

    def fit(carry, sample):
        moving, state = carry
        slope = jax.grad(lambda moving: error(eqx.combine(moving, fixed), *sample))(moving)
        change, state = _ADAM.update(slope, state, moving)
        return (eqx.apply_updates(moving, change), state), None

    (moving, state), _ = jax.lax.scan(fit, (moving, state), (x, y))
    return eqx.combine(moving, fixed), state
