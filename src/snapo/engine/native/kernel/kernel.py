"""From traced phases to one LLVM module.

prepare   everything that the paths share: once per call, then once per step
run       a range of blocks of paths, each through all steps and back
finish    the transposes of `prepare`, on sums over all paths
"""

from dataclasses import dataclass

import numpy as np

from snapo.lanes.emit.code import Code, flush_denormals
from snapo.lanes.gradients.rows import plan as plan_gradients
from snapo.lanes.machine.pipeline import Processor
from snapo.lanes.program import flatten
from snapo.lanes.program.passes import optimize
from snapo.lanes.program.sweeps import dependents, plan

from ..rollout import Phase, Traced
from . import shared
from .context import CONTEXT, Build, KernelStages, Layouts, field
from .phases import Transposed, forward, reverse


def run(build: Build) -> None:
    """`run(context, first block, last block)`: every block forward, and in an adjoint kernel back.

    A horizon whose tape would be too long is done in segments: the carry at each segment's start
    is saved on the way forward, and on the way back a segment goes forward again, with a tape.
    Several columns of weights go back one after the other over the same tape.
    """
    function = build.function("run", ", i64 %begin, i64 %end")
    code = function.code
    restore = flush_denormals(code, build.processor.triple)
    sweeps = _Sweeps(code, build.layouts["carry"].stride)
    tape = build.layouts["tape"].stride
    more = code.index(f"add nsw i64 {field('length')}, {field('segment')}")
    segments = code.index(f"sdiv i64 {code.index(f'sub nsw i64 {more}, 1')}, {field('segment')}")
    final = code.index(f"sub nsw i64 {segments}, 1")
    with code.loop("%end", first="%begin") as blocks:
        flag = code.raw(f"load volatile i64, ptr {field('stop')}, align 8")
        with code.branch(code.index(f"icmp eq i64 {flag}, 0")):
            sweeps.call("initial_forward", blocks.i)
            with code.loop(segments) as s:
                sweeps.save(s.i)
                last = code.index(f"icmp eq i64 {s.i}, {final}")
                selected = tape if build.adjoint else 0
                stride = code.index(f"select i1 {last}, i64 {selected}, i64 0")
                sweeps.call("step_forward", blocks.i, *sweeps.span(s.i), stride)
            sweeps.call("final_forward", blocks.i)
            if build.adjoint:
                sweeps.back("final_reverse", blocks.i)
                with code.loop(segments, down=True) as s:
                    with code.branch(code.index(f"icmp ne i64 {s.i}, {final}")):
                        sweeps.restore(s.i)
                        sweeps.call("step_forward", blocks.i, *sweeps.span(s.i), str(tape))
                    sweeps.back("step_reverse", blocks.i, *sweeps.span(s.i), str(tape))
                sweeps.back("initial_reverse", blocks.i)
    restore()
    function.close()


class _Sweeps:
    """Calls of the sweeps' functions, and copies of the carry, of `size` bytes."""

    def __init__(self, code: Code, size: int):
        self.code, self.size = code, size
        code.module.declare("declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)")

    def call(
        self, name: str, block: str, first="0", last="1", stride="0", context="%context"
    ) -> None:
        self.code.do(
            f"call void @{name}(ptr {context}, i64 {block}, i64 {first}, i64 {last}, i64 {stride})"
        )

    def back(self, name: str, block: str, first="0", last="1", stride="0") -> None:
        """A reverse sweep of every column, with the column's own table."""
        with self.code.loop(field("columns")) as column:
            distance = self.code.index(f"mul nsw i64 {column.i}, {8 * len(CONTEXT)}")
            local = self.code.pointer("%context", distance)
            self.call(name, block, first, last, stride, local)

    def span(self, segment: str) -> tuple[str, str]:
        """The first step of a segment, and the one after its last."""
        code = self.code
        first = code.index(f"mul nsw i64 {segment}, {field('segment')}")
        last = code.index(f"add nsw i64 {first}, {field('segment')}")
        below = code.index(f"icmp slt i64 {last}, {field('length')}")
        return first, code.index(f"select i1 {below}, i64 {last}, i64 {field('length')}")

    def save(self, segment: str) -> None:
        self._copy(self._saved(segment), field("carry"))

    def restore(self, segment: str) -> None:
        self._copy(field("carry"), self._saved(segment))

    def _saved(self, segment: str) -> str:
        distance = self.code.index(f"mul nsw i64 {segment}, {self.size}")
        return self.code.pointer(field("saved"), distance)

    def _copy(self, to: str, source: str) -> None:
        size = f"i64 {self.size}, i1 false"
        self.code.do(f"call void @llvm.memcpy.p0.p0.i64(ptr {to}, ptr {source}, {size})")


def emit_phase(build: Build, phase: Phase) -> None:
    """Writes the phase's functions: the forward sweep, and in an adjoint kernel the reverse one."""
    if build.adjoint:
        _both(build, phase)
        return
    program = optimize(flatten.forward(phase.cut.path, _avals(phase)))
    build.show(f"{phase.name}: one path", program)
    forward(build, phase, program, program.ops, program.outputs, [])


def _avals(phase: Phase) -> list:
    return [aval for _, aval in phase.inputs]


def _both(build: Build, phase: Phase) -> None:
    """The joint program, its division, and both sweeps."""
    path = phase.cut.path
    moving = [
        i for i, (key, aval) in enumerate(phase.outputs)
        if key[0] in ("state", "total", "final") and np.issubdtype(aval.dtype, np.floating)
    ]  # fmt: skip
    active = [
        i for i, (key, aval) in enumerate(phase.inputs)
        if key not in ("noise", "action") and np.issubdtype(aval.dtype, np.floating)
    ]  # fmt: skip
    bound = build.traced.clip if phase.name == "step" else None
    both = flatten.joint(path, moving, _avals(phase), active, bound)
    program = optimize(both.program)
    build.show(f"{phase.name}: one path and its transpose", program)
    count, slots = both.outputs, both.read_slots
    outputs, reads = program.outputs[:count], program.outputs[count : count + len(slots)]
    back = program.outputs[count + len(slots) :]
    cotangents = program.inputs[len(path.reads) + len(phase.inputs) :]
    gradients = plan_gradients(program, [path.reads[s] for s in slots], reads)
    transposed = Transposed(program, gradients, moving, cotangents, active, back)
    selected = gradients.stored(dependents(program, cotangents))
    division = plan(program, cotangents, outputs, transposed.required(), selected)
    forward(build, phase, program, division.forward, outputs, division.tape)
    reverse(build, phase, transposed, division)


@dataclass(eq=False)
class Kernel:
    """The text of a module, and how memory is laid out for it."""

    text: str
    lanes: int
    traced: Traced
    layouts: Layouts
    sizes: dict[str, int]

    @property
    def entries(self) -> dict[str, int]:
        """The functions that are called from outside, with the number of their integers."""
        both = {"prepare": 0, "run": 2}
        return both | {"finish": 0} if self.traced.setup.adjoint else both


def emit(traced: Traced, processor: Processor, stages: KernelStages | None = None) -> Kernel:
    """Writes every function of a kernel, and appends the intermediate programs to `stages`."""
    build = Build.start(traced, processor, stages)
    for name in ("initial", "step", "final"):
        emit_phase(build, traced.phases[name])
    shared.prepare(build)
    if build.adjoint:
        shared.finish(build)
    run(build)
    sizes = {"work": build.work, "chunk": build.chunk}
    return Kernel(build.module.text(), build.module.lanes, traced, build.layouts, sizes)
