"""Reading at positions known only while running: gather and dynamic slices."""

from collections.abc import Iterator

import numpy as np

from ..emit.code import Code
from ..emit.module import Ref
from ..emit.values import EmittedValues
from ..program.program import Op, ProgramValue
from .positions import clamped, limit, plus, read, window_start
from .table_rows import copy_rows, together


def _dynamic_slice(values: EmittedValues, op: Op) -> None:
    x, *starts = op.inputs
    out = op.outputs[0]
    limit(op, out)
    window = op.params["slice_sizes"]
    first = [clamped(values, s, n - w) for s, n, w in zip(starts, x.shape, window)]

    def moves(shape: tuple[int, ...]) -> Iterator:
        return ((position, first, position, None) for position in np.ndindex(*shape))

    moving = [d for d, start in enumerate(first) if isinstance(start, Ref)]
    if together(values, x, out, moving):
        _copy(values, x, out, moves)
    else:
        _read_all(values, op, x, moves(out.shape))


def _gather(values: EmittedValues, op: Op) -> None:
    x, indices = op.inputs
    out = op.outputs[0]
    limit(op, out)
    p = op.params
    numbers, sizes = p["dimension_numbers"], p["slice_sizes"]
    mode = str(p["mode"])
    fill = p.get("fill_value")
    window_dims = [
        d for d in range(len(x.shape))
        if d not in numbers.collapsed_slice_dims and d not in numbers.operand_batching_dims
    ]  # fmt: skip
    batch_dims = [d for d in range(len(out.shape)) if d not in numbers.offset_dims]

    def moves(shape: tuple[int, ...]) -> Iterator:
        for position in np.ndindex(*shape):
            batch = tuple(position[d] for d in batch_dims)
            window = [0] * len(x.shape)
            for d, o in zip(window_dims, numbers.offset_dims):
                window[d] = position[o]
            first, valid = window_start(
                values, x, indices, batch, numbers.start_index_map, sizes, "FILL" in mode
            )
            for d, b in zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims):
                first[d] = batch[b]
            yield position, first, window, valid

    # Neighbours of the result are neighbours in the array.
    inner = window_dims[-1:] == [len(x.shape) - 1] and batch_dims[-1:] != [len(out.shape) - 1]
    moving = [d for d in numbers.start_index_map if x.shape[d] > sizes[d]]
    if inner and "FILL" not in mode and together(values, x, out, moving):
        _copy(values, x, out, moves)
    else:
        _read_all(values, op, x, moves(out.shape), fill)


def _copy(values: EmittedValues, x: ProgramValue, out: ProgramValue, moves) -> None:
    """Copies the result row by row; `moves`: for all positions of a shape, what is read there."""
    code, table, target = values.code, values.in_memory(x), values.target(out)
    for position, first, window, _ in moves((*out.shape[:-1], 1)):
        start = [plus(code, s, w) for s, w in zip(first, window)]
        copy_rows(code, table, start, out.shape[-1], target.address(code, position))
    values.bind(out, target)


def _read_all(values: EmittedValues, op: Op, x: ProgramValue, moves, fill=None) -> None:
    out, code = op.outputs[0], values.code
    refs = np.empty(out.shape, object)
    for position, first, window, valid in moves:
        if valid is False:
            refs[position] = _filler(code, out, fill)
            continue
        ref = read(values, x, [plus(code, s, w) for s, w in zip(first, window)])
        refs[position] = ref if valid is None else code.select(valid, ref, _filler(code, out, fill))
    values.set(out, refs)


def _filler(code: Code, out: ProgramValue, fill) -> Ref:
    """XLA's number for an index out of range: NaN, or the extreme of an integer type."""
    if fill is None:
        kind = out.dtype.kind
        fill = np.nan if kind == "f" else True if kind == "b" else None
        if fill is None:
            info = np.iinfo(out.dtype)
            fill = info.max if kind == "u" else info.min
    return code.constant(fill, out.dtype)


RULES = {"dynamic_slice": _dynamic_slice, "gather": _gather}
