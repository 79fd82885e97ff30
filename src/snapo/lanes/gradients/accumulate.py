"""The gradients of a step's own numbers, added up as they come."""

import numpy as np

from ..emit.code import Code
from ..emit.ref import Ref
from ..emit.shared import Shared
from ..emit.storage import ArrayPlace, Small
from ..emit.values import EmittedValues
from ..program.program import BIG
from .across import across, add_row
from .adding import add, add_number
from .rows import Rows


def accumulate(
    values: EmittedValues, rows: Rows, sums: Shared, tape_row: str, chunk_row: str
) -> None:
    """Adds up all that belongs to this step's own numbers."""
    singles: list[tuple[ArrayPlace, Ref]] = []
    for g in rows.gradients.items:
        if sums.of_call(g.leaf):
            continue
        target = sums.address(g.leaf)
        for t in g.terms:
            rows.product(values.code, t, target, tape_row, chunk_row, "1")
        for value in g.rest:
            available = values.held(value)
            if value.size <= BIG and isinstance(available, Small):
                singles += [(target.at(p), available.items[p]) for p in np.ndindex(*value.shape)]
            else:
                add(values, value, target)
    add_together(
        values.code, [(location, x) for location, x in singles if x.lanes == values.code.lanes]
    )
    for position, x in singles:
        if x.lanes != values.code.lanes:
            add_number(values.code, position, [], x)


def add_together(code: Code, singles: list[tuple[ArrayPlace, Ref]]) -> None:
    """Adds sums over lanes to float64 memory: a register's lanes of one become lanes of many."""
    singles = sorted(singles, key=lambda pair: (pair[0].base, pair[0].offset))
    if not singles:
        return
    width = code.module.register // np.dtype(singles[0][1].dtype).itemsize
    for start in range(0, len(singles), width):
        group = singles[start : start + width]
        vectors = []
        for _, x in group:
            parts = [code.part(x, k, width) for k in range(x.lanes // width)]
            while len(parts) > 1:
                parts = [code.op("fadd", *parts[k : k + 2]) for k in range(0, len(parts), 2)]
            vectors += parts
        (sums,) = across(code, vectors, width)
        for first, count in _neighbours([location for location, _ in group]):
            position = group[first][0]
            add_row(
                code,
                code.pointer(position.base, position.offset),
                sums,
                range(first, first + count),
            )


def _neighbours(positions: list[ArrayPlace]) -> list[tuple[int, int]]:
    """(first, how many) of numbers that lie side by side in memory."""
    runs = [[0, 1]]
    for i in range(1, len(positions)):
        before, position = positions[i - 1], positions[i]
        if position.base == before.base and position.offset == before.offset + position.unit:
            runs[-1][1] += 1
        else:
            runs.append([i, 1])
    return [(first, count) for first, count in runs]
