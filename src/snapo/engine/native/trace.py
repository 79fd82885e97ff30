"""From a simulator and a policy to the programs of one path: what JAX sees, cut where it matters.

A rollout has three phases for every path, `initial`, `step` and `terminal`. Each is traced once
and cut by what a number depends on:

    call   on parameters and constants only            computed once per call
    step   on the schedule's step as well              computed once per step, as scalars
    path   on noise or state                           computed for lanes of paths

and every piece is differentiated on its own: the joint trace of a piece and its transpose is one
jaxpr, so nothing is decided by JAX about what to keep and what to compute again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np
from jax._src import source_info_util

from .program import CALLS, SEARCH, Program, flatten

CONSTANT, CALL, STEP, PATH = range(4)
# Operations that only rearrange: kept with whoever reads them, so that nothing is copied.
LAYOUT = {"broadcast_in_dim", "reshape", "transpose", "squeeze", "expand_dims"}


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
    """Equations with what they read (`inputs`) and give (`outputs`), before differentiation.

    `reads` are leaves of earlier pieces, one for each of the first inputs; the remaining inputs
    belong to the path (state, totals, noise, actions).
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
            return atom.val if isinstance(atom, jex.Literal) else env[atom]

        for eqn in self.eqns:
            inputs, line = [read(a) for a in eqn.invars], eqn.source_info.traceback
            env.update(zip(eqn.outvars, _bind(eqn, inputs, line)))
        return [read(a) for a in self.outputs]


def inlined(function: Callable, avals: Sequence[Any]):
    """The jaxpr of a function with plain calls inlined; rules of differentiation stay whole."""
    closed = jax.make_jaxpr(function)(*avals)
    if not any(map(_plain_call, closed.jaxpr.eqns)):
        return closed
    return jax.make_jaxpr(lambda *values: evaluate(closed, values))(*avals)


def _plain_call(eqn) -> bool:
    name = eqn.primitive.name
    return name in ("jit", "pjit", "closed_call") and eqn.params.get("name") != SEARCH


def evaluate(closed, values, caller=None):
    """Applies a jaxpr's equations, and those of the plain calls in it.

    Inside a function of `jax.numpy` equations know no line of the user's: it is the caller's.
    """
    jaxpr = closed.jaxpr
    env = dict(zip(jaxpr.constvars, closed.consts))
    env.update(zip(jaxpr.invars, values))

    def read(atom):
        return atom.val if isinstance(atom, jex.Literal) else env[atom]

    for eqn in jaxpr.eqns:
        inputs = [read(a) for a in eqn.invars]
        line = eqn.source_info.traceback
        if source_info_util.user_frame(line) is None:
            line = caller
        if _plain_call(eqn):
            outputs = evaluate(eqn.params[CALLS[eqn.primitive.name]], inputs, line)
        else:
            outputs = _bind(eqn, inputs, line)
        env.update(zip(eqn.outvars, outputs))
    return [read(a) for a in jaxpr.outvars]


def _bind(eqn, inputs, line):
    """Applies an equation, under the line of user code that it came from."""
    params = eqn.primitive.get_bind_params(eqn.params)
    with source_info_util.user_context(line), eqn.ctx.manager:
        outputs = eqn.primitive.bind(*inputs, **params)
    return outputs if eqn.primitive.multiple_results else [outputs]


@dataclass(eq=False)
class Cut:
    """One phase, cut into a piece per level."""

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
        atoms = [a for a in eqn.invars if not isinstance(a, jex.Literal)]
        top = max([level[a] for a in atoms], default=CONSTANT)
        for v in eqn.outvars:
            level[v], maker[v] = top, eqn
            if any(a in active for a in atoms) and jnp.issubdtype(v.aval.dtype, jnp.floating):
                active.add(v)
    consts = dict(zip(jaxpr.constvars, closed.consts))

    def piece(own: int, outputs) -> Piece:
        """The equations of one level that these outputs need, and what they read from below."""
        eqns, boundary = _closure(
            jaxpr, outputs, own, level, maker, set(jaxpr.invars) | set(consts)
        )
        below = [v for v in boundary if v not in consts and (level[v] < PATH or own < PATH)]
        for v in below:
            if v not in leaf:
                leaf[v] = Leaf(v.aval.shape, np.dtype(v.aval.dtype), v in active)
        rest = [v for v in jaxpr.invars if level[v] == PATH] if own == PATH else []
        constants = {v: consts[v] for v in boundary if v in consts}
        return Piece([leaf[v] for v in below], [*below, *rest], eqns, list(outputs), constants)

    path = piece(PATH, jaxpr.outvars)
    given = set(jaxpr.invars)
    steps = [v for v in path.inputs if level[v] == STEP and v not in given]
    step = piece(STEP, steps)
    calls = [v for v in [*path.inputs, *step.inputs] if level[v] == CALL and v not in given]
    call = piece(CALL, list(dict.fromkeys(calls)))
    return Cut(call, step, path, [leaf[v] for v in call.outputs], [leaf[v] for v in step.outputs])


