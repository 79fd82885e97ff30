"""Primitives that rearrange, reduce or accumulate arrays."""

import math
from dataclasses import replace

import numpy as np

from . import elementwise, indexing, sorting
from .code import Ref
from .passes import BIG
from .program import Op, Unsupported, Value
from .storage import Place, Small, row_major


def rearranged(small, strided):
    """A rule from a function of NumPy arrays and one of places."""

    def rule(body, op: Op) -> None:
        known = body.get(op.inputs[0])
        if isinstance(known, Place):
            view = strided(op, known)
            if view is not None:
                body.where[op.outputs[0]] = view
                return
            moved = body.workspace.allocate(known.shape, known.dtype, known.lanes)
            body.copy(op.inputs[0], moved)
            body.where[op.outputs[0]] = strided(op, moved)
            return
        assert isinstance(known, Small)
        body.set(op.outputs[0], small(op, known.items))

    return rule


def _broadcast(op: Op, items: np.ndarray) -> np.ndarray:
    shape, dims = op.params["shape"], op.params["broadcast_dimensions"]
    expanded = [1] * len(shape)
    for axis, size in zip(dims, items.shape):
        expanded[axis] = size
    return np.broadcast_to(items.reshape(expanded), shape)


def _broadcast_place(op: Op, place: Place) -> Place:
    shape, dims = op.params["shape"], op.params["broadcast_dimensions"]
    strides = [0] * len(shape)
    for axis, size, stride in zip(dims, place.shape, place.strides):
        strides[axis] = stride if size == shape[axis] else 0
    return replace(place, shape=tuple(shape), strides=tuple(strides))


def _reshape(op: Op, items: np.ndarray) -> np.ndarray:
    return items.reshape(op.outputs[0].shape)


def _reshape_place(op: Op, place: Place) -> Place | None:
    """A view, unless the elements do not lie in order."""
    shape = op.outputs[0].shape
    if place.contiguous:
        return replace(place, shape=shape, strides=row_major(shape))
    kept = [(n, s) for n, s in zip(place.shape, place.strides) if n != 1]
    if [n for n, _ in kept] == [n for n in shape if n != 1]:
        rest = iter(kept)
        return replace(
            place, shape=shape, strides=tuple(0 if n == 1 else next(rest)[1] for n in shape)
        )
    return None


def _transpose_place(op: Op, place: Place) -> Place:
    order = op.params["permutation"]
    return replace(
        place,
        shape=tuple(place.shape[i] for i in order),
        strides=tuple(place.strides[i] for i in order),
    )


def _slices(op: Op) -> list[slice]:
    p = op.params
    strides = p["strides"] or (1,) * len(p["start_indices"])
    return [slice(*s) for s in zip(p["start_indices"], p["limit_indices"], strides)]


def _slice_place(op: Op, place: Place) -> Place:
    return sliced(place, [(s.start, s.step) for s in _slices(op)], op.outputs[0].shape)


def sliced(place: Place, starts, shape) -> Place:
    """The view from `starts` = (start, step) along every axis."""
    offset = sum(int(start) * stride for (start, _), stride in zip(starts, place.strides))
    strides = tuple(stride * step for (_, step), stride in zip(starts, place.strides))
    return replace(
        place, offset=place.offset + offset * place.unit, shape=tuple(shape), strides=strides
    )


def _reverse_place(op: Op, place: Place) -> Place:
    axes = op.params["dimensions"]
    starts = [(n - 1, -1) if i in axes else (0, 1) for i, n in enumerate(place.shape)]
    return sliced(place, starts, place.shape)


def _concatenate(body, op: Op) -> None:
    axis = op.params["dimension"]
    pieces = [(v, v.shape[axis]) for v in op.inputs]
    _join(body, op, axis, pieces)


def _stack(body, op: Op) -> None:
    """`stack` along a new axis."""
    axis, out = op.params["axis"], op.outputs[0]
    if out.size <= BIG or (all(v.size == 1 for v in op.inputs) and out.size <= 4 * BIG):
        body.set(out, np.stack([body.small(v) for v in op.inputs], axis))
        return
    target = body.target(out)
    for i, v in enumerate(op.inputs):
        starts = [(i if a == axis else 0, 1) for a in range(len(out.shape))]
        shape = [n for a, n in enumerate(out.shape) if a != axis]
        part = sliced(target, starts, out.shape)
        strides = tuple(s for a, s in enumerate(part.strides) if a != axis)
        body.copy(v, replace(part, shape=tuple(shape), strides=strides))
    body.where[out] = target


