"""Primitives that rearrange arrays: views if that is possible, else copies."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .. import Unsupported
from ..emit.storage import ArrayPlace, Small, row_major
from ..emit.values import EmittedValues
from ..program import folding
from ..program.program import BIG, Op, ProgramValue

Rule = Callable[[EmittedValues, Op], None]


def rearranged(
    small: Callable[[Op, np.ndarray], np.ndarray],
    strided: Callable[[Op, ArrayPlace], ArrayPlace | None],
) -> Rule:
    """A rule from a function of NumPy arrays and one of places (None if no view exists)."""

    def rule(values: EmittedValues, op: Op) -> None:
        available = values.get(op.inputs[0])
        if isinstance(available, ArrayPlace):
            view = strided(op, available)
            if view is not None:
                values.bind(op.outputs[0], view)
                return
            moved = values.workspace.allocate(available.shape, available.dtype, available.lanes)
            values.copy(op.inputs[0], moved)
            view = strided(op, moved)
            assert view is not None
            values.bind(op.outputs[0], view)
            return
        assert isinstance(available, Small)
        values.set(op.outputs[0], small(op, available.items))

    return rule


def _broadcast(op: Op, items: np.ndarray) -> np.ndarray:
    return folding.broadcast(items, op.params["shape"], op.params["broadcast_dimensions"])


def _broadcast_place(op: Op, position: ArrayPlace) -> ArrayPlace:
    shape, dims = op.params["shape"], op.params["broadcast_dimensions"]
    strides = [0] * len(shape)
    for axis, size, stride in zip(dims, position.shape, position.strides):
        strides[axis] = stride if size == shape[axis] else 0
    return replace(position, shape=tuple(shape), strides=tuple(strides))


def _reshape(op: Op, items: np.ndarray) -> np.ndarray:
    return items.reshape(op.outputs[0].shape)


def _reshape_place(op: Op, position: ArrayPlace) -> ArrayPlace | None:
    """A view, unless the elements do not lie in order."""
    shape = op.outputs[0].shape
    if position.contiguous:
        return replace(position, shape=shape, strides=row_major(shape))
    selected = [(n, s) for n, s in zip(position.shape, position.strides) if n != 1]
    if [n for n, _ in selected] == [n for n in shape if n != 1]:
        rest = iter(selected)
        return replace(
            position, shape=shape, strides=tuple(0 if n == 1 else next(rest)[1] for n in shape)
        )
    return None


def _transpose_place(op: Op, position: ArrayPlace) -> ArrayPlace:
    order = op.params["permutation"]
    return replace(
        position,
        shape=tuple(position.shape[i] for i in order),
        strides=tuple(position.strides[i] for i in order),
    )


def _slice_place(op: Op, position: ArrayPlace) -> ArrayPlace:
    return sliced(
        position, [(s.start, s.step) for s in folding.slices(op.params)], op.outputs[0].shape
    )


def sliced(position: ArrayPlace, starts, shape) -> ArrayPlace:
    """The view from `starts` = (start, step) along every axis."""
    offset = sum(int(start) * stride for (start, _), stride in zip(starts, position.strides))
    strides = tuple(stride * step for (_, step), stride in zip(starts, position.strides))
    return replace(
        position,
        offset=position.offset + offset * position.unit,
        shape=tuple(shape),
        strides=strides,
    )


def _reverse_place(op: Op, position: ArrayPlace) -> ArrayPlace:
    axes = op.params["dimensions"]
    starts = [(n - 1, -1) if i in axes else (0, 1) for i, n in enumerate(position.shape)]
    return sliced(position, starts, position.shape)


def _concatenate(values: EmittedValues, op: Op) -> None:
    axis = op.params["dimension"]
    segments = [(v, v.shape[axis]) for v in op.inputs]
    _join(values, op, axis, segments)


def _stack(values: EmittedValues, op: Op) -> None:
    """`stack` along a new axis."""
    axis, out = op.params["axis"], op.outputs[0]
    if out.size <= BIG or (all(v.size == 1 for v in op.inputs) and out.size <= 4 * BIG):
        values.set(out, np.stack([values.small(v) for v in op.inputs], axis))
        return
    target = values.target(out)
    for i, v in enumerate(op.inputs):
        starts = [(i if a == axis else 0, 1) for a in range(len(out.shape))]
        shape = [n for a, n in enumerate(out.shape) if a != axis]
        part = sliced(target, starts, out.shape)
        strides = tuple(s for a, s in enumerate(part.strides) if a != axis)
        values.copy(v, replace(part, shape=tuple(shape), strides=strides))
    values.bind(out, target)


def _join(values: EmittedValues, op: Op, axis: int, segments) -> None:
    out = op.outputs[0]
    if out.size <= BIG:
        values.set(out, np.concatenate([values.small(v) for v, _ in segments], axis))
        return
    target, start = values.target(out), 0
    for v, size in segments:
        starts = [(start if a == axis else 0, 1) for a in range(len(out.shape))]
        values.copy(v, sliced(target, starts, v.shape))
        start += size
    values.bind(out, target)


def _pad(values: EmittedValues, op: Op) -> None:
    x, filler = op.inputs
    config, out = op.params["padding_config"], op.outputs[0]
    if any(low < 0 or high < 0 for low, high, _ in config):
        x, config = _cropped(values, op, x, config)
    fill = values.small(filler)[()]
    inner = tuple(
        slice(low, low + (n - 1) * (gap + 1) + 1 if n else low, gap + 1)
        for (low, _, gap), n in zip(config, x.shape)
    )
    if out.size <= BIG:
        items = np.empty(out.shape, object)
        items[...] = fill
        items[inner] = values.small(x)
        values.set(out, items)
        return
    target = values.target(out)
    complete = ProgramValue(out.shape, out.dtype, out.path)
    single = np.empty((1,) * len(out.shape), object)
    single[...] = fill
    values.set(complete, np.broadcast_to(single, out.shape))
    values.copy(complete, target)
    values.copy(x, sliced(target, [(s.start, s.step) for s in inner], x.shape))
    values.bind(out, target)


def _cropped(values: EmittedValues, op: Op, x: ProgramValue, config):
    """Negative padding takes elements away: from the input, if no gaps are put between them."""
    if any(gap and (low < 0 or high < 0) for low, high, gap in config):
        raise Unsupported(f"pad: negative padding with gaps, at {op.where}")
    limits = [
        (max(0, -int(low)), n - max(0, -int(high))) for (low, high, _), n in zip(config, x.shape)
    ]
    shape = tuple(stop - start for start, stop in limits)
    part = ProgramValue(shape, x.dtype, x.path)
    available = values.get(x)
    if isinstance(available, ArrayPlace):
        values.bind(part, sliced(available, [(start, 1) for start, _ in limits], shape))
    else:
        values.set(part, available.items[tuple(slice(*limit) for limit in limits)])
    return part, [(max(0, int(low)), max(0, int(high)), gap) for low, high, gap in config]


def _tile(values: EmittedValues, op: Op) -> None:
    """An array side by side with itself."""
    (x,), out, reps = op.inputs, op.outputs[0], op.params["reps"]
    if out.size <= BIG:
        values.set(out, np.tile(values.small(x), reps))
        return
    target = values.target(out)
    for corner in np.ndindex(*reps):
        starts = [(i * n, 1) for i, n in zip(corner, x.shape)]
        values.copy(x, sliced(target, starts, x.shape))
    values.bind(out, target)


def _split(values: EmittedValues, op: Op) -> None:
    axis, start = op.params["axis"], 0
    available = values.get(op.inputs[0])
    for out in op.outputs:
        size = out.shape[axis]
        if isinstance(available, ArrayPlace):
            starts = [(start if a == axis else 0, 1) for a in range(len(out.shape))]
            values.bind(out, sliced(available, starts, out.shape))
        else:
            values.set(out, available.items.take(range(start, start + size), axis))
        start += size


def _unstack(values: EmittedValues, op: Op) -> None:
    axis = op.params["axis"]
    available = values.get(op.inputs[0])
    for i, out in enumerate(op.outputs):
        if isinstance(available, ArrayPlace):
            starts = [(i if a == axis else 0, 1) for a in range(len(available.shape))]
            part = sliced(available, starts, available.shape)
            strides = tuple(s for a, s in enumerate(part.strides) if a != axis)
            values.bind(out, replace(part, shape=out.shape, strides=strides))
        else:
            values.set(out, available.items.take(i, axis))


RULES: dict[str, Rule] = {
    "broadcast_in_dim": rearranged(_broadcast, _broadcast_place),
    "reshape": rearranged(_reshape, _reshape_place),
    "squeeze": rearranged(_reshape, _reshape_place),
    "expand_dims": rearranged(_reshape, _reshape_place),
    "transpose": rearranged(lambda op, x: x.transpose(op.params["permutation"]), _transpose_place),
    "slice": rearranged(lambda op, x: x[folding.slices(op.params)], _slice_place),
    "rev": rearranged(lambda op, x: np.flip(x, op.params["dimensions"]), _reverse_place),
    "concatenate": _concatenate,
    "stack": _stack,
    "pad": _pad,
    "tile": _tile,
    "split": _split,
    "unstack": _unstack,
}
