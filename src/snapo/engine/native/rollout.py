"""The phases of a rollout, traced and cut: all that the writer of a kernel needs to know."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import numpy as np

from snapo.lanes.program.cut import CALL, PATH, STEP, Cut, Leaf, cut, differentiated, inlined

from .functions import Functions, FunctionSetup
from .given import floating, jax_type


@dataclass(eq=False)
class Phase:
    """One phase, cut; `inputs` and `outputs` name the path's arrays in order."""

    name: str
    cut: Cut
    inputs: list[tuple[str, Any]]
    outputs: list[tuple[str, Any]]


@dataclass(eq=False)
class Traced:
    """Everything that the writer of a kernel needs, and the way back to the caller's trees.

    `requested`: of the leaves of `call` and of `now`, whether their gradient is asked for. Where it
    is zero whatever the path does, the leaf is not active, and the kernel adds nothing up.
    """

    setup: FunctionSetup
    call: list[Leaf]
    now: list[Leaf]
    requested: tuple[list[bool], list[bool]]
    state: list[Any]
    state_tree: Any
    names: list[str]
    final_names: list[str]
    record_tree: Any
    phases: dict[str, Phase]
    clip: Callable | None


def traced(
    shared, steps, state_like, setup: FunctionSetup, noise_sizes: tuple[int, int], action_size: int
) -> Traced:
    """Traces and cuts the phases. `state_like` is the tree of given starting states, or None."""
    dtype = np.dtype(setup.dtype)
    leaves, tree = jax.tree.flatten(shared[0])
    step_leaves, step_tree = jax.tree.flatten(steps[0])
    step_leaves = [jax.ShapeDtypeStruct(x.shape[1:], jax_type(x)) for x in step_leaves]
    call_avals = [jax.ShapeDtypeStruct(np.shape(x), jax_type(x)) for x in leaves]
    requested = [bool(m) for m in jax.tree.leaves(_differentiable(shared[0], setup.wrt))]
    moving = ["schedule" in setup.wrt and floating(x) for x in step_leaves]

    def segments(values):
        return eqx.combine(jax.tree.unflatten(tree, values), shared[1])

    def current(values):
        return eqx.combine(jax.tree.unflatten(step_tree, values), steps[1])

    builder = Functions(setup, dtype, segments, current, len(leaves), len(step_leaves))
    builder.describe(call_avals, step_leaves, state_like, noise_sizes, action_size)
    rows, used = [], set()
    for name, function, inputs, outputs, with_now in builder.phases():
        shared_avals = [*call_avals, *(step_leaves if with_now else [])]
        closed = inlined(function, [*shared_avals, *(aval for _, aval in inputs)])
        rows.append((name, closed, inputs, outputs, with_now))
        used |= differentiated(closed, len(shared_avals))
    call = [
        Leaf(x.shape, x.dtype, m and i in used)
        for i, (x, m) in enumerate(zip(call_avals, requested))
    ]
    now = [
        Leaf(x.shape, x.dtype, m and i in used)
        for i, (x, m) in enumerate(zip(step_leaves, moving), len(call))
    ]
    phases = {}
    for name, closed, inputs, outputs, with_now in rows:
        levels = [CALL] * len(call) + [STEP] * (len(now) if with_now else 0) + [PATH] * len(inputs)
        available = [*call, *(now if with_now else []), *[None] * len(inputs)]
        keys = [*outputs, *[("scale", i) for i in range(len(closed.jaxpr.outvars) - len(outputs))]]
        labelled = [(key, v.aval) for key, v in zip(keys, closed.jaxpr.outvars)]
        phases[name] = Phase(name, cut(closed, levels, available), inputs, labelled)
    return Traced(
        setup, call, now, (requested, moving), builder.state, builder.state_tree, builder.names,
        builder.final_names, builder.record_tree, phases, builder.clip(),
    )  # fmt: skip


def _differentiable(shared, wrt: tuple[str, ...]):
    """True for floating arrays of the policy and the constants, where they are asked for."""
    policy, constants, smooth, simulator = shared
    return (
        jax.tree.map(lambda x: "policy" in wrt and floating(x), policy),
        jax.tree.map(lambda x: "schedule" in wrt and floating(x), constants),
        *jax.tree.map(lambda x: False, (smooth, simulator)),
    )
