"""A piece alone, and a piece with its transpose, as one program each.

The joint trace of a piece and its transpose is one jaxpr, so that the choice
between keeping a number and computing it again is not JAX's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax

from .cut import Piece
from .flatten import flatten
from .program import Program


@dataclass(eq=False)
class Joint:
    """A piece and its transpose as one program.

    Inputs: the piece's reads, then the path's own, then the cotangents of the `moving`
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