def _join(body, op: Op, axis: int, pieces) -> None:
    out = op.outputs[0]
    if out.size <= BIG:
        body.set(out, np.concatenate([body.small(v) for v, _ in pieces], axis))
        return
    target, start = body.target(out), 0
    for v, size in pieces:
        starts = [(start if a == axis else 0, 1) for a in range(len(out.shape))]
        body.copy(v, sliced(target, starts, v.shape))
        start += size
    body.where[out] = target


def _pad(body, op: Op) -> None:
    x, filler = op.inputs
    config, out = op.params["padding_config"], op.outputs[0]
    if any(low < 0 or high < 0 for low, high, _ in config):
        x, config = _cropped(body, op, x, config)
    fill = body.small(filler)[()]
    inner = tuple(
        slice(low, low + (n - 1) * (gap + 1) + 1 if n else low, gap + 1)
        for (low, _, gap), n in zip(config, x.shape)
    )
    if out.size <= BIG:
        items = np.empty(out.shape, object)
        items[...] = fill
        items[inner] = body.small(x)
        body.set(out, items)
        return
    target = body.target(out)
    whole = Value(out.shape, out.dtype, out.path)
    single = np.empty((1,) * len(out.shape), object)
    single[...] = fill
    body.set(whole, np.broadcast_to(single, out.shape))
    body.copy(whole, target)
    body.copy(x, sliced(target, [(s.start, s.step) for s in inner], x.shape))
    body.where[out] = target


def _cropped(body, op: Op, x: Value, config):
    """Negative padding takes elements away: from the input, where no gaps are put between them."""
    if any(gap and (low < 0 or high < 0) for low, high, gap in config):
        raise Unsupported(f"pad: negative padding with gaps, at {op.where}")
    limits = [
        (max(0, -int(low)), n - max(0, -int(high))) for (low, high, _), n in zip(config, x.shape)
    ]
    shape = tuple(stop - start for start, stop in limits)
    part = Value(shape, x.dtype, x.path)
    known = body.get(x)
    if isinstance(known, Place):
        body.where[part] = sliced(known, [(start, 1) for start, _ in limits], shape)
    else:
        body.set(part, known.items[tuple(slice(*limit) for limit in limits)])
    return part, [(max(0, int(low)), max(0, int(high)), gap) for low, high, gap in config]


def _tile(body, op: Op) -> None:
    """An array side by side with itself."""
    (x,), out, reps = op.inputs, op.outputs[0], op.params["reps"]
    if out.size <= BIG:
        body.set(out, np.tile(body.small(x), reps))
        return
    target = body.target(out)
    for corner in np.ndindex(*reps):
        starts = [(i * n, 1) for i, n in zip(corner, x.shape)]
        body.copy(x, sliced(target, starts, x.shape))
    body.where[out] = target


def _split(body, op: Op) -> None:
    axis, start = op.params["axis"], 0
    known = body.get(op.inputs[0])
    for out in op.outputs:
        size = out.shape[axis]
        if isinstance(known, Place):
            starts = [(start if a == axis else 0, 1) for a in range(len(out.shape))]
            body.where[out] = sliced(known, starts, out.shape)
        else:
            body.set(out, known.items.take(range(start, start + size), axis))
        start += size


def _unstack(body, op: Op) -> None:
    axis = op.params["axis"]
    known = body.get(op.inputs[0])
    for i, out in enumerate(op.outputs):
        if isinstance(known, Place):
            starts = [(i if a == axis else 0, 1) for a in range(len(known.shape))]
            part = sliced(known, starts, known.shape)
            strides = tuple(s for a, s in enumerate(part.strides) if a != axis)
            body.where[out] = replace(part, shape=out.shape, strides=strides)
        else:
            body.set(out, known.items.take(i, axis))


REDUCERS = {
    "reduce_sum": ("add", 0.0),
    "reduce_prod": ("mul", 1.0),
    "reduce_max": ("max", None),
    "reduce_min": ("min", None),
    "reduce_and": ("and", None),
    "reduce_or": ("or", None),
    "reduce_xor": ("xor", None),
}


def _combine(body, name: str, like: Value, a: Ref, b: Ref, where: str) -> Ref:
    return elementwise.apply(body.code, Op(name, [], [Value((), like.dtype)], {}, where), [a, b])


