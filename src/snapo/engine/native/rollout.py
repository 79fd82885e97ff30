"""Trees that paths share, the phases as functions of arrays, and a rollout traced and cut."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.lanes import Unsupported
from snapo.lanes.program.cut import (
    CALL,
    PATH,
    STEP,
    Cut,
    Leaf,
    cut,
    differentiated,
    evaluate,
    inlined,
)

from ..arrays import add
from ..base import factor_of


class SharedTree:
    """A tree that all paths share, flattened once per call, since flattening takes time. Its
    arrays (NumPy, floating-point ones in the call's precision) are read at every call; everything
    else is compiled in.
    """

    def __init__(self, tree, dtype):
        leaves, self.tree = jax.tree.flatten(tree)
        self.leaves = [cast(x, dtype) if _is_array(x) else x for x in leaves]

    @property
    def arrays(self) -> list[np.ndarray]:
        return [x for x in self.leaves if isinstance(x, np.ndarray)]

    def key(self, skip: int = 0) -> tuple:
        """All on which a kernel depends: structure, types, shapes, and all leaves except arrays."""
        return self.tree, tuple(
            (x.shape[skip:], x.dtype) if isinstance(x, np.ndarray) else (type(x), x)
            for x in self.leaves
        )

    def shapes(self, skip: int = 0) -> PyTree:
        """The tree with the types of its arrays, without their first `skip` axes."""
        leaves = [
            jax.ShapeDtypeStruct(x.shape[skip:], x.dtype) if isinstance(x, np.ndarray) else x
            for x in self.leaves
        ]
        return jax.tree.unflatten(self.tree, leaves)

    def split(self) -> tuple[PyTree, PyTree]:
        """The tree with only its arrays, and with only the rest; None elsewhere."""
        arrays = [x if isinstance(x, np.ndarray) else None for x in self.leaves]
        rest = [None if isinstance(x, np.ndarray) else x for x in self.leaves]
        return jax.tree.unflatten(self.tree, arrays), jax.tree.unflatten(self.tree, rest)

    def like(self, values: Iterable) -> PyTree:
        """The tree with these values for its arrays, in order, and None for the rest."""
        values = iter(values)
        filled = [next(values) if isinstance(x, np.ndarray) else None for x in self.leaves]
        return jax.tree.unflatten(self.tree, filled)


def _is_array(x) -> bool:
    return isinstance(x, np.ndarray | np.generic | jax.Array)


def cast(x, dtype) -> np.ndarray:
    """An array as NumPy, floating ones in this precision: nothing is compiled for it."""
    array = np.asarray(x)
    return array.astype(dtype, copy=False) if jnp.issubdtype(array.dtype, jnp.floating) else array


def jax_type(x) -> np.dtype:
    """The type of this array in JAX under the present precision."""
    return np.dtype(jax.dtypes.canonicalize_dtype(x.dtype))


def floating(x) -> bool:
    """Whether an array holds floating numbers."""
    return bool(np.issubdtype(x.dtype, np.floating))


@dataclass(frozen=True)
class FunctionSetup:
    """The purpose of a kernel, in addition to the simulator, the policy and the types of arrays."""

    dtype: str
    adjoint: bool
    record: tuple[str, ...]
    actions: bool
    start: bool
    has_terminal: bool
    clip: bool
    wrt: tuple[str, ...]
    counter: bool
    antithetic: bool
    before: int


class Functions:
    """The phases as functions of flat lists of arrays."""

    def __init__(self, setup: FunctionSetup, dtype, segments, current, calls: int, nows: int):
        self.setup, self.dtype = setup, dtype
        self.segments, self.current = segments, current
        self.calls, self.nows = calls, nows

    def describe(self, call, now, state_like, noise_sizes, action_size) -> None:
        """Shapes of states, outputs and records, and the one trace of the user's step."""
        real = self.dtype
        self.noise = [jax.ShapeDtypeStruct((n,), real) for n in noise_sizes]
        self.action = jax.ShapeDtypeStruct((action_size,), real)
        if state_like is None:
            state_like = initial_state(self.segments, call, self.noise[1])
        leaves, self.state_tree = jax.tree.flatten(state_like)
        self.state = [jax.ShapeDtypeStruct(x.shape, self._kind(x)) for x in leaves]

        values = call, now, self.state, self.noise[0], self.action
        self.once, selected = jax.make_jaxpr(self._outputs, return_shape=True)(*values)
        if self.once.effects:
            raise Unsupported("a callback, such as jax.debug.print, in step")
        self.after, self.names = jax.tree.structure(selected), list(selected[1])
        self.record_tree = jax.tree.structure(selected[2])

        def last(call, state):
            _, constants, smooth, simulator = self.segments(call)
            return simulator.terminal(constants, self._state(state), smooth)

        ending = jax.eval_shape(last, call, self.state) if self.setup.has_terminal else {}
        self.final_names = [*self.names, *(n for n in ending if n not in self.names)]

    def _kind(self, x):
        dtype = np.dtype(x.dtype)
        return self.dtype if np.issubdtype(dtype, np.floating) else jax_type(x)

    def _state(self, leaves):
        return jax.tree.unflatten(self.state_tree, leaves)

    def _leaves(self, state) -> list[Any]:
        """A state's leaves in their types; their shapes may not change."""
        leaves = [jnp.asarray(x) for x in self.state_tree.flatten_up_to(state)]
        for leaf, available in zip(leaves, self.state):
            if leaf.shape != available.shape:
                raise ValueError(
                    f"The state changes shape: `initial` gives {available.shape} "
                    f"where `step` gives {leaf.shape}."
                )
        return [leaf.astype(valid.dtype) for leaf, valid in zip(leaves, self.state)]

    def _outputs(self, call, now, leaves, noise, action):
        policy, constants, smooth, simulator = self.segments(call)
        now, state = self.current(now), self._state(leaves)
        if not self.setup.actions:
            action = policy(simulator.observe(constants, now, state), smooth)
            # The same step follows in a kernel that reads recorded actions.
            action = jax.lax.optimization_barrier(jnp.asarray(action, self.dtype))
        after, outputs = simulator.step(constants, now, state, action, noise, smooth)
        outputs = {name: jnp.asarray(value, self.dtype) for name, value in outputs.items()}
        selected = {"state": state, "action": action, "outputs": outputs}
        if "slack" in self.setup.record:
            selected["slack"] = dict(simulator.slack(constants, now, after, outputs))
        return after, outputs, {name: selected[name] for name in self.setup.record}

    def _initial(self, *values):
        call, local = values[: self.calls], values[self.calls :]
        _, constants, _, simulator = self.segments(call)
        if self.setup.start:
            leaves = self._leaves(self._state(local))
        else:
            leaves = self._leaves(simulator.initial(constants, local[0]))
        kinds = simulator.totals()
        zeros = [-np.inf if kinds.get(n, "sum") == "max" else 0.0 for n in self.names]
        return [*leaves, *(jnp.asarray(z, self.dtype) for z in zeros)]

    def _step(self, *values):
        call, rest = values[: self.calls], values[self.calls :]
        now, local = rest[: self.nows], rest[self.nows :]
        n = len(self.state)
        leaves, totals, local = (
            local[:n],
            local[n : n + len(self.names)],
            local[n + len(self.names) :],
        )
        noise = local[0]
        action = local[1] if self.setup.actions else jnp.zeros(self.action.shape, self.dtype)
        result = evaluate(self.once, [*call, *now, *leaves, noise, action])
        after, outputs, selected = jax.tree.unflatten(self.after, result)
        kinds = self.segments(call)[3].totals()
        totals = [add(kinds.get(k, "sum"), t, outputs[k]) for k, t in zip(self.names, totals)]
        return [*self._leaves(after), *totals, *jax.tree.leaves(selected), *self._scales(call)]

    def _final(self, *values):
        call, local = values[: self.calls], values[self.calls :]
        n = len(self.state)
        totals = dict(zip(self.names, local[n:]))
        _, constants, smooth, simulator = self.segments(call)
        if self.setup.has_terminal:
            kinds = simulator.totals()
            for name, value in simulator.terminal(
                constants, self._state(local[:n]), smooth
            ).items():
                value = jnp.asarray(value, self.dtype)
                totals[name] = add(kinds.get(name, "sum"), totals.get(name), value)
        return [*(totals[name] for name in self.final_names), *local[:n]]

    def phases(self) -> Iterator[Any]:
        """(name, function, inputs, outputs, whether it depends on the step) of every phase."""
        total = jax.ShapeDtypeStruct((), self.dtype)
        state = [(("state", i), x) for i, x in enumerate(self.state)]
        carry = [*state, *((("total", n), total) for n in self.names)]
        keys = [key for key, _ in carry]
        start = [(("start", i), x) for i, x in enumerate(self.state)]
        entry = start if self.setup.start else [("noise", self.noise[1])]
        local = [*carry, ("noise", self.noise[0])]
        local += [("action", self.action)] if self.setup.actions else []
        records = [("record", i) for i in range(self.record_tree.num_leaves)]
        final = [
            *(("final", n) for n in self.final_names),
            *(("end", i) for i in range(len(self.state))),
        ]
        yield "initial", self._initial, entry, keys, False
        yield "step", self._step, local, [*keys, *records], True
        yield "final", self._final, carry, final, False

    def clip(self) -> Callable | None:
        """Limits and shrinks the cotangents of the state, not those of the totals (`Clip`)."""
        if not self.setup.clip:
            return None
        floats = [i for i, x in enumerate(self.state) if floating(x)]
        tiny = np.finfo(self.dtype).tiny

        def clip(back, outputs, values):
            scales = outputs[len(outputs) - len(floats) :]
            square = sum(jnp.sum((g * s) ** 2) for g, s in zip(back, scales))
            factor = factor_of(jnp.sqrt(jnp.maximum(square, tiny)), values)
            return [*(g * factor for g in back[: len(floats)]), *back[len(floats) :]]

        return clip if floats else None

    def _scales(self, call) -> list[Any]:
        """`state_scale` of every floating leaf of the state, where adjoints are clipped."""
        if not self.setup.clip:
            return []
        _, constants, _, simulator = self.segments(call)
        scale = simulator.state_scale(constants)
        leaves = [1.0] * len(self.state) if scale is None else self.state_tree.flatten_up_to(scale)
        return [
            jnp.broadcast_to(jnp.asarray(s, x.dtype), x.shape)
            for s, x in zip(leaves, self.state)
            if floating(x)
        ]


def initial_state(segments: Callable, call, noise) -> PyTree:
    """Shapes and types of a path's state at its start, from the simulator."""

    def first(call, noise):
        _, constants, _, simulator = segments(call)
        return simulator.initial(constants, noise)

    return jax.eval_shape(first, call, noise)


@dataclass(eq=False)
class Phase:
    """One phase, cut; `inputs` and `outputs` name the path's arrays in order."""

    name: str
    cut: Cut
    inputs: list[tuple[str, Any]]
    outputs: list[tuple[str, Any]]


@dataclass(eq=False)
class KernelTrees:
    """Converts a kernel's arrays back to the caller's trees.

    `requested`: whether the gradients of the leaves of `call` and `now` are requested. If a
    gradient is zero on every path, the leaf is not active, and the kernel adds nothing up.
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


@dataclass(eq=False)
class Traced(KernelTrees):
    """Everything that the writer of a kernel needs."""

    phases: dict[str, Phase]
    clip: Callable | None


def parted(split: tuple[PyTree, PyTree], skip: int = 0) -> tuple[Callable, list]:
    """The tree as a function of its arrays, and their shapes without the first `skip` axes."""
    leaves, tree = jax.tree.flatten(split[0])

    def combined(values):
        return eqx.combine(jax.tree.unflatten(tree, values), split[1])

    return combined, [jax.ShapeDtypeStruct(np.shape(x)[skip:], jax_type(x)) for x in leaves]


def traced(
    shared, steps, state_like, setup: FunctionSetup, noise_sizes: tuple[int, int], action_size: int
) -> Traced:
    """Traces and cuts the phases. `state_like` is the tree of supplied starting states, or None."""
    dtype = np.dtype(setup.dtype)
    segments, call_avals = parted(shared)
    current, step_leaves = parted(steps, skip=1)
    requested = [bool(m) for m in jax.tree.leaves(_differentiable(shared[0], setup.wrt))]
    moving = ["schedule" in setup.wrt and floating(x) for x in step_leaves]
    builder = Functions(setup, dtype, segments, current, len(call_avals), len(step_leaves))
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
