"""The product over steps: a small matrix product in register tiles, as a function of the module."""

import numpy as np

from ..emit.code import Code
from ..emit.module import Module
from .across import across, add_row, pick
from .ranges import ranges

PANEL = 96  # columns of a product that are gone through for all rows before the next ones


def product_function(module: Module, sizes: tuple[int, int], dtype: str, along: bool) -> str:
    """The function that adds sum over s of a[s, i] b[s, j] to a float64 matrix.

    With `along` it also adds the sum of a[s, i] to a vector: one more column, of ones.
    """
    rows, columns = sizes
    name = f"product_{dtype}_{rows}_{columns}{'_along' if along else ''}"
    if not module.first(name):
        return name
    width = min(module.lanes, module.register // np.dtype(dtype).itemsize)
    code = Code(module.lanes, module)
    tile = (4, 3) if module.few else (4, 4)

    def panel(start: str, wide: int) -> None:
        last = along and start == str(columns - wide)

        def tall(i: str, height: int) -> None:
            def block(j: str, breadth: int) -> None:
                at = code.index(f"add nsw i64 {start}, {j}")
                ones = last and j == str(wide + 1 - breadth)
                shape = height, breadth - ones, ones
                _product_tile(code, columns, (i, at), shape, width, dtype)

            ranges(code, wide + last, tile[1], block, apart=last)

        ranges(code, rows, tile[0], tall)

    ranges(code, columns, PANEL, panel, apart=along)
    code.do("ret void")
    header = (
        f"define internal void @{name}(ptr noalias %a, i64 %sa, ptr noalias %b, i64 %sb, "
        "i64 %count, ptr noalias %sum, ptr noalias %along) noinline nounwind"
    )
    code.define(header)
    return name


def _product_tile(code: Code, columns: int, first, shape, width: int, dtype: str) -> None:
    (i, j), (height, breadth, ones) = first, shape
    item = np.dtype(dtype).itemsize
    unit, part = code.lanes * item, width * item
    a = code.pointer("%a", code.index(f"mul nsw i64 {i}, {unit}"))
    b = code.pointer("%b", code.index(f"mul nsw i64 {j}, {unit}"))
    zero = code.constant(0.0, dtype, width)
    with code.loop("%count", (zero,) * (height * (breadth + ones))) as loop:
        p = code.pointer(a, code.index(f"mul nsw i64 {loop.i}, %sa"))
        q = code.pointer(b, code.index(f"mul nsw i64 {loop.i}, %sb"))
        sums = list(loop.carried)
        for v in range(code.lanes // width):
            at = v * part
            x = [code.load(code.pointer(p, r * unit + at), dtype, width) for r in range(height)]
            y = [code.load(code.pointer(q, c * unit + at), dtype, width) for c in range(breadth)]
            pairs = [(x[r], y[c]) for r in range(height) for c in range(breadth)]
            products = [code.fma(*pair, total) for pair, total in zip(pairs, sums)]
            local = [code.op("fadd", one, total) for one, total in zip(x, sums[len(pairs) :])]
            sums = products + local
        loop.results = sums
    totals = across(code, loop.results, width)
    row = code.index(f"mul nsw i64 {i}, {8 * columns}")
    target = code.pointer(code.pointer("%sum", row), code.index(f"shl i64 {j}, 3"))
    for r in range(height if breadth else 0):
        x = pick(code, totals, [r * breadth + c for c in range(breadth)], width)
        add_row(code, code.pointer(target, 8 * r * columns), x, range(breadth))
    if ones:
        x = pick(code, totals, [height * breadth + r for r in range(height)], width)
        add_row(code, code.pointer("%along", code.index(f"shl i64 {i}, 3")), x, range(height))
