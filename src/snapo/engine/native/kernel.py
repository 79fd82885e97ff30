"""From traced phases to one LLVM module: layouts of memory, functions of each phase, the driver.

prepare   what is the same for all paths: once per call, then once per step
run       a range of blocks of paths, each through all steps and back
finish    the transposes of `prepare`, on sums over all paths
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from . import compiler, gradients, passes, trace
from .body import Body, Workspace
from .code import Code, Module
from .phases import PhaseEmitter
from .program import Op, Program, Value, walk
from .rollout import Traced
from .storage import Layout, Place, Small
from .trace import Leaf, Piece

# The table of addresses and numbers that every function reads.
CONTEXT = (
    "table", "steps", "work", "carry", "cotangent", "tape_initial", "tape", "tape_final", "chunk",
    "saved", "call_sums", "step_sums", "keys", "paths", "positions", "noise_initial", "noise",
    "actions", "start", "final", "weights", "bounds", "start_cotangent", "records", "length",
    "first", "segment", "count", "stop",
)  # fmt: skip
NUMBERS = ("length", "first", "segment", "count")


@dataclass(eq=False)
class Kernel:
    """The text of a module, and how memory is laid out for it."""

    text: str
    lanes: int
    traced: Traced
    layouts: dict[str, Layout]
    sizes: dict[str, int]


Stages = list[tuple[str, str]]  # titles and programs as text


def emit(traced: Traced, lanes: int, register: int, stages: Stages | None = None) -> Kernel:
    """Emits every function of a kernel, and tells `stages` of the programs on the way."""
    return Emitter(traced, lanes, register, stages).kernel()


class Emitter:
    """The module under construction, shared by the functions of all phases."""

    def __init__(self, traced: Traced, lanes: int, register: int, stages: Stages | None):
        self.traced, self.lanes = traced, lanes
        self.dtype = traced.setup.dtype
        self.module = Module(lanes, register)
        self.stages = stages
        self.adjoint = traced.setup.adjoint
        self.work = self.chunk = 0
        self.layouts = self._layouts()

    def _layouts(self) -> dict[str, Layout]:
        """Rows of memory: tables of one lane, and blocks of lanes."""
        t, real, lanes = self.traced, np.dtype(self.dtype), self.lanes
        rows = {name: Layout(1) for name in ("table", "steps", "call_sums", "step_sums")}
        calls = [*t.call, *(leaf for p in t.phases.values() for leaf in p.cut.call_leaves)]
        nows = [*t.now, *t.phases["step"].cut.step_leaves]
        for leaf in dict.fromkeys(calls):
            rows["table"].add(leaf, leaf.shape, leaf.dtype)
            if leaf.active:
                rows["call_sums"].add(leaf, leaf.shape, np.float64)
        for leaf in dict.fromkeys(nows):
            rows["steps"].add(leaf, leaf.shape, leaf.dtype)
            if leaf.active:
                rows["step_sums"].add(leaf, leaf.shape, np.float64)
        for name in (
            "carry",
            "cotangent",
            "start",
            "start_cotangent",
            "final",
            "weights",
            "records",
            "bounds",
        ):
            rows[name] = Layout(lanes)
        for i, x in enumerate(t.state):
            for name, key in (("carry", "state"), ("start", "start"), ("final", "end")):
                rows[name].add((key, i), x.shape, x.dtype)
            if x.dtype == real:
                rows["cotangent"].add(("state", i), x.shape, x.dtype)
                rows["start_cotangent"].add(("start", i), x.shape, x.dtype)
        for n in t.names:
            rows["carry"].add(("total", n), (), real)
            rows["cotangent"].add(("total", n), (), real)
        for n in t.final_names:
            rows["final"].add(("final", n), (), real)
            rows["weights"].add(("final", n), (), real)
        rows["bounds"].add("bound", (), real)
        for key, aval in t.phases["step"].outputs:
            if key[0] == "record":
                rows["records"].add(key, aval.shape, aval.dtype)
        rows["actions"] = Layout(lanes)
        for key, aval in t.phases["step"].inputs:
            if key == "action":
                rows["actions"].add(key, aval.shape, aval.dtype)
        for name in ("tape_initial", "tape", "tape_final"):
            rows[name] = Layout(lanes)
        return rows

    def kernel(self) -> Kernel:
        phases = self.traced.phases
        for name in ("initial", "step", "final"):
            PhaseEmitter(self, phases[name]).emit()
        self.prepare()
        if self.adjoint:
            self.finish()
        self.driver()
        sizes = {"work": self.work, "chunk": self.chunk}
        return Kernel(self.module.text(), self.lanes, self.traced, self.layouts, sizes)

    # Functions.

    def function(self, name: str, arguments: str = "") -> Code:
        code = Code(self.lanes, self.module)
        self.header = f"define void @{name}(ptr noalias %context{arguments}) nounwind"
        for i, slot in enumerate(CONTEXT):
            kind = "i64" if slot in NUMBERS else "ptr"
            code.do(f"%slot_{slot} = getelementptr i8, ptr %context, i64 {8 * i}")
            code.do(f"%c_{slot} = load {kind}, ptr %slot_{slot}, align 8, !invariant.load !0")
        return code

    def close(self, code: Code) -> None:
        code.do("ret void")
        self.module.define(self.header, code)

    def field(self, code: Code, name: str) -> str:
        """A slot of the context, loaded when the function begins."""
        return f"%c_{name}"

    def reads(
        self, body: Body, program: Program, piece: Piece, table: str, steps: str | None, fixed=True
    ) -> None:
        """Binds what a piece reads to the tables, which do not change where they are `fixed`."""
        for value, leaf in zip(program.inputs, piece.reads):
            body.where[value] = self.shared(leaf, table, steps, fixed)

    def shared(self, leaf: Leaf, table: str, steps: str | None, invariant: bool) -> Place:
        if leaf in self.layouts["table"].fields:
            return self.layouts["table"].place(leaf, table, invariant)
        assert steps is not None
        return self.layouts["steps"].place(leaf, steps, invariant)

    def sums(self, leaf: Leaf, call_sums: str, step_sums: str | None) -> Place:
        if leaf in self.layouts["call_sums"].fields:
            return self.layouts["call_sums"].place(leaf, call_sums)
        assert step_sums is not None
        return self.layouts["step_sums"].place(leaf, step_sums)

    def used(self, workspace: Workspace) -> None:
        self.work = max(self.work, workspace.size)

    def show(self, title: str, program: Program) -> None:
        if self.stages is not None:
            self.stages.append((title, "\n".join(walk(program))))

    def prepare(self) -> None:
        """Everything that the paths share."""
        code = self.function("prepare")
        table, steps = self.field(code, "table"), self.field(code, "steps")
        for phase in self.traced.phases.values():
            self._shared_piece(code, phase.cut.call, phase.cut.call_leaves, table, None, phase.name)
        step = self.traced.phases["step"].cut
        if step.step_leaves:
            with code.loop(self.field(code, "length")) as loop:
                row = self.row(code, steps, loop.i, "steps")
                self._shared_piece(code, step.step, step.step_leaves, table, row, "step")
        self.close(code)

    def row(self, code: Code, base: str, i: str, layout: str) -> str:
        return code.pointer(base, code.index(f"mul nsw i64 {i}, {self.layouts[layout].stride}"))

    def _shared_piece(
        self, code: Code, piece: Piece, leaves, table: str, steps: str | None, name: str
    ) -> None:
        if not leaves:
            return
        program = passes.optimize(trace.forward(piece, (), False))
        self.show(f"{name}: computed once per {'call' if steps is None else 'step'}", program)
        homes = {}
        for value, leaf in zip(program.outputs, leaves):
            homes.setdefault(value, self.shared(leaf, table, steps, False))
        body = Body(code, Workspace(), homes)
        self.reads(body, program, piece, table, steps, fixed=False)
        body.run(program.ops, program.outputs)
        for value, leaf in zip(program.outputs, leaves):
            place = self.shared(leaf, table, steps, False)
            if (
                homes.get(value) is None
                or homes[value].offset != place.offset
                or value.constant is not None
            ):
                body.copy(value, place)
        self.used(body.workspace)

    def finish(self) -> None:
        """The transposes of what the paths share, on sums over paths."""
        code = self.function("finish")
        table, steps = self.field(code, "table"), self.field(code, "steps")
        calls, sums = self.field(code, "call_sums"), self.field(code, "step_sums")
        step = self.traced.phases["step"].cut
        if any(leaf.active for leaf in step.step_leaves):
            with code.loop(self.field(code, "length")) as loop:
                row, back = (
                    self.row(code, steps, loop.i, "steps"),
                    self.row(code, sums, loop.i, "step_sums"),
                )
                self._transposed(code, step.step, step.step_leaves, table, row, calls, back)
        for phase in reversed(self.traced.phases.values()):
            self._transposed(code, phase.cut.call, phase.cut.call_leaves, table, None, calls, None)
        self.close(code)

    def _transposed(self, code: Code, piece: Piece, leaves, table, steps, calls, sums) -> None:
        moving = [i for i, leaf in enumerate(leaves) if leaf.active]
        if not moving:
            return
        joint = trace.joint(piece, moving, own_path=False)
        program = joint.program
        back = program.outputs[joint.outputs :]
        program = passes.optimize(Program(program.inputs, program.ops, back))
        body = Body(code, Workspace())
        self.reads(body, program, piece, table, steps)
        for value, i in zip(program.inputs[len(piece.reads) :], moving):
            body.where[value] = self._cast_sums(
                code, body, self.sums(leaves[i], calls, sums), value
            )
        body.run(program.ops, program.outputs)
        for value, slot in zip(program.outputs, joint.read_slots):
            gradients.add(body, value, self.sums(piece.reads[slot], calls, sums))
        self.used(body.workspace)

    def _cast_sums(self, code: Code, body: Body, place: Place, value: Value) -> Small | Place:
        """Sums are kept in float64; the transposes run in the call's precision."""
        if value.dtype == np.float64:
            return place
        wide = Value(value.shape, np.dtype(np.float64))
        body.where[wide] = place
        body.run([Op("convert_element_type", [wide], [value], {"new_dtype": value.dtype})], [value])
        return body.where[value]

    def driver(self) -> None:
        """`run(context, first block, last block)`: every block forward, and back."""
        code = self.function("run", ", i64 %begin, i64 %end")
        restore = flush_denormals(code)
        length, segment = self.field(code, "length"), self.field(code, "segment")
        carry, saved, stop = (self.field(code, n) for n in ("carry", "saved", "stop"))
        size, row = self.layouts["carry"].stride, self.layouts["tape"].stride
        self.module.declare("declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)")

        def copy(to: str, source: str) -> None:
            code.do(
                f"call void @llvm.memcpy.p0.p0.i64(ptr {to}, ptr {source}, i64 {size}, i1 false)"
            )

        def span(s: str) -> tuple[str, str]:
            first = code.index(f"mul nsw i64 {s}, {segment}")
            last = code.index(f"add nsw i64 {first}, {segment}")
            below = code.index(f"icmp slt i64 {last}, {length}")
            return first, code.index(f"select i1 {below}, i64 {last}, i64 {length}")

        def sweep(name: str, block: str, first="0", last="1", stride="0") -> None:
            code.do(
                f"call void @{name}(ptr %context, i64 {block}, i64 {first}, i64 {last}, "
                f"i64 {stride})"
            )

        more = code.index(f"add nsw i64 {length}, {segment}")
        segments = code.index(f"sdiv i64 {code.index(f'sub nsw i64 {more}, 1')}, {segment}")
        final = code.index(f"sub nsw i64 {segments}, 1")
        with code.loop("%end", first="%begin") as blocks:
            flag = code.raw(f"load volatile i64, ptr {stop}, align 8")
            with code.branch(code.index(f"icmp eq i64 {flag}, 0")):
                sweep("initial_forward", blocks.i)
                with code.loop(segments) as s:
                    copy(code.pointer(saved, code.index(f"mul nsw i64 {s.i}, {size}")), carry)
                    last = code.index(f"icmp eq i64 {s.i}, {final}")
                    stride = code.index(
                        f"select i1 {last}, i64 {row if self.adjoint else 0}, i64 0"
                    )
                    sweep("step_forward", blocks.i, *span(s.i), stride)
                sweep("final_forward", blocks.i)
                if self.adjoint:
                    sweep("final_reverse", blocks.i)
                    with code.loop(segments, down=True) as s:
                        with code.branch(code.index(f"icmp ne i64 {s.i}, {final}")):
                            copy(
                                carry, code.pointer(saved, code.index(f"mul nsw i64 {s.i}, {size}"))
                            )
                            sweep("step_forward", blocks.i, *span(s.i), str(row))
                        sweep("step_reverse", blocks.i, *span(s.i), str(row))
                    sweep("initial_reverse", blocks.i)
        restore()
        self.close(code)


def flush_denormals(code: Code) -> Callable[[], None]:
    """Denormals count as zero from here on, as XLA has it; returns what puts the mode back.

    Tails of logistic curves fill an adjoint with denormals, and each costs a hundred cycles.
    """
    triple = compiler.triple()
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
