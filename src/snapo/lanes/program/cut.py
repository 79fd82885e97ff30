"""A function of one path as JAX sees it, cut by the inputs that its numbers depend on.

    call   on inputs that the whole call shares        computed once per call
    step   on those that all paths of a step share     computed once per step, as scalars
    path   on a path's inputs                      computed for lanes of paths

Every piece is then differentiated on its own (`joint`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..jax_private import apply, called, is_literal, searched_side, traceback_of

CONSTANT, CALL, STEP, PATH = range(4)
# What comes after it is the same whatever comes before it: a number that arrives from memory in
# another kernel is computed at the same level, and is not known while compiling.
BARRIER = "optimization_barrier"
STILL = "stop_gradient"  # nothing after it has a derivative
# Operations that only rearrange, or leave out derivatives: kept with whoever reads them, so that
# nothing is copied.
LAYOUT = {"broadcast_in_dim", "reshape", "transpose", "squeeze", "expand_dims", STILL}


@dataclass(eq=False)
class Leaf:
    """One array that crosses a boundary between pieces: its type, and whether it has a gradient."""

    shape: tuple[int, ...]
    dtype: np.dtype
    active: bool

    @property
    def aval(self):
        return jax.ShapeDtypeStruct(self.shape, self.dtype)


@dataclass(eq=False)
class Piece:
    """Equations with their `inputs` and `outputs`, before differentiation.

    `reads` are leaves of earlier pieces, one for each of the first inputs; the other inputs are
    numbers of the path.
    """

    reads: list[Leaf]
    inputs: list[Any]
    eqns: list[Any]
    outputs: list[Any]
    constants: dict[Any, Any] = field(default_factory=dict)

    def __call__(self, *values):
        env = dict(self.constants)
        env.update(zip(self.inputs, values))

        def read(atom):
            return atom.val if is_literal(atom) else env[atom]

        for eqn in self.eqns:
            inputs = [read(a) for a in eqn.invars]
            env.update(zip(eqn.outvars, apply(eqn, inputs, eqn.source_info.traceback)))
        return [read(a) for a in self.outputs]


ADDS_AXES = {"broadcast_in_dim", "expand_dims", "reshape"}
REMOVES_AXES = {"squeeze", "reshape"}


@dataclass(frozen=True)
class Assembly:
    """An array that was put together from parts along an axis; `stacked`: whether the parts were
    rows without that axis.

    The array itself is stored too, since its identity is a key that no later array may reuse.
    """

    array: Any
    parts: Sequence[Any]
    axis: int = 0
    stacked: bool = False

    def lengths(self) -> list[int]:
        """The lengths of the parts along the axis."""
        return [1 if self.stacked else jnp.shape(part)[self.axis] for part in self.parts]


class Assembled:
    """The arrays that one trace has put together or given further axes.

    An observation is one array of many numbers, and a policy may read few of them. If its slices
    read the parts directly, unused parts are not computed or differentiated.
    """

    def __init__(self):
        self._parts: dict[int, Assembly] = {}
        self._sources: dict[int, tuple[Any, Any]] = {}

    def result(self, eqn, inputs: list[Any]) -> Any:
        """The result of an equation that reads an assembled array; None if it must be applied."""
        name, params = eqn.primitive.name, eqn.params
        if name == "slice" and (parts := self._parts.get(id(inputs[0]))) is not None:
            return self._sliced(parts, params)
        if name in REMOVES_AXES and id(inputs[0]) in self._sources:
            source = self._sources[id(inputs[0])][1]
            return source if jnp.shape(source) == eqn.outvars[0].aval.shape else None
        return None

    def add(self, eqn, inputs: list[Any], outputs: list[Any]) -> None:
        """Notes an equation that was applied, if it assembles an array."""
        name, params = eqn.primitive.name, eqn.params
        if name == "concatenate":
            self._assembled(Assembly(outputs[0], inputs, params["dimension"]))
        elif name == "stack" and params["axis"] == 0:
            self._assembled(Assembly(outputs[0], inputs, stacked=True))
        elif name in ADDS_AXES and jnp.size(inputs[0]) == jnp.size(outputs[0]):
            self._sources[id(outputs[0])] = outputs[0], inputs[0]

    def _assembled(self, parts: Assembly) -> Any:
        self._parts[id(parts.array)] = parts
        return parts.array

    def _sliced(self, whole: Assembly, params) -> Any:
        """A slice along the axis of the parts; None for other slices, for all parts and for an
        empty slice."""
        starts, limits, axis = params["start_indices"], params["limit_indices"], whole.axis
        shape = jnp.shape(whole.array)
        across = [i for i in range(len(shape)) if i != axis]
        partial = any((starts[i], limits[i]) != (0, shape[i]) for i in across)
        stepped = any(stride != 1 for stride in params["strides"] or ())
        if stepped or partial or limits[axis] - starts[axis] in (0, shape[axis]):
            return None
        return self._between(whole, starts[axis], limits[axis])

    def _between(self, whole: Assembly, start: int, limit: int) -> Any:
        """The positions from `start` to before `limit`."""
        selected, offset = [], 0
        for part, length in zip(whole.parts, whole.lengths()):
            first, last = max(start - offset, 0), min(limit - offset, length)
            if first < last:
                selected.append(self._part(whole, part, first, last, length))
            offset += length
        if len(selected) == 1:
            return selected[0]
        joined = jax.lax.concatenate(selected, whole.axis)
        return self._assembled(Assembly(joined, selected, whole.axis))

    def _part(self, whole: Assembly, part: Any, first: int, last: int, length: int) -> Any:
        """Positions of one part, with the axis."""
        if whole.stacked:
            row = jax.lax.expand_dims(part, (0,))
            self._sources[id(row)] = row, part
            return row
        if last - first == length:
            return part
        if (inner := self._parts.get(id(part))) is not None and inner.axis == whole.axis:
            return self._between(inner, first, last)
        return jax.lax.slice_in_dim(part, first, last, axis=whole.axis)


def inlined(function: Callable, avals: Sequence[Any]):
    """The jaxpr of a function with plain calls inlined; rules of differentiation stay whole."""
    closed = jax.make_jaxpr(function)(*avals)
    if not any(map(_plain_call, closed.jaxpr.eqns)):
        return closed
    return jax.make_jaxpr(lambda *values: evaluate(closed, values))(*avals)


def _plain_call(eqn) -> bool:
    return eqn.primitive.name in ("jit", "pjit", "closed_call") and searched_side(eqn) is None


def evaluate(closed, values, caller=None, assembled: Assembled | None = None):
    """Applies the equations of a jaxpr and of the plain calls in it.

    Equations inside a function of `jax.numpy` have the line of user code that called it.
    Slices of `assembled` arrays read their parts.
    """
    jaxpr, assembled = closed.jaxpr, assembled or Assembled()
    env = dict(zip(jaxpr.constvars, map(_fresh, closed.consts)))
    env.update(zip(jaxpr.invars, values))

    def read(atom):
        return atom.val if is_literal(atom) else env[atom]

    for eqn in jaxpr.eqns:
        inputs = [read(a) for a in eqn.invars]
        line = traceback_of(eqn, caller)
        if _plain_call(eqn):
            outputs = evaluate(called(eqn), inputs, line, assembled)
        elif (part := assembled.result(eqn, inputs)) is not None:
            outputs = [part]
        else:
            outputs = apply(eqn, inputs, line)
            assembled.add(eqn, inputs, outputs)
        env.update(zip(eqn.outvars, outputs))
    return [read(a) for a in jaxpr.outvars]


def _fresh(constant):
    """A copy of a NumPy table: JAX caches a table with the precision of its first use."""
    return constant.copy() if isinstance(constant, np.ndarray) else constant


@dataclass(eq=False)
class Cut:
    """A function, cut into one piece per level."""

    call: Piece
    step: Piece
    path: Piece
    call_leaves: list[Leaf]
    step_leaves: list[Leaf]


def cut(closed, levels: list[int], leaves: list[Leaf | None]) -> Cut:
    """Cuts a jaxpr. `levels` and `leaves` describe its inputs; paths' inputs have no leaf."""
    jaxpr = closed.jaxpr
    level = {v: CONSTANT for v in jaxpr.constvars} | dict(zip(jaxpr.invars, levels))
    leaf: dict[Any, Leaf] = {v: x for v, x in zip(jaxpr.invars, leaves) if x is not None}
    active = {v for v, x in zip(jaxpr.invars, leaves) if x is None or x.active}
    maker = {}
    for eqn in jaxpr.eqns:
        atoms = [a for a in eqn.invars if not is_literal(a)]
        top = max([level[a] for a in atoms], default=CONSTANT)
        if eqn.primitive.name == BARRIER:
            top = PATH
        for v in eqn.outvars:
            level[v], maker[v] = top, eqn
            still = eqn.primitive.name == STILL or not any(a in active for a in atoms)
            if not still and jnp.issubdtype(v.aval.dtype, jnp.floating):
                active.add(v)
    consts = dict(zip(jaxpr.constvars, closed.consts))

    def piece(local: int, outputs) -> Piece:
        """The equations of one level that these outputs need, and their reads from below."""
        eqns, boundary = _closure(
            jaxpr, outputs, local, level, maker, set(jaxpr.invars) | set(consts)
        )
        below = [v for v in boundary if v not in consts and (level[v] < PATH or local < PATH)]
        for v in below:
            if v not in leaf:
                leaf[v] = Leaf(v.aval.shape, np.dtype(v.aval.dtype), v in active)
        rest = [v for v in jaxpr.invars if level[v] == PATH] if local == PATH else []
        constants = {v: consts[v] for v in boundary if v in consts}
        return Piece([leaf[v] for v in below], [*below, *rest], eqns, list(outputs), constants)

    path = piece(PATH, jaxpr.outvars)
    values = set(jaxpr.invars)
    steps = [v for v in path.inputs if level[v] == STEP and v not in values]
    step = piece(STEP, steps)
    calls = [v for v in [*path.inputs, *step.inputs] if level[v] == CALL and v not in values]
    call = piece(CALL, list(dict.fromkeys(calls)))
    return Cut(call, step, path, [leaf[v] for v in call.outputs], [leaf[v] for v in step.outputs])


