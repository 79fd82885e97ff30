"""A writer of LLVM IR for vectors: every number is a vector of lanes, or one lane if all paths
agree.

`Code` appends instructions to one function; `Ref` is a typed result. Mixing one-lane and many-lane
operands broadcasts, as in NumPy.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from ..program.program import TYPES, name_of, number, stored, suffix
from .module import Module, Ref


class Loop:
    """A loop's counter `i`, the values carried in, and those to carry on."""

    def __init__(self, i: str, carried: list[Ref]):
        self.i = i
        self.carried = carried
        self.results: list[Ref] = carried


@dataclass(frozen=True)
class Curve:
    """A function of numbers that is written once for each type and width that a kernel needs.

    `write` appends its instructions to a function with `arguments` as its inputs, and returns the
    result.
    """

    name: str
    arguments: int
    write: Callable[..., Ref]


LINE = 64  # bytes of a line of the cache


class Ahead:
    """Memory from an address on, which loops of dot products fetch before it is needed. Each of
    their rounds fetches a part: if all were fetched at once, it would occupy all of the
    processor's buffers for cache misses, and loads of the present step would wait.
    """

    LIMIT = 8  # lines that one round fetches

    def __init__(self, code: "Code", start: str, size: int, rounds: int, written: bool):
        """Divides the fetch of `size` bytes, which are then read or `written`, among this many
        rounds. Bytes to be read that exceed the limit of the rounds are fetched here."""
        self.code, self.start, self.written, self.taken = code, start, written, 0
        self.share = min(self.LIMIT * LINE, -(-size // rounds)) if rounds else 0
        code.module.declare("declare void @llvm.prefetch.p0(ptr, i32, i32, i32)")
        first = self.share * rounds
        if first < size and not written:
            with code.loop(-(-(size - first) // (4 * LINE))) as loop:
                distance = code.index(f"mul nsw i64 {loop.i}, {4 * LINE}")
                self._fetch(code.pointer(code.pointer(start, first), distance), 4)

    def take(self, rounds: int) -> int:
        """The number of the first of this many consecutive rounds."""
        self.taken += rounds
        return self.taken - rounds

    def fetch(self, round: str, first: int | str) -> None:
        """Fetches the share of a round, by its number from that of the `first` in its loop."""
        number = self.code.index(f"add nsw i64 {round}, {first}")
        distance = self.code.index(f"mul nsw i64 {number}, {self.share}")
        self._fetch(self.code.pointer(self.start, distance), -(-self.share // LINE))

    def _fetch(self, at: str, lines: int) -> None:
        for line in range(lines):
            pointer = self.code.pointer(at, LINE * line)
            hints = f"i32 {int(self.written)}, i32 2, i32 1"
            self.code.do(f"call void @llvm.prefetch.p0(ptr {pointer}, {hints})")


class Code:
    """One function's instructions. `lanes` is the width of a number that differs between paths.

    If `contract` is on, LLVM may fuse a product and a sum to one multiply-add. Whether it does
    depends on the surrounding code, so `contract` is off for numbers that must have the same bits
    in two kernels, or twice in one.
    """

    def __init__(self, lanes: int, module: Module):
        self.lanes = lanes
        self.module = module
        self.contract = False
        self.ahead: Ahead | None = None
        self.lines: list[str] = []
        self.count = 0
        self.block = "entry"

    def fresh(self, prefix: str = "v") -> str:
        self.count += 1
        return f"{prefix}{self.count}"

    def raw(self, text: str, prefix: str = "v") -> str:
        """Appends `%name = text` and returns the name."""
        name = "%" + self.fresh(prefix)
        self.lines.append(f"  {name} = {text}")
        return name

    def do(self, text: str) -> None:
        self.lines.append("  " + text)

    def constant(self, value, dtype, lanes: int = 1) -> Ref:
        dtype = name_of(dtype)
        text = f"splat ({TYPES[dtype]} {number(value, dtype)})"
        return Ref(text, dtype, lanes, np.dtype(dtype).type(value))

    def splat(self, x: Ref, lanes: int) -> Ref:
        """One lane repeated."""
        if x.lanes == lanes:
            return x
        if x.value is not None:
            return self.constant(x.value, x.dtype, lanes)
        text = f"shufflevector {x.type} {x.text}, {x.type} poison, <{lanes} x i32> zeroinitializer"
        return Ref(self.raw(text), x.dtype, lanes)

    def join(self, refs: list[Ref]) -> Ref:
        """Vectors of equal length, one after the other."""
        while len(refs) > 1:
            odd = [refs.pop()] if len(refs) % 2 else []
            refs = [self._pair(a, b) for a, b in zip(refs[::2], refs[1::2])]
            refs += [self._pair(refs.pop(), o) for o in odd]
        return refs[0]

    def _pair(self, a: Ref, b: Ref) -> Ref:
        if a.value is not None and b.value is not None and a.value == b.value:
            return self.constant(a.value, a.dtype, a.lanes + b.lanes)
        if a.lanes != b.lanes:
            longer = ", ".join(f"i32 {i}" if i < b.lanes else "i32 poison" for i in range(a.lanes))
            text = f"shufflevector {b.type} {b.text}, {b.type} poison, <{a.lanes} x i32> <{longer}>"
            b, extra = Ref(self.raw(text), b.dtype, a.lanes), b.lanes
        else:
            extra = b.lanes
        mask = ", ".join(f"i32 {i}" for i in range(a.lanes + extra))
        kind = f"<{a.lanes + extra} x i32>"
        text = f"shufflevector {a.type} {a.text}, {b.type} {b.text}, {kind} <{mask}>"
        return Ref(self.raw(text), a.dtype, a.lanes + extra)

    def part(self, x: Ref, number: int, lanes: int) -> Ref:
        """The `number`-th run of `lanes` lanes."""
        mask = ", ".join(f"i32 {number * lanes + i}" for i in range(lanes))
        text = f"shufflevector {x.type} {x.text}, {x.type} poison, <{lanes} x i32> <{mask}>"
        return Ref(self.raw(text), x.dtype, lanes)

    def shuffle(self, a: Ref, b: Ref, mask: str) -> Ref:
        """Lanes of two vectors, in the number of lanes of each; the second vector continues the
        count."""
        text = f"shufflevector {a.type} {a.text}, {b.type} {b.text}, <{a.lanes} x i32> <{mask}>"
        return Ref(self.raw(text), a.dtype, a.lanes)

    def same(self, *refs: Ref) -> list[Ref]:
        """Operands brought to a common number of lanes."""
        lanes = max(r.lanes for r in refs)
        return [self.splat(r, lanes) for r in refs]

    def op(self, instruction: str, *refs: Ref, dtype: str | None = None) -> Ref:
        """An instruction on vectors of one type, such as `fadd`."""
        refs = tuple(self.same(*refs))
        operands = ", ".join(r.text for r in refs)
        text = self.raw(f"{instruction} {refs[0].type} {operands}")
        return Ref(text, dtype or refs[0].dtype, refs[0].lanes)

    def call(self, function: str, *refs: Ref, dtype: str | None = None, extra: str = "") -> Ref:
        """An LLVM intrinsic overloaded on the vector type, such as `llvm.fma`."""
        refs = tuple(self.same(*refs))
        first = refs[0]
        result = Ref("", dtype or first.dtype, first.lanes)
        name = f"@{function}.v{first.lanes}{suffix(first.dtype)}"
        self.module.declare(
            f"declare {result.type} {name}({', '.join(r.type for r in refs)}{extra and ', i1'})"
        )
        operands = ", ".join(f"{r.type} {r.text}" for r in refs)
        return Ref(
            self.raw(f"call {result.type} {name}({operands}{extra})"), result.dtype, first.lanes
        )

    def apply(self, curve: Curve, *refs: Ref) -> Ref:
        """A curve, as a function of the module for this width and type."""
        refs = tuple(self.same(*refs))
        first = refs[0]
        name = f"{curve.name}_{first.dtype}_{first.lanes}"
        if self.module.first(name):
            self.module.write(self._function(name, curve, first))
        operands = ", ".join(f"{r.type} {r.text}" for r in refs)
        return Ref(self.raw(f"call {first.type} @{name}({operands})"), first.dtype, first.lanes)

    def _function(self, name: str, curve: Curve, like: Ref) -> str:
        """The text of a curve's function for one type and width."""
        code = Code(like.lanes, self.module)
        inputs = [Ref(f"%x{i}", like.dtype, like.lanes) for i in range(curve.arguments)]
        result = curve.write(code, *inputs)
        code.do(f"ret {result.type} {result.text}")
        arguments = ", ".join(f"{r.type} {r.text}" for r in inputs)
        header = f"define internal {result.type} @{name}({arguments}) alwaysinline nounwind #0"
        return code.text(header)

    def text(self, header: str) -> str:
        """This function's text."""
        body = "\n".join(self.lines)
        return f"{header} {{\nentry:\n{body}\n}}"

    def define(self, header: str) -> None:
        """Ends the function and adds it to the module."""
        self.module.write(self.text(f"{header} #0"))

    # Arithmetic, by the type of the operands.

    def loose(self, instruction: str) -> str:
        return f"{instruction} contract" if self.contract else instruction

    def add(self, a: Ref, b: Ref) -> Ref:
        return self.op(self.loose("fadd") if a.floating else "add", a, b)

    def sub(self, a: Ref, b: Ref) -> Ref:
        return self.op(self.loose("fsub") if a.floating else "sub", a, b)

    def mul(self, a: Ref, b: Ref) -> Ref:
        return self.op(self.loose("fmul") if a.floating else "mul", a, b)

    def div(self, a: Ref, b: Ref) -> Ref:
        return self.op("fdiv", a, b)

    def fma(self, a: Ref, b: Ref, c: Ref) -> Ref:
        return self.call("llvm.fma", a, b, c)

    def compare(self, predicate: str, a: Ref, b: Ref) -> Ref:
        """`predicate` as in LLVM: olt, une, slt …"""
        kind = "fcmp" if a.floating else "icmp"
        return self.op(f"{kind} {predicate}", a, b, dtype="bool")

    def select(self, mask: Ref, yes: Ref, no: Ref) -> Ref:
        mask, yes, no = self.same(mask, yes, no)
        text = f"select {mask.type} {mask.text}, {yes.type} {yes.text}, {no.type} {no.text}"
        return Ref(self.raw(text), yes.dtype, yes.lanes)

    def recast(self, x: Ref, dtype: str, lanes: int) -> Ref:
        """The same bits read as numbers of another type, also of another size."""
        result = Ref("", dtype, lanes)
        return Ref(self.raw(f"bitcast {x.type} {x.text} to {result.type}"), dtype, lanes)

    def convert(self, instruction: str, x: Ref, dtype: str) -> Ref:
        """`sitofp`, `zext`, `bitcast` …"""
        result = Ref("", dtype, x.lanes)
        return Ref(self.raw(f"{instruction} {x.type} {x.text} to {result.type}"), dtype, x.lanes)

    # Memory: byte addresses relative to a pointer.

    def pointer(self, base: str, offset: int | str) -> str:
        if offset == 0:
            return base
        return self.raw(f"getelementptr i8, ptr {base}, i64 {offset}", "p")

    def load(
        self, pointer: str, dtype, lanes: int, invariant: bool = False, align: int | None = None
    ) -> Ref:
        """Booleans are bytes in memory. `align`: by default that of as many lanes."""
        dtype = name_of(dtype)
        selected = stored(dtype)
        ref = Ref("", selected, lanes)
        align = align or min(64, np.dtype(selected).itemsize * lanes)
        tail = ", !invariant.load !0" if invariant else ""
        ref = Ref(self.raw(f"load {ref.type}, ptr {pointer}, align {align}{tail}"), selected, lanes)
        return self.convert("trunc", ref, "bool") if dtype == "bool" else ref

    def store(self, x: Ref, pointer: str, lanes: int) -> None:
        x = self.splat(x, lanes)
        if x.dtype == "bool":
            x = self.convert("zext", x, "int8")
        align = min(64, np.dtype(x.dtype).itemsize * lanes)
        self.do(f"store {x.type} {x.text}, ptr {pointer}, align {align}")

    def gather(self, base: str, offsets: Ref, dtype) -> Ref:
        """One number per lane, at byte offsets from a pointer."""
        pointers = self.raw(f"getelementptr i8, ptr {base}, {offsets.type} {offsets.text}")
        return self.gather_at(pointers, offsets.lanes, dtype)

    def gather_at(self, pointers: str, lanes: int, dtype) -> Ref:
        """One number per lane, at a vector of pointers."""
        dtype = np.dtype(dtype)
        kind = Ref("", dtype.name, lanes)
        name = f"@llvm.masked.gather.v{lanes}{suffix(dtype.name)}.v{lanes}p0"
        mask = f"<{lanes} x i1>"
        self.module.declare(
            f"declare {kind.type} {name}(<{lanes} x ptr>, i32, {mask}, {kind.type})"
        )
        text = (
            f"call {kind.type} {name}(<{lanes} x ptr> {pointers}, i32 {dtype.itemsize}, "
            f"{mask} splat (i1 true), {kind.type} poison)"
        )
        return Ref(self.raw(text), dtype.name, lanes)

    # Integers of the loops.

    def index(self, text: str) -> str:
        return self.raw(text, "i")

    @contextmanager
    def loop(
        self,
        count: int | str,
        carried: tuple[Ref, ...] = (),
        first: int | str = 0,
        down: bool = False,
    ) -> Iterator[Loop]:
        """`for i in range(first, count)`, at least once; `loop.results` are those of `carried`."""
        head, exit = self.fresh("head"), self.fresh("exit")
        start, stop = (count, first) if down else (first, count)
        if down:
            start = self.index(f"sub i64 {count}, 1") if isinstance(count, str) else count - 1
        before = self.block
        self.do(f"br label %{head}")
        self.lines.append(f"{head}:")
        self.block = head
        mark = len(self.lines)
        loop = Loop(
            "%" + self.fresh("i"), [Ref("%" + self.fresh("a"), r.dtype, r.lanes) for r in carried]
        )
        yield loop
        after = self.index(f"add i64 {loop.i}, {-1 if down else 1}")
        phis = [f"  {loop.i} = phi i64 [ {start}, %{before} ], [ {after}, %{self.block} ]"]
        for ref, init, new in zip(loop.carried, carried, loop.results):
            pairs = f"[ {init.text}, %{before} ], [ {new.text}, %{self.block} ]"
            phis.append(f"  {ref.text} = phi {ref.type} {pairs}")
        self.lines[mark:mark] = phis
        more = self.index(f"icmp {'sge' if down else 'slt'} i64 {after}, {stop}")
        self.do(f"br i1 {more}, label %{head}, label %{exit}")
        self.lines.append(f"{exit}:")
        self.block = exit

    def without_last(self, count: int, empty: Callable[[str], str]) -> str:
        """`count` rounds minus the last ones that are `empty`, by number; at least one is left."""
        before, head, exit = self.block, self.fresh("head"), self.fresh("exit")
        self.do(f"br label %{head}")
        self.lines.append(f"{head}:")
        self.block, mark, left = head, len(self.lines), "%" + self.fresh("i")
        last = self.index(f"sub nsw i64 {left}, 1")
        several = self.index(f"icmp sgt i64 {left}, 1")
        repeat = self.index(f"and i1 {several}, {empty(last)}")
        pairs = f"[ {count}, %{before} ], [ {last}, %{head} ]"
        self.lines.insert(mark, f"  {left} = phi i64 {pairs}")
        self.do(f"br i1 {repeat}, label %{head}, label %{exit}")
        self.lines.append(f"{exit}:")
        self.block = exit
        return left

    @contextmanager
    def branch(self, condition: str) -> Iterator[None]:
        """Code that runs if the scalar condition is true."""
        then, after = self.fresh("then"), self.fresh("after")
        self.do(f"br i1 {condition}, label %{then}, label %{after}")
        self.lines.append(f"{then}:")
        self.block = then
        yield
        self.do(f"br label %{after}")
        self.lines.append(f"{after}:")
        self.block = after


def flush_denormals(code: Code, triple: str) -> Callable[[], None]:
    """From here on denormals are treated as zero, as in XLA; returns a call that restores the
    mode. Tails of logistic curves fill an adjoint with denormals, and each of these takes a
    hundred cycles.
    """
    if triple.startswith("x86_64"):
        for name in ("stmxcsr", "ldmxcsr"):
            code.module.declare(f"declare void @llvm.x86.sse.{name}(ptr)")
        code.do("%mode = alloca i32, align 4")
        code.do("%flushing = alloca i32, align 4")
        code.do("call void @llvm.x86.sse.stmxcsr(ptr %mode)")
        code.do("%before = load i32, ptr %mode, align 4")
        code.do("%with = or i32 %before, 32832")
        code.do("store i32 %with, ptr %flushing, align 4")
        code.do("call void @llvm.x86.sse.ldmxcsr(ptr %flushing)")
        return lambda: code.do("call void @llvm.x86.sse.ldmxcsr(ptr %mode)")
    if triple.startswith(("aarch64", "arm64")):
        code.module.declare("declare i64 @llvm.aarch64.get.fpcr()")
        code.module.declare("declare void @llvm.aarch64.set.fpcr(i64)")
        code.do("%before = call i64 @llvm.aarch64.get.fpcr()")
        code.do("%with = or i64 %before, 16777216")
        code.do("call void @llvm.aarch64.set.fpcr(i64 %with)")
        return lambda: code.do("call void @llvm.aarch64.set.fpcr(i64 %before)")
    return lambda: None
