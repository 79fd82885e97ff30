"""Reading at positions known only while running: gather and dynamic slices."""

from collections.abc import Iterator

import numpy as np

from ..emit.code import Code
from ..emit.module import Ref
from ..emit.values import EmittedValues
from ..program.program import Op, ProgramValue
from .positions import clamped, limit, plus, read_run, window_start


def _dynamic_slice(values: EmittedValues, op: Op) -> None:
    x, *starts = op.inputs
    out = op.outputs[0]
    limit(op, out)
    window = op.params["slice_sizes"]
    first = [clamped(values, s, n - w) for s, n, w in zip(starts, x.shape, window)]
    along = len(x.shape) - 1 if x.shape else None
    _read_all(values, op, x, along, ((p, first, p, None) for p in _starts(out.shape, along)))


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

    # Neighbours of the array are neighbours of the result along this axis.
    inner = x.shape and window_dims[-1:] == [len(x.shape) - 1]
    along = numbers.offset_dims[-1] if inner else None

    def moves() -> Iterator:
        for position in _starts(out.shape, along):
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

    _read_all(values, op, x, along, moves(), fill)


def _starts(shape: tuple[int, ...], along: int | None) -> Iterator[tuple[int, ...]]:
    """The first position of every run along an axis; all positions where there is none."""
    return np.ndindex(*(1 if d == along else size for d, size in enumerate(shape)))


def _read_all(
    values: EmittedValues, op: Op, x: ProgramValue, along: int | None, moves, fill=None
) -> None:
    out, code = op.outputs[0], values.code
    refs = np.empty(out.shape, object)
    count = 1 if along is None else out.shape[along]
    for position, first, window, valid in moves:
        if valid is False:
            run = [_filler(code, out, fill)] * count
        else:
            run = read_run(values, x, [plus(code, s, w) for s, w in zip(first, window)], count)
            if valid is not None:
                run = [code.select(valid, ref, _filler(code, out, fill)) for ref in run]
        for k, ref in enumerate(run):
            refs[position if along is None else (*position[:along], k, *position[along + 1 :])] = (
                ref
            )
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
