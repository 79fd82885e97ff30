"""Features that no decision affects are standardised before training.

A feature that varies little around one number is a constant to an untrained network: training first
finds the best decision that ignores it, and saturates there. So the first layer of a network that
snapo creates is drawn, and trained, for features of mean 0 and deviation 1. That needs a mean and a
deviation that do not depend on decisions, as those of prices, demands and times. Features that
decisions affect are left unchanged: under an untrained policy their range differs from that under a
trained one.

This matters if many numbers are decided, each of which has to distinguish states: a battery that
decides 24 powers a day earns 95 % of its upper bound with scaling and 84 % without. With few
decisions, a regulator, a pendulum and a cart train well without scaling.

It also matters for optimal stopping. Stopping without regard to the state is worse than waiting, so
the first steps lower the hazard everywhere. If features are small, the hazard vanishes before the
network distinguishes states, and training never recovers: a max-call of five shares ended at its
European value, 23.10 instead of 26.14, with one seed of three, and at 26.14 with scaled features.

A policy with a memory sees past observations, or internal numbers: the former are scaled like the
present observation, the latter are left unchanged.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from snapo.engine import BoundEngine, Xla
from snapo.problem.actions import Stop, contains
from snapo.problem.functional import called
from snapo.problem.policies.memory import GRU, LastObservations
from snapo.problem.policy import MLP, Network, Policy, Residual
from snapo.problem.problem import Problem
from snapo.problem.simulator import Around, at
from snapo.problem.smooth import Exact

from .windows import observations

PATHS = 64
MANY = 8  # more decided numbers than these: the network is wider there too
VARIES = 1e-6  # of its size: a feature that varies less is a constant
MOVED = (-0.7, 0.3, 1.9)  # where numbers that a decision moves are set to see who follows them


class FeatureScale(NamedTuple):
    """Mean and deviation of every feature; 0 and 1 if a decision moves it. A network's first layer
    has weights for unscaled features. Training moves the equivalent weights for scaled features;
    `scaled` and `plain` convert one into the other. The same applies to all first layers of a
    policy that has several.
    """

    mean: tuple[float, ...]
    deviation: tuple[float, ...]

    def plain(self, policy: Policy) -> Policy:
        """The policy of unscaled features that decides as `policy` does with scaled ones."""
        return self._applied(policy, plain)

    def scaled(self, policy: Policy) -> Policy:
        """The inverse of `plain`."""
        return self._applied(policy, scaled)

    def slope(self, gradient: Policy) -> Policy:
        """The gradient with respect to the scaled numbers, from that with respect to the plain
        numbers."""
        return self._applied(gradient, slope)

    @classmethod
    def read(cls, stored) -> "FeatureScale | None":
        """The record from its plain data, as read from JSON."""
        return None if stored is None else cls(*map(tuple, stored))

    def _applied(self, policy: Policy, work: Callable[..., tuple[Any, Any]]) -> Policy:
        """The policy with other first layers: `work` takes weights, biases, mean and deviation."""
        columns = _columns(policy, self.mean, 0.0), _columns(policy, self.deviation, 1.0)
        moved = [number for layer in layers(policy) for number in work(*layer, *columns)]
        return eqx.tree_at(lambda tree: [x for item in layers(tree) for x in item], policy, moved)


def _columns(policy: Policy, features: tuple[float, ...], other: float) -> np.ndarray:
    """Numbers of the features for all that the first layers of a policy see."""
    memory: tuple[float, ...] = ()
    if isinstance(policy, LastObservations):  # each with the decision taken there
        memory = (policy.steps - 1) * (*features, *(policy.width - len(features)) * (other,))
    elif isinstance(policy, GRU):
        memory = policy.memory * (other,)
    return np.asarray((*features, *memory), np.float32)


def networks(policy: Policy) -> list[Network | None]:
    """The networks of a policy that read the features; None instead of each network that was not
    drawn at random. The list is empty for a policy without networks, such as a rule, and if they
    are unknown: for the stages of a chain, or a user-defined class.
    """
    if isinstance(policy, LastObservations):
        return networks(policy.policy)
    if isinstance(policy, GRU):
        return [policy.gates, policy.fresh, policy.readout]
    return [policy.network] if isinstance(policy, MLP | Residual) else []


def undrawn(policy: Policy) -> bool:
    """Whether a policy is a recipe, whose networks are still to be drawn."""
    return all(network is None for network in networks(policy))


def to_be_drawn(policy: Policy) -> bool:
    """Whether a policy is a recipe that has networks: training may begin from other weights."""
    return bool(networks(policy)) and undrawn(policy)


def layers(policy: Policy) -> list[tuple[Any, Any]]:
    """Weights and biases of the first layers of a policy's networks."""
    return [
        (network.weights[0], network.biases[0])
        for network in networks(policy)
        if network is not None
    ]


def plain(weights, bias, mean, deviation) -> tuple[Any, Any]:
    """The layer of unscaled features with the outputs of this one with scaled ones."""
    weights = weights / deviation
    return weights, bias - weights @ mean


