"""Order: sorting networks for small arrays, the position of an extreme, sorted tables."""

import numpy as np

from .. import Unsupported
from ..emit.code import Code
from ..emit.module import Ref
from ..emit.values import EmittedValues
from ..program.program import Op
from . import elementwise
from .conversions import compare, convert

LONGEST = 64  # of a sorted axis


def _sort(values: EmittedValues, op: Op) -> None:
    """Sorting by Batcher's merge exchange, which needs fewer comparisons than transposition."""
    axis, keys = op.params["dimension"], op.params["num_keys"]
    length = op.inputs[0].shape[axis]
    if length > LONGEST or op.inputs[0].size > 4 * LONGEST:
        raise Unsupported(f"sort: {length} numbers (at most {LONGEST}), at {op.where}")
    columns = [np.moveaxis(values.small(v), axis, 0).copy() for v in op.inputs]
    code = values.code
    for p in np.ndindex(*columns[0].shape[1:]):
        rows = [[c[(i, *p)] for c in columns] for i in range(length)]
        # Position breaks ties, which makes the network stable.
        rows = [[*row, code.constant(i, np.int32)] for i, row in enumerate(rows)]
        for low, high in merge_exchange(length):
            rows[low], rows[high] = _exchange(code, rows[low], rows[high], keys)
        for i, row in enumerate(rows):
            for c, ref in zip(columns, row):
                c[(i, *p)] = ref
    for out, column in zip(op.outputs, columns):
        values.set(out, np.moveaxis(column, 0, axis))


def merge_exchange(n: int) -> list[tuple[int, int]]:
    """The comparisons of Batcher's network (Knuth, volume 3, algorithm 5.2.2M)."""
    pairs = []
    top = 1 << max(0, (n - 1).bit_length() - 1)
    p = top
    while p > 0:
        q, r, d = top, 0, p
        while d > 0:
            pairs += [(i, i + d) for i in range(n - d) if i & p == r]
            d, q, r = q - p, q >> 1, p
        p >>= 1
    return pairs


def _exchange(code: Code, a: list[Ref], b: list[Ref], keys: int):
    """(a, b) in order: by the keys in turn, then by position."""
    swap = _before(code, b, a, [*range(keys), len(a) - 1])
    low = [code.select(swap, y, x) for x, y in zip(a, b)]
    high = [code.select(swap, x, y) for x, y in zip(a, b)]
    return low, high


def _before(code: Code, a: list[Ref], b: list[Ref], keys: list[int]) -> Ref:
    first, *rest = keys
    less = _less(code, a[first], b[first])
    if not rest:
        return less
    more = _less(code, b[first], a[first])
    true = code.constant(True, "bool")
    tie = code.op("xor", code.op("or", less, more), true)
    return code.op("or", less, code.op("and", tie, _before(code, a, b, rest)))


def _less(code: Code, a: Ref, b: Ref) -> Ref:
    return elementwise.RULES["lt_to"](code, a, b)


def _extreme(values: EmittedValues, op: Op) -> None:
    """`argmax` and `argmin`: the first of equals; a NaN wins."""
    (axis,) = op.params["axes"]
    x, out, code = op.inputs[0], op.outputs[0], values.code
    if x.size > 4 * LONGEST:
        raise Unsupported(f"{op.name}: {x.size} numbers (at most {4 * LONGEST}), at {op.where}")
    items = np.moveaxis(values.small(x), axis, 0)
    result = np.empty(items.shape[1:], object)
    for p in np.ndindex(*items.shape[1:]):
        best, position = items[(0, *p)], code.constant(0, out.dtype)
        for i in range(1, len(items)):
            here = items[(i, *p)]
            better = compare(code, "gt" if op.name == "argmax" else "lt", here, best)
            if here.floating:
                odd = code.compare("uno", here, here)
                sane = code.compare("ord", best, best)
                better = code.op("and", code.op("or", better, odd), sane)
            best = code.select(better, here, best)
            position = code.select(better, code.constant(i, out.dtype), position)
        result[p] = position
    values.set(out, result)


def _search(values: EmittedValues, op: Op) -> None:
    """`jnp.searchsorted` as the number of entries below: no branches, no gathers."""
    table, query = op.inputs
    right = op.params["side"] == "right"
    code, out = values.code, op.outputs[0]
    if table.size > 4 * LONGEST:
        raise Unsupported(
            f"searchsorted: {table.size} entries (at most {4 * LONGEST}), at {op.where}"
        )
    entries, queries = values.small(table), values.small(query)
    result = np.empty(query.shape, object)
    for p in np.ndindex(*query.shape):
        total = code.constant(0, out.dtype)
        for entry in entries:
            # side "right" counts entries <= query, side "left" entries < query.
            counted = elementwise.RULES["le_to" if right else "lt_to"](code, entry, queries[p])
            total = code.add(total, convert(code, counted, out.dtype.name))
        result[p] = total
    values.set(out, result)


RULES = {"sort": _sort, "argmax": _extreme, "argmin": _extreme, "searchsorted": _search}