def _reduce(body, op: Op) -> None:
    """Sums, products and extremes over axes."""
    name, _ = REDUCERS[op.name]
    x, out = op.inputs[0], op.outputs[0]
    axes = tuple(op.params["axes"])
    kept = [i for i in range(len(x.shape)) if i not in axes]
    count = math.prod([x.shape[i] for i in axes])
    if count == 0:
        raise Unsupported(f"{op.name}: over no elements, at {op.where}")
    if x.size <= 2 * BIG or isinstance(body.get(x), Small):
        items = body.small(x).transpose([*kept, *axes]).reshape(-1, count)
        refs = [_fold(body, name, x, list(row), op.where) for row in items]
        body.set(out, np.array([*refs, None], object)[:-1].reshape(out.shape))
        return
    known = body.place(x)
    order = [*kept, *axes]
    view = replace(
        known,
        shape=tuple(x.shape[i] for i in order),
        strides=tuple(known.strides[i] for i in order),
    )
    if out.size <= BIG:
        refs = []
        for p in np.ndindex(*out.shape):
            refs.append(_accumulate(body, name, x, view, list(map(int, p)), len(kept), op.where))
        body.set(out, np.array([*refs, None], object)[:-1].reshape(out.shape))
        return
    from .body import nest

    target = body.target(out)
    with nest(body.code, out.shape, [replace(view, shape=())]) as position:
        target.write(
            body.code, position, _accumulate(body, name, x, view, position, len(kept), op.where)
        )
    body.where[out] = target


def _fold(body, name: str, like: Value, refs: list[Ref], where: str) -> Ref:
    """Pairwise, so that a sum's error grows with the logarithm of its length."""
    while len(refs) > 1:
        pairs = [_combine(body, name, like, a, b, where) for a, b in zip(refs[::2], refs[1::2])]
        refs = pairs + ([refs[-1]] if len(refs) % 2 else [])
    return refs[0]


def _accumulate(body, name, like: Value, view: Place, position, kept: int, where: str) -> Ref:
    """One output element: a loop over the reduced axes, taken as one where they lie in order."""
    code = body.code
    inner = view.shape[kept:]
    strides = view.strides[kept:]
    if len(inner) > 1 and any(s != n * t for s, n, t in zip(strides, inner[1:], strides[1:])):
        outer = [
            _accumulate(body, name, like, view, [*position, i], kept + 1, where)
            for i in range(inner[0])
        ]
        return _fold(body, name, like, outer, where)
    count = math.prod(inner)
    base = replace(
        view, shape=(*view.shape[:kept], count), strides=(*view.strides[:kept], strides[-1])
    )
    first = base.read(code, [*position, 0])
    if count == 1:
        return first
    with code.loop(count, (first,), first=1) as loop:
        loop.results = [
            _combine(body, name, like, loop.carried[0], base.read(code, [*position, loop.i]), where)
        ]
    return loop.results[0]


CUMULATIVE = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}


def _cumulative(body, op: Op) -> None:
    """Running sums, products and extremes, one element after another."""
    axis, x, out = op.params["axis"], op.inputs[0], op.outputs[0]
    if x.size > 8 * BIG:
        raise Unsupported(f"{op.name}: of {x.size} numbers (at most {8 * BIG}), at {op.where}")
    items = np.moveaxis(body.small(x), axis, 0)
    items = items[::-1] if op.params["reverse"] else items
    result = np.empty(items.shape, object)
    for i in range(len(items)):
        for p in np.ndindex(*items.shape[1:]):
            here = items[(i, *p)]
            before = result[(i - 1, *p)] if i else None
            name = CUMULATIVE[op.name]
            result[(i, *p)] = (
                here if before is None else _combine(body, name, x, before, here, op.where)
            )
    result = result[::-1] if op.params["reverse"] else result
    body.set(out, np.moveaxis(result, 0, axis))


RULES = {
    "broadcast_in_dim": rearranged(_broadcast, _broadcast_place),
    "reshape": rearranged(_reshape, _reshape_place),
    "squeeze": rearranged(_reshape, _reshape_place),
    "expand_dims": rearranged(_reshape, _reshape_place),
    "transpose": rearranged(lambda op, x: x.transpose(op.params["permutation"]), _transpose_place),
    "slice": rearranged(lambda op, x: x[tuple(_slices(op))], _slice_place),
    "rev": rearranged(lambda op, x: np.flip(x, op.params["dimensions"]), _reverse_place),
    "concatenate": _concatenate,
    "stack": _stack,
    "pad": _pad,
    "tile": _tile,
    "split": _split,
    "unstack": _unstack,
    **dict.fromkeys(REDUCERS, _reduce),
    **dict.fromkeys(CUMULATIVE, _cumulative),
    **indexing.RULES,
    **sorting.RULES,
}