def _closure(jaxpr, outputs, own, level, maker, given):
    """Equations needed for `outputs` at a level, with cheap rearrangements of lower levels."""
    wanted, boundary = set(), {}
    stack = [v for v in outputs if not isinstance(v, jex.Literal)]
    seen = set()
    while stack:
        v = stack.pop()
        if v in seen:
            continue
        seen.add(v)
        eqn = maker.get(v)
        stays = eqn is not None and (
            level[v] in (own, CONSTANT) or (eqn.primitive.name in LAYOUT and v.aval.size >= 1)
        )
        if v in given or not stays:
            boundary[v] = None
            continue
        wanted.add(id(eqn))
        stack.extend(a for a in eqn.invars if not isinstance(a, jex.Literal))  # pyright: ignore
    eqns = [e for e in jaxpr.eqns if id(e) in wanted]
    order = {v: i for i, v in enumerate([*jaxpr.constvars, *jaxpr.invars])}
    order |= {v: len(order) + i for i, e in enumerate(jaxpr.eqns) for v in e.outvars}
    return eqns, sorted(boundary, key=lambda v: order[v])


@dataclass(eq=False)
class Joint:
    """A piece and its transpose as one program.

    Inputs: what the piece reads, then the path's own, then the cotangents of the `moving`
    outputs. Outputs: the piece's, then the cotangents of active reads, then of active path inputs.
    """

    piece: Piece
    program: Program
    outputs: int
    cotangents: list[int]
    read_slots: list[int]
    path_slots: list[int]


def forward(piece: Piece, path_avals: Sequence[Any] = (), own_path: bool = True) -> Program:
    """A piece alone, for values."""
    avals = [leaf.aval for leaf in piece.reads] + list(path_avals)
    closed = jax.make_jaxpr(piece)(*avals)
    return flatten(closed, _lanes(piece, path_avals, own_path, 0))


def joint(
    piece: Piece,
    moving: Sequence[int],
    path_avals: Sequence[Any] = (),
    path_active: Sequence[int] = (),
    bound: Callable | None = None,
    own_path: bool = True,
) -> Joint:
    """Traces a piece with its transpose; `moving` are the outputs that have cotangents.

    `bound` maps the cotangents of the active path inputs to clipped ones, given the outputs and a
    number per path.
    """
    avals = [leaf.aval for leaf in piece.reads] + list(path_avals)
    reads = [i for i, leaf in enumerate(piece.reads) if leaf.active]
    paths = [len(piece.reads) + i for i in path_active]
    slots = [*reads, *paths]
    moving = list(moving)

    def both(*values):
        inputs, rest = list(values[: len(avals)]), list(values[len(avals) :])
        cotangents, extra = rest[: len(moving)], rest[len(moving) :]

        def run(*active):
            full = list(inputs)
            for slot, value in zip(slots, active):
                full[slot] = value
            outputs = piece(*full)
            return [outputs[i] for i in moving], outputs

        _, pull, outputs = jax.vjp(run, *(inputs[s] for s in slots), has_aux=True)
        back = list(pull(list(cotangents)))
        if bound is not None:
            back[len(reads) :] = bound(back[len(reads) :], outputs, *extra)
        return [*outputs, *back]

    shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in piece.outputs]
    tail = [shapes[i] for i in moving]
    extra = [] if bound is None else [jax.ShapeDtypeStruct((), tail[0].dtype)]
    closed = jax.make_jaxpr(both)(*avals, *tail, *extra)
    lanes = _lanes(piece, path_avals, own_path, len(tail) + len(extra))
    program = flatten(closed, lanes)
    return Joint(piece, program, len(shapes), moving, reads, [s - len(piece.reads) for s in paths])


def _lanes(piece: Piece, path_avals, own_path: bool, tail: int) -> list[bool]:
    return [False] * len(piece.reads) + [own_path] * (len(path_avals) + tail)
