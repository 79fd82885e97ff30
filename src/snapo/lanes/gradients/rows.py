"""The waiting rows: factors and summands of some tens of steps, until they are added up."""

from typing import Any

from ..emit.code import Code
from ..emit.shared import Shared
from ..emit.storage import ArrayPlace, Layout
from ..program.outer import Outer
from ..program.program import ProgramValue
from .adding import add_rows
from .plan import Gradients
from .products import product_function

LONGEST = 32  # steps that wait before they are gathered
WAITING = 1024 * 1024  # bytes that they may take, so that they stay in cache


class Rows:
    """The waiting rows: where factors and summands of several steps lie."""

    def __init__(
        self,
        gradients: Gradients,
        tape: Layout,
        taped: list[ProgramValue],
        lanes: int,
        stepwise: bool,
    ):
        self.gradients, self.tape = gradients, tape
        self.taped = set(taped)
        self.layout = Layout(lanes)
        for g in gradients.items:
            for value in [*g.rest, *g.factors]:
                if value not in self.taped and value not in self.layout.fields:
                    self.layout.add(value, value.shape, value.dtype)
        self.fields: dict[Any, Any] = self.layout.fields
        self.steps = 1
        while stepwise and self.steps < LONGEST and 2 * self.steps * self.layout.stride <= WAITING:
            self.steps *= 2
        self.bytes = self.steps * self.layout.stride

    def row(self, code: Code, chunk: str, slot: str) -> str:
        return code.pointer(chunk, code.index(f"mul nsw i64 {slot}, {self.layout.stride}"))

    def homes(self, row: str) -> dict[ProgramValue, ArrayPlace]:
        return {value: self.layout.address(value, row) for value in self.fields}

    def address(self, value: ProgramValue, tape_row: str, chunk_row: str) -> tuple[ArrayPlace, str]:
        """Where a value lies, and the distance to the next step's."""
        if value in self.taped:
            return self.tape.address(value, tape_row), "%stride"
        return self.layout.address(value, chunk_row), str(self.layout.stride)

    def gather(self, code: Code, sums: Shared, tape_row: str, chunk_row: str, count: str) -> None:
        """Adds up the waiting steps of all that belongs to the whole call.

        A vector that is summed alone (a bias) rides along where it is also a product's rows.
        """
        alone: dict[ProgramValue, list[ArrayPlace]] = {}
        products: list[tuple[Outer, ArrayPlace]] = []
        for g in self.gradients.items:
            if sums.of_call(g.leaf):
                target = sums.address(g.leaf)
                products += [(t, target) for t in g.terms]
                for value in g.rest:
                    alone.setdefault(value, []).append(target)
        for t, target in products:
            riding = alone.get(t.rows)
            along = riding.pop() if riding else None
            self.product(code, t, target, tape_row, chunk_row, count, along)
        for value, targets in alone.items():
            position, stride = self.address(value, tape_row, chunk_row)
            for target in targets:
                add_rows(code, position, stride, count, target)

    def product(
        self,
        code: Code,
        t: Outer,
        target: ArrayPlace,
        tape_row: str,
        chunk_row: str,
        count: str,
        along: ArrayPlace | None = None,
    ) -> None:
        """Adds the sum over steps of rows x columns to the target, that of the rows to `along`."""
        a, stride_a = self.address(t.rows, tape_row, chunk_row)
        b, stride_b = self.address(t.columns, tape_row, chunk_row)
        sizes = t.rows.size, t.columns.size
        name = product_function(code.module, sizes, t.rows.dtype.name, along is not None)
        p, q = code.pointer(a.base, a.offset), code.pointer(b.base, b.offset)
        r = code.pointer(target.base, target.offset)
        local = "null" if along is None else code.pointer(along.base, along.offset)
        code.do(
            f"call void @{name}(ptr {p}, i64 {stride_a}, ptr {q}, i64 {stride_b}, "
            f"i64 {count}, ptr {r}, ptr {local})"
        )
