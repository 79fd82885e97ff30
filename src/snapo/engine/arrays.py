"""Totals of a path, and its state as packed vectors, with the memory of its policy."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from snapo.problem.policies.memory import Remembering, remembered, remembers
from snapo.problem.policy import Policy
from snapo.problem.simulator import Simulator

from .base import Adjoint, Rollout


def add(kind: str, total, value):
    """The total after one more value; `kind` is "sum", "max" or "last"."""
    if total is None or kind == "last":
        return value
    return jnp.maximum(total, value) if kind == "max" else total + value


def zero(kind: str, dtype):
    """The total before the first step."""
    return jnp.asarray(-jnp.inf if kind == "max" else 0.0, dtype)


class Packing:
    """Layout of a path's state, a tree of small arrays, as one vector for each type.
    Floating-point leaves take the engine's precision; integers and booleans keep their type.
    """

    def __init__(self, state: PyTree, dtype):
        leaves, self.tree = jax.tree.flatten(state)
        leaves = [jnp.asarray(leaf) for leaf in leaves]
        self.shapes = [leaf.shape for leaf in leaves]
        floating = [jnp.issubdtype(leaf.dtype, jnp.floating) for leaf in leaves]
        self.types = [np.dtype(dtype) if f else leaf.dtype for f, leaf in zip(floating, leaves)]
        self.kinds = list(dict.fromkeys(self.types))

    def pack(self, state: PyTree) -> tuple[Array, ...]:
        """One vector per type, in the order of first appearance."""
        leaves = [jnp.asarray(leaf) for leaf in self.tree.flatten_up_to(state)]
        for leaf, shape in zip(leaves, self.shapes):
            if leaf.shape != shape:
                raise ValueError(
                    f"The state changes shape: `initial` gives {shape}, `step` {leaf.shape}."
                )
        return tuple(
            jnp.concatenate(
                [x.astype(kind).ravel() for x, t in zip(leaves, self.types) if t == kind]
            )
            for kind in self.kinds
        )

    def unpack(self, packed: tuple[Array, ...]) -> PyTree:
        """The state from its vectors."""
        position = dict.fromkeys(self.kinds, 0)
        leaves = []
        for shape, kind in zip(self.shapes, self.types):
            size = int(np.prod(shape))
            vector = packed[self.kinds.index(kind)]
            leaves.append(vector[position[kind] : position[kind] + size].reshape(shape))
            position[kind] += size
        return self.tree.unflatten(leaves)


def with_memory(
    simulator: Simulator, policy: Policy | None, actions, start: PyTree, paths: int
) -> tuple[Simulator, PyTree]:
    """The simulator and the initial states that a rollout of this policy needs.

    Recorded actions need no memory; supplied states start with an empty one.
    """
    size = 0 if actions is not None else remembered(policy)
    if not size or remembers(simulator):
        return simulator, start
    around = Remembering(simulator, size)  # pyright: ignore
    if start is not None:
        start = {"memory": np.zeros((paths, size)), "own": start}
    return around, start


def values_without(simulator: Simulator, used: Simulator, rollout: Rollout) -> Rollout:
    """The result of a sweep without the memory that `used` has and `simulator` does not have."""
    if used is simulator or not isinstance(used, Remembering):
        return rollout
    record = dict(rollout.record)
    if "state" in record:
        record["state"] = record["state"]["own"]
    if "action" in record:
        record["action"] = record["action"][..., : simulator.action.size]
    return Rollout(rollout.totals, rollout.state["own"], record)


def adjoint_without(simulator: Simulator, used: Simulator, adjoint: Adjoint) -> Adjoint:
    """The result of an adjoint pass without that memory."""
    if used is simulator or not isinstance(used, Remembering) or adjoint.start is None:
        return adjoint
    return adjoint._replace(start=adjoint.start["own"])
