"""Converts a jaxpr, which is nested, to a `Program`, which is not.

Calls are inlined, short loops unrolled, branches evaluated on both sides and selected, and
arithmetic on constants done at once. A piece and its transpose are one program: their joint trace
is one jaxpr, so that the compiler, not JAX, decides which numbers are stored and which are computed
again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from .. import Unsupported
from ..jax_private import arguments_of_scan, called, is_literal, line_of, searched_side
from . import folding
from .cut import BARRIER, Piece
from .program import Op, Program, ProgramValue, constant, supported

UNROLL = 64  # longest inner loop that is written out
LARGEST = 20_000  # most operations in one program


def flatten(closed, path: list[bool]) -> Program:
    """A closed jaxpr as a program; `path`: which inputs differ between paths."""
    jaxpr = closed.jaxpr
    inputs = [
        ProgramValue(v.aval.shape, np.dtype(v.aval.dtype), p) for v, p in zip(jaxpr.invars, path)
    ]
    builder = Flattener()
    outputs = builder.run(jaxpr, [constant(c) for c in closed.consts], inputs)
    return Program(inputs, builder.ops, outputs)


IDENTITIES = {"copy", "copy_p", "stop_gradient"}


class Flattener:
    """The operations so far, and the line of user code that comes next."""

    def __init__(self):
        self.ops: list[Op] = []
        self.line = ""  # of the call whose equations these are, as those may know none

    def run(
        self, jaxpr, consts: list[ProgramValue], inputs: list[ProgramValue]
    ) -> list[ProgramValue]:
        env: dict[Any, ProgramValue] = dict(zip(jaxpr.constvars, consts))
        env.update(zip(jaxpr.invars, inputs))

        def read(atom) -> ProgramValue:
            if is_literal(atom):
                return constant(np.asarray(atom.val, atom.aval.dtype))  # pyright: ignore
            return env[atom]

        for eqn in jaxpr.eqns:
            outputs = self.equation(eqn, [read(a) for a in eqn.invars])
            env.update(zip(eqn.outvars, outputs))
        return [read(a) for a in jaxpr.outvars]

    def equation(self, eqn, inputs: list[ProgramValue]) -> list[ProgramValue]:
        caller, self.line = self.line, line_of(eqn) or self.line
        outputs = self.operation(eqn, inputs, self.line)
        self.line = caller
        return outputs

    def operation(self, eqn, inputs: list[ProgramValue], line: str) -> list[ProgramValue]:
        name = eqn.primitive.name
        inner = called(eqn)
        if inner is not None:
            return self.inline(inner, inputs)
        if name in IDENTITIES:
            return inputs
        if name == BARRIER:
            return [self.unknown(v, line) for v in inputs]
        if name == "scan":
            return self.scan(eqn, inputs, line)
        if name == "cond":
            return self.branches(eqn, inputs, line)
        if name == "while":
            raise Unsupported(f"while: loops of unknown length, at {line}")
        if len(self.ops) > LARGEST:
            raise Unsupported(f"{name}: more than {LARGEST} operations in one step, at {line}")
        side, avals = searched_side(eqn), [v.aval for v in eqn.outvars]
        if side is not None:
            return self.add("searchsorted", inputs, avals, {"side": side}, line)
        return self.add(name, inputs, avals, eqn.params, line)

    def add(self, name, inputs, avals, params, line="") -> list[ProgramValue]:
        """Appends an operation, or folds it if all its inputs are constants."""
        if any(not supported(a.dtype) for a in avals):
            raise Unsupported(f"{name}: numbers of type {avals[0].dtype}, at {line}")
        inputs = [v if v.size else constant(np.zeros(v.shape, v.dtype)) for v in inputs]
        if name == "concatenate":
            inputs = [v for v in inputs if v.size] or inputs
        folded = folding.fold(name, params, [v.constant for v in inputs], avals)
        if folded is not None:
            return [constant(a) for a in folded]
        if any(v.size == 0 for v in inputs):
            written = inputs[-1] if name.startswith("scatter") else inputs[min(1, len(inputs) - 1)]
            if name.startswith(("scatter", "dynamic_update")) and not written.size:
                return inputs[:1]
            # Indices without elements choose the whole array.
            if not name.startswith(("scatter", "gather")) or not inputs[0].size:
                raise Unsupported(f"{name}: an array without elements, at {line}")
        path = any(v.path for v in inputs)
        outputs = [ProgramValue(a.shape, np.dtype(a.dtype), path) for a in avals]
        self.ops.append(Op(name, list(inputs), outputs, dict(params), line))
        return outputs

    def unknown(self, value: ProgramValue, line: str) -> ProgramValue:
        """The value, as one that cannot be folded."""
        if value.constant is None:
            return value
        return self.add(BARRIER, [value], [ProgramValue(value.shape, value.dtype)], {}, line)[0]

    def inline(self, inner, inputs: list[ProgramValue]) -> list[ProgramValue]:
        jaxpr, consts = (inner.jaxpr, inner.consts) if hasattr(inner, "consts") else (inner, [])
        return self.run(jaxpr, [constant(c) for c in consts], inputs)

    def branches(self, eqn, inputs: list[ProgramValue], line: str) -> list[ProgramValue]:
        """`cond` and `switch`: every branch, then a selection."""
        index, *rest = inputs
        branches = eqn.params["branches"]
        if index.constant is not None:
            selected = int(np.clip(int(index.constant), 0, len(branches) - 1))
            return self.inline(branches[selected], rest)
        outcomes = [self.inline(b, rest) for b in branches]
        if index.dtype != np.bool_:
            low, high = constant(index.dtype.type(0)), constant(index.dtype.type(len(branches) - 1))
            (index,) = self.add("clamp", [low, index, high], [index], {}, line)
        avals = [v.aval for v in eqn.outvars]
        return [
            self.add("select_n", [index, *options], [aval], {}, line)[0]
            for aval, *options in zip(avals, *outcomes)
        ]

    def scan(self, eqn, inputs: list[ProgramValue], line: str) -> list[ProgramValue]:
        """An inner `scan` or `fori_loop`, written out."""
        p = eqn.params
        length, (consts, carries) = p["length"], arguments_of_scan(p)
        if length > UNROLL:
            raise Unsupported(f"scan: {length} inner steps (at most {UNROLL}), at {line}")
        fixed, carry, xs = (
            inputs[:consts],
            inputs[consts : consts + carries],
            inputs[consts + carries :],
        )
        body = p["jaxpr"]
        order = range(length - 1, -1, -1) if p["reverse"] else range(length)
        rows: dict[int, list[ProgramValue]] = {}
        for i in order:
            now = [self.row(x, i, line) for x in xs]
            outputs = self.inline(body, [*fixed, *carry, *now])
            carry, rows[i] = outputs[:carries], outputs[carries:]
        stacked = [
            self.stack([rows[i][j] for i in range(length)], v.aval, line)
            for j, v in enumerate(eqn.outvars[carries:])
        ]
        return [*carry, *stacked]

    def row(self, x: ProgramValue, i: int, line: str) -> ProgramValue:
        shape = (1, *x.shape[1:])
        starts = (i, *(0,) * (len(x.shape) - 1))
        limits = (i + 1, *x.shape[1:])
        params = {"start_indices": starts, "limit_indices": limits, "strides": None}
        (part,) = self.add("slice", [x], [ProgramValue(shape, x.dtype)], params, line)
        out = ProgramValue(x.shape[1:], x.dtype)
        return self.add("squeeze", [part], [out], {"dimensions": (0,)}, line)[0]

    def stack(self, rows: list[ProgramValue], aval, line: str) -> ProgramValue:
        if not rows:
            return constant(np.zeros(aval.shape, aval.dtype))
        return self.add("stack", rows, [aval], {"axis": 0}, line)[0]


@dataclass(eq=False)
class Joint:
    """A piece and its transpose as one program.

    The inputs are the piece's reads, then the numbers of the path, then the cotangents of the
    `moving` outputs. The outputs are those of the piece, then the cotangents of active reads, then
    those of active path inputs.
    """

    piece: Piece
    program: Program
    outputs: int
    cotangents: list[int]
    read_slots: list[int]
    path_slots: list[int]


def forward(piece: Piece, path_avals: Sequence[Any] = (), own_path: bool = True) -> Program:
    """A piece without its transpose, for values."""
    avals = [leaf.aval for leaf in piece.reads] + list(path_avals)
    closed = jax.make_jaxpr(piece)(*avals)
    return flatten(closed, _lanes(piece, path_avals, own_path, 0))


def joint(
    piece: Piece,
    moving: Sequence[int],
    path_avals: Sequence[Any] = (),
    path_active: Sequence[int] = (),
    clip: Callable | None = None,
    own_path: bool = True,
) -> Joint:
    """Traces a piece with its transpose; `moving` are the outputs that have cotangents.

    `clip` maps the cotangents of the active path inputs to clipped ones, given the outputs and two
    numbers per path.
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
        if clip is not None:
            back[len(reads) :] = clip(back[len(reads) :], outputs, *extra)
        return [*outputs, *back]

    shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in piece.outputs]
    tail = [shapes[i] for i in moving]
    extra = [] if clip is None else [jax.ShapeDtypeStruct((2,), tail[0].dtype)]
    closed = jax.make_jaxpr(both)(*avals, *tail, *extra)
    lanes = _lanes(piece, path_avals, own_path, len(tail) + len(extra))
    program = flatten(closed, lanes)
    return Joint(piece, program, len(shapes), moving, reads, [s - len(piece.reads) for s in paths])


def _lanes(piece: Piece, path_avals, own_path: bool, tail: int) -> list[bool]:
    return [False] * len(piece.reads) + [own_path] * (len(path_avals) + tail)
