"""The step of the optimiser, compiled once: AdamW with warm-up and cosine decay, and an average.

On windows several updates are made in each step of training, and their gradients change from one
window to the next: there the rate depends on the steps, not the updates, and Adam's second moment
has a memory of a hundred updates instead of a thousand.
"""

from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, PyTree

from snapo.problem.policy import trainable

from .features import FeatureScale

FORGET = 0.999  # of Adam's second moment, a step
WINDOWS_FORGET = 0.99  # on windows
SCALED_FORGET = 0.95  # where noise drives features: large first gradients must not hold steps down


class Plan(Protocol):
    """The settings of a training that the optimiser reads (see `Training`)."""

    @property
    def steps(self) -> int: ...
    @property
    def learning_rate(self) -> float: ...
    @property
    def warmup(self) -> int: ...
    @property
    def average(self) -> float: ...
    @property
    def decay(self) -> float: ...


def schedule(plan: Plan) -> optax.Schedule:
    """The rate of every step: it rises in the warm-up, then falls to zero by a cosine."""
    warmup = min(plan.warmup, max(0, plan.steps - 1))
    return optax.warmup_cosine_decay_schedule(
        0.0 if warmup else plan.learning_rate,
        plan.learning_rate,
        warmup,
        max(1, plan.steps),
    )


def rates(plan: Plan, count: int) -> np.ndarray:
    """The rates of the first `count` steps, in NumPy: nothing is compiled for them."""
    warmup, now = min(plan.warmup, max(0, plan.steps - 1)), np.arange(count)
    down = np.minimum((now - warmup) / (max(1, plan.steps) - warmup), 1.0)
    rising = now < warmup
    return plan.learning_rate * np.where(
        rising, now / max(1, warmup), 0.5 * (1 + np.cos(np.pi * down))
    )


def optimiser(plan: Plan, updates: int = 1, forget: float = FORGET) -> optax.GradientTransformation:
    """AdamW; with more than one update per step, the rate is that of the step."""
    # Objectives come in any unit, so Adam's guard against division by zero must be tiny.
    rate = schedule(plan)
    if updates == 1:
        return optax.adamw(rate, b2=forget, eps=1e-16, weight_decay=plan.decay)
    slower, forget = (lambda count: rate(count / updates)), WINDOWS_FORGET
    return optax.adamw(slower, b2=forget, eps=1e-16, weight_decay=plan.decay)


class _Numbers(NamedTuple):
    """A plan as numbers only."""

    steps: int
    learning_rate: float
    warmup: int
    average: float
    decay: float


@lru_cache(16)  # compiling takes as long as a short training: other seeds have the same plan
def _ascent(plan: _Numbers, updates: int, forget: float):
    adam = optimiser(plan, updates, forget)
    memory = max(1.0, plan.average * plan.steps)

    @jax.jit
    def ascend(moving, old, state, gradient, step):
        change, state = adam.update(-gradient, state, moving)
        moving = optax.apply_updates(moving, change)
        # A running mean whose memory grows to `memory` steps: early on it forgets the start.
        share = jnp.maximum(1 / memory, 1 / (1 + step)).astype(old.dtype)
        if updates > 1:
            share = 1 - (1 - share) ** (1 / updates)
        return moving, old + share * (moving - old), state, jnp.linalg.norm(gradient)

    return ascend


def memory(scale: FeatureScale | None) -> float:
    """The decay per step of Adam's mean square of gradients, over the whole horizon."""
    return FORGET if scale is None else SCALED_FORGET


def updater(plan: Plan, updates: int = 1, scale: FeatureScale | None = None):
    """The compiled update: an ascent step and the new average; with a scale, in scaled numbers."""
    numbers = _Numbers(plan.steps, plan.learning_rate, plan.warmup, plan.average, plan.decay)
    ascend = _ascent(numbers, updates, memory(scale))
    parts: list[Parts] = []

    def update(policy, average, state, gradient, step):
        if scale is not None:
            policy, average = scale.scaled(policy), scale.scaled(average)
            gradient = scale.slope(gradient)
        # What is not trained goes round the compiled part. Finding it takes longer than the part.
        if not parts:
            parts.append(Parts.of(policy))
        part = parts[0]
        vector = part.vector(policy)
        old, slope = part.vector(average), part.vector(gradient)
        vector, old, state, norm = ascend(vector, old, state, slope.astype(vector.dtype), step)
        policy, average = part.with_vector(policy, vector), part.with_vector(policy, old)
        if scale is not None:
            policy, average = scale.plain(policy), scale.plain(average)
        return policy, average, state, norm

    return update


class Parts(NamedTuple):
    """The trained leaves of a policy, with conversion to and from one vector."""

    structure: Any
    trained: tuple[int, ...]  # places among the leaves
    stops: np.ndarray  # of each in the vector

    @classmethod
    def of(cls, policy: PyTree) -> "Parts":
        """The parts of a policy; those of `trainable` are trained."""
        moving, fixed = trainable(policy)
        # Where a leaf is trained, the fixed tree has a hole.
        complete = jax.tree.map(lambda _: True, moving), jax.tree.map(lambda _: False, fixed)
        marks = jax.tree.leaves(eqx.combine(*complete))
        leaves, structure = jax.tree.flatten(policy)
        positions = tuple(position for position, mark in enumerate(marks) if mark)
        return cls(
            structure, positions, np.cumsum([np.size(leaves[location]) for location in positions])
        )

    def vector(self, tree: PyTree) -> np.ndarray:
        """The trained numbers of a policy, or its gradient, whose other leaves may be missing."""
        leaves, structure = jax.tree.flatten(tree)
        if structure != self.structure:
            return flat(trainable(tree)[0])
        results = [np.ravel(np.asarray(leaves[position])) for position in self.trained]
        return np.concatenate([np.zeros(0, np.float32), *results])

    def with_vector(self, policy: PyTree, vector: Array) -> PyTree:
        """The policy with other numbers."""
        leaves, numbers, start = jax.tree.leaves(policy), np.asarray(vector), 0
        for position, stop in zip(self.trained, self.stops):
            like, part = leaves[position], numbers[start:stop]
            leaves[position] = part.reshape(like.shape).astype(like.dtype, copy=False)
            start = stop
        return jax.tree.unflatten(self.structure, leaves)


def initial_state(plan: Plan, policy: PyTree, updates: int) -> PyTree:
    """An optimiser before its first step."""
    return optimiser(plan, updates).init(flat(trainable(policy)[0]))


def restarted(plan: Plan, policy: PyTree, state: Any, updates: int) -> PyTree:
    """An optimiser without memory of gradients; its schedule continues from that of `state`."""
    fresh = initial_state(plan, policy, updates)
    return (fresh[0], *jax.tree.map(lambda count: count * updates, tuple(state[1:])))


def flat(tree: PyTree) -> np.ndarray:
    """All numbers of a tree as one vector: one array compiles in half the time of many."""
    leaves = [np.ravel(np.asarray(leaf)) for leaf in jax.tree.leaves(tree)]
    return np.concatenate([np.zeros(0, np.float32), *leaves])