def scaled(weights, bias, mean, deviation) -> tuple[Any, Any]:
    """The inverse of `plain`."""
    return weights * deviation, bias + weights @ mean


def slope(weights, bias, mean, deviation) -> tuple[Any, Any]:
    """The gradient with respect to a layer for scaled features, from that for the layer of
    `plain`."""
    return (weights - np.outer(bias, mean)) / deviation, bias


def scale_of(policy: Policy, problem: Problem) -> FeatureScale | None:
    """The scale of the features that no decision moves; None if there is no such feature, if no
    network of the policy observes it, or if few numbers are decided and none by a `Stop`."""
    if not layers(policy):
        return None
    if problem.action.size <= MANY and not contains(problem.action, Stop):
        return None
    return fixed(problem)


def fixed(problem: Problem) -> FeatureScale | None:
    """The scale over time and paths of features that no decision affects; None if there is none."""
    moved = affected_by_decisions(problem)
    if all(jax.tree.leaves(moved)) and not jax.tree.leaves(problem.schedule.steps):
        return None
    simulator, schedule, horizon = problem.simulator, problem.schedule, problem.simulator.horizon
    still = _Unmoved(simulator, moved)  # pyright: ignore
    bound = BoundEngine(Xla("float32"), still, schedule)
    draws = problem.sources.training.batch(0, PATHS, simulator)
    actions = np.zeros((horizon, draws.size, simulator.action.size), np.float32)
    states = bound.values(None, draws, Exact(), actions=actions, record=("state",)).record["state"]
    observed = [
        np.asarray(
            observations(simulator, schedule.constants, schedule.steps, _set(states, moved, x))
        )
        for x in MOVED
    ]
    rows = observed[0].reshape(horizon * draws.size, -1).astype(np.float64)
    with np.errstate(invalid="ignore"):
        same = np.all([np.all(item == observed[0], axis=(0, 1)) for item in observed], axis=0)
        mean, deviation = rows.mean(0), rows.std(0)
        available = same & (deviation > VARIES * np.maximum(1.0, np.abs(mean)))
    available &= np.isfinite(mean) & np.isfinite(deviation)
    if not available.any():
        return None
    mean, deviation = np.where(available, mean, 0.0), np.where(available, deviation, 1.0)
    return FeatureScale(tuple(mean.tolist()), tuple(deviation.tolist()))


class _Unmoved(Around):
    """A simulator without outputs, in whose state only the parts move that no decision moves."""

    moved: PyTree = eqx.field(static=True)

    def step(self, constants, now, state, action, noise, smooth):
        after, _ = self.inner.step(constants, now, state, action, noise, smooth)
        flags = jax.tree.leaves(self.moved)
        selected = [
            old if flag else new
            for old, new, flag in zip(jax.tree.leaves(state), jax.tree.leaves(after), flags)
        ]
        return jax.tree.unflatten(jax.tree.structure(state), selected), {}

    def terminal(self, constants, state, smooth):
        return {}


def _set(states: PyTree, moved: PyTree, number: float) -> PyTree:
    """The states with another number in every part that a decision moves."""

    def one(leaf, flag):
        if not flag or not np.issubdtype(leaf.dtype, np.number):
            return leaf
        return (leaf * number + number).astype(leaf.dtype)

    return jax.tree.map(lambda leaf, flag: one(np.asarray(leaf), flag), states, moved)


def affected_by_decisions(problem: Problem) -> PyTree:
    """For each leaf of the state whether a decision moves it, now or later."""
    simulator, schedule = problem.simulator, problem.schedule
    constants = schedule.constants
    start = np.zeros(simulator.initial_noise_size, np.float32)
    state = jax.eval_shape(simulator.initial, constants, start)
    leaves, structure = jax.tree.flatten(state)
    action = np.zeros(simulator.action.size, np.float32)
    noise = np.zeros(simulator.noise_size, np.float32)

    def step(action, leaves, noise, inputs):
        state, (constants, now) = jax.tree.unflatten(structure, leaves), inputs
        return jax.tree.leaves(simulator.step(constants, now, state, action, noise, Exact())[0])

    values = constants, at(schedule.steps, 0)
    program = jax.make_jaxpr(step)(action, leaves, noise, values).jaxpr
    moved, other = [False] * len(leaves), [False] * (1 + len(jax.tree.leaves(values)))
    while True:
        after = _follows(program, [True, *moved, *other])
        both = [a or b for a, b in zip(moved, after)]
        if both == moved:
            return jax.tree.unflatten(structure, moved)
        moved = both


def _follows(program, marks: list[bool]) -> list[bool]:
    """Which results of a program follow from a marked argument; all those of a loop or a condition
    if any does."""
    available = {var for var, mark in zip(program.invars, marks) if mark}

    def marked(variables) -> list[bool]:
        return [not hasattr(var, "val") and var in available for var in variables]

    for eqn in program.eqns:
        local = marked(eqn.invars)
        inner = called(eqn)
        results = [any(local)] * len(eqn.outvars) if inner is None else _follows(inner.jaxpr, local)
        available.update(var for var, mark in zip(eqn.outvars, results) if mark)
    return marked(program.outvars)