def differentiated(closed, count: int) -> set[int]:
    """The inputs among the first `count` inputs with respect to which derivatives may exist."""
    jaxpr, used = closed.jaxpr, set()
    for eqn in jaxpr.eqns:
        if eqn.primitive.name != STILL:
            used.update(a for a in eqn.invars if not is_literal(a))
    used.update(a for a in jaxpr.outvars if not is_literal(a))
    return {i for i, v in enumerate(jaxpr.invars[:count]) if v in used}


def _closure(jaxpr, outputs, local, level, maker, values):
    """Equations needed for `outputs` at a level, with cheap rearrangements of lower levels."""
    requested, boundary = set(), {}
    stack = [v for v in outputs if not is_literal(v)]
    observed = set()
    while stack:
        v = stack.pop()
        if v in observed:
            continue
        observed.add(v)
        eqn = maker.get(v)
        stays = eqn is not None and (
            level[v] in (local, CONSTANT) or (eqn.primitive.name in LAYOUT and v.aval.size >= 1)
        )
        if v in values or not stays:
            boundary[v] = None
            continue
        requested.add(id(eqn))
        stack.extend(a for a in eqn.invars if not is_literal(a))  # pyright: ignore
    eqns = [e for e in jaxpr.eqns if id(e) in requested]
    order = {v: i for i, v in enumerate([*jaxpr.constvars, *jaxpr.invars])}
    order |= {v: len(order) + i for i, e in enumerate(jaxpr.eqns) for v in e.outvars}
    return eqns, sorted(boundary, key=lambda v: order[v])
