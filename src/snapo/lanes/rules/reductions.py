"""Primitives that reduce arrays or accumulate along an axis."""

import math
from dataclasses import replace

import numpy as np

from .. import Unsupported
from ..emit.module import Ref
from ..emit.storage import ArrayPlace, Small
from ..emit.values import EmittedValues, nest
from ..program.program import BIG, Op, ProgramValue
from . import elementwise

REDUCERS = {
    "reduce_sum": "add",
    "reduce_prod": "mul",
    "reduce_max": "max",
    "reduce_min": "min",
    "reduce_and": "and",
    "reduce_or": "or",
    "reduce_xor": "xor",
}


def _combine(
    values: EmittedValues, name: str, like: ProgramValue, a: Ref, b: Ref, where: str
) -> Ref:
    return elementwise.apply(
        values.code, Op(name, [], [ProgramValue((), like.dtype)], {}, where), [a, b]
    )


def _reduce(values: EmittedValues, op: Op) -> None:
    """Sums, products and extremes over axes."""
    name = REDUCERS[op.name]
    x, out = op.inputs[0], op.outputs[0]
    axes = tuple(op.params["axes"])
    selected = [i for i in range(len(x.shape)) if i not in axes]
    count = math.prod([x.shape[i] for i in axes])
    if count == 0:
        raise Unsupported(f"{op.name}: a reduction over no elements, at {op.where}")
    # Up to 4 * BIG numbers any reader may have brought an array into registers: the order of a sum
    # must not depend on that.
    if x.size <= 4 * BIG or isinstance(values.get(x), Small):
        items = values.small(x).transpose([*selected, *axes]).reshape(-1, count)
        refs = [_fold(values, name, x, list(row), op.where) for row in items]
        values.set(out, np.array([*refs, None], object)[:-1].reshape(out.shape))
        return
    available = values.in_memory(x)
    order = [*selected, *axes]
    view = replace(
        available,
        shape=tuple(x.shape[i] for i in order),
        strides=tuple(available.strides[i] for i in order),
    )
    if out.size <= BIG:
        refs = []
        for p in np.ndindex(*out.shape):
            refs.append(
                _accumulate(values, name, x, view, list(map(int, p)), len(selected), op.where)
            )
        values.set(out, np.array([*refs, None], object)[:-1].reshape(out.shape))
        return
    target = values.target(out)
    with nest(values.code, out.shape, [replace(view, shape=())]) as position:
        target.write(
            values.code,
            position,
            _accumulate(values, name, x, view, position, len(selected), op.where),
        )
    values.bind(out, target)


def _fold(values: EmittedValues, name: str, like: ProgramValue, refs: list[Ref], where: str) -> Ref:
    """Pairwise, so that a sum's error grows with the logarithm of its length."""
    while len(refs) > 1:
        pairs = [_combine(values, name, like, a, b, where) for a, b in zip(refs[::2], refs[1::2])]
        refs = pairs + ([refs[-1]] if len(refs) % 2 else [])
    return refs[0]


def _accumulate(
    values: EmittedValues,
    name,
    like: ProgramValue,
    view: ArrayPlace,
    position,
    selected: int,
    where: str,
) -> Ref:
    """One output element: a loop over the reduced axes, taken as one where they lie in order."""
    code = values.code
    inner = view.shape[selected:]
    strides = view.strides[selected:]
    if len(inner) > 1 and any(s != n * t for s, n, t in zip(strides, inner[1:], strides[1:])):
        outer = [
            _accumulate(values, name, like, view, [*position, i], selected + 1, where)
            for i in range(inner[0])
        ]
        return _fold(values, name, like, outer, where)
    count = math.prod(inner)
    base = replace(
        view, shape=(*view.shape[:selected], count), strides=(*view.strides[:selected], strides[-1])
    )
    first = base.read(code, [*position, 0])
    if count == 1:
        return first
    with code.loop(count, (first,), first=1) as loop:
        loop.results = [
            _combine(
                values, name, like, loop.carried[0], base.read(code, [*position, loop.i]), where
            )
        ]
    return loop.results[0]


CUMULATIVE = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}


def _cumulative(values: EmittedValues, op: Op) -> None:
    """Running sums, products and extremes, one element after another."""
    axis, x, out = op.params["axis"], op.inputs[0], op.outputs[0]
    if x.size > 8 * BIG:
        raise Unsupported(f"{op.name}: {x.size} numbers (at most {8 * BIG}), at {op.where}")
    items = np.moveaxis(values.small(x), axis, 0)
    items = items[::-1] if op.params["reverse"] else items
    result = np.empty(items.shape, object)
    for i in range(len(items)):
        for p in np.ndindex(*items.shape[1:]):
            here = items[(i, *p)]
            before = result[(i - 1, *p)] if i else None
            name = CUMULATIVE[op.name]
            result[(i, *p)] = (
                here if before is None else _combine(values, name, x, before, here, op.where)
            )
    result = result[::-1] if op.params["reverse"] else result
    values.set(out, np.moveaxis(result, 0, axis))


RULES = {**dict.fromkeys(REDUCERS, _reduce), **dict.fromkeys(CUMULATIVE, _cumulative)}
