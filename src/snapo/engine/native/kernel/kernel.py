"""From traced phases to one LLVM module: two sweeps for each phase, and three entries.

prepare   everything that the paths share: once per call, then once per step
run       a range of blocks of paths, each through all steps and back
finish    the transposes of `prepare`, on sums over all paths
"""

from dataclasses import dataclass

import numpy as np

from snapo.lanes import body
from snapo.lanes.emit.code import Ahead, Code, flush_denormals
from snapo.lanes.emit.storage import ArrayPlace, Layout
from snapo.lanes.emit.values import EmittedValues
from snapo.lanes.gradients.rows import Gradients, Rows, accumulate
from snapo.lanes.gradients.rows import plan as plan_gradients
from snapo.lanes.machine.pipeline import Processor
from snapo.lanes.program import flatten
from snapo.lanes.program.passes import optimize
from snapo.lanes.program.program import BIG, Op, Program, ProgramValue
from snapo.lanes.program.sweeps import SweepPlan, dependents, plan
from snapo.lanes.rules import dots

from ..rollout import KernelTrees, Phase, Traced
from . import noise, shared
from .context import CONTEXT, TAPES, Build, KernelStages, Layouts, field
from .sweep import KernelSweep, replace_all, sweep


def forward(
    build: Build,
    phase: Phase,
    program: Program,
    ops: list[Op],
    outputs: list[ProgramValue],
    taped: list[ProgramValue],
) -> None:
    """Writes the function: `ops` of the program, for these outputs and those kept on the tape."""
    tape = build.layouts[TAPES[phase.name]]
    for value in taped:
        tape.add(value, value.shape, value.dtype)
    with sweep(build, phase, "forward") as s:
        row = s.tape_row()
        values = s.values(program, {v: tape.address(v, row) for v in taped})
        read = {v for op in ops for v in op.inputs} | set(taped) | set(outputs)
        _inputs(s, values, program, read)
        if taped:
            fetch_ahead(s, ops, tape, AHEAD)
        body.write(values, ops, [*outputs, *taped])
        _deliver(s, values, outputs)
        build.used(values.workspace)


def _inputs(
    s: KernelSweep, values: EmittedValues, program: Program, read: set[ProgramValue]
) -> None:
    """Binds the path's arrays that are `read`: carry, noise, actions, given states."""
    local = program.inputs[len(s.phase.cut.path.reads) :]
    for value, (key, _) in zip(local, s.phase.inputs):
        if value not in read:
            continue
        if key == "noise":
            noise.bind(s, values, value)
        else:
            values.bind(value, _given(s, key))
        if value.size <= BIG:
            values.small(value)


def _given(s: KernelSweep, key) -> ArrayPlace:
    """Position of an array of the path that this phase takes as an argument."""
    layouts = s.build.layouts
    if key == "action":
        return layouts["actions"].address(key, s.step_row("actions"))
    if key[0] == "start":
        return layouts["start"].address(key, s.block_row("start"))
    return layouts["carry"].address(key, field("carry"))


def _deliver(s: KernelSweep, values: EmittedValues, outputs: list[ProgramValue]) -> None:
    """Writes the outputs: the next carry, totals and final states, records."""
    layouts = s.build.layouts
    carry: list[tuple[ProgramValue, ArrayPlace]] = []
    for value, (key, _) in zip(outputs, s.phase.outputs):
        if key[0] == "scale":
            continue
        if key[0] == "record":
            values.copy(value, layouts["records"].address(key, s.step_row("records")))
        elif key[0] in ("final", "end"):
            values.copy(value, layouts["final"].address(key, s.block_row("final")))
        else:
            carry.append((value, layouts["carry"].address(key, field("carry"))))
    replace_all(values, carry)


AHEAD = 2  # rows of tape that are fetched before they are needed


def fetch_ahead(s: KernelSweep, ops: list[Op], tape: Layout, rows: int) -> None:
    """Lets dot products fetch the tape from memory: `rows` ahead for writing, or with negative
    `rows` behind for reading.

    Processors do not predict rows that descend, and a long tape is not in the cache.
    """
    if s.stepwise:
        start = s.code.pointer(s.tape_row(), rows * tape.stride)
        rounds = sum(dots.rounds(s.code, op) for op in ops)
        s.code.ahead = Ahead(s.code, start, tape.stride, rounds, rows > 0)


@dataclass(eq=False)
class Transposed:
    """A phase's joint program, and the numbers of its outputs and inputs that have cotangents.

    - `cotangents`: those inputs of the program that are cotangents of the outputs `moving`; the
      last one has the bound of clipping and the share that is kept.
    - `back`: the computed cotangents, those of the inputs `active`.
    """

    program: Program
    gradients: Gradients
    moving: list[int]
    cotangents: list[ProgramValue]
    active: list[int]
    back: list[ProgramValue]

    def required(self) -> list[ProgramValue]:
        """All values that the reverse sweep must compute."""
        return [*self.back, *self.gradients.required()]


def reverse(build: Build, phase: Phase, transposed: Transposed, division: SweepPlan) -> None:
    """Writes the function of the reverse sweep."""
    program, tape = transposed.program, build.layouts[TAPES[phase.name]]
    lanes, stepwise = build.module.lanes, phase.name == "step"
    rows = Rows(transposed.gradients, tape, division.tape, lanes, stepwise)
    build.waiting(rows.bytes)
    with sweep(build, phase, "reverse") as s:
        code, function = s.code, s.function
        row = s.tape_row()
        fetch_ahead(s, division.reverse, tape, -AHEAD)
        slot = code.index(f"and i64 {s.relative}, {rows.steps - 1}")
        chunk_row = rows.row(code, field("chunk"), slot)
        values = s.values(program, rows.homes(chunk_row))
        for value in division.tape:
            values.bind(value, tape.address(value, row))
        _cotangents(s, values, transposed)
        # What is computed again has the bits that it had: a maximum is compared with its terms.
        later = dependents(program, transposed.cotangents)
        body.write(values, division.reverse, transposed.required(), later)
        step_row = function.row(field("step_sums"), s.t, "step_sums") if stepwise else None
        sums = function.sums(step_row)
        accumulate(values, rows, sums, row, chunk_row)
        _pass_back(s, values, transposed)
        if rows.fields:
            with code.branch(code.index(f"icmp eq i64 {slot}, 0")):
                rows.gather(code, sums, row, chunk_row, _waiting(s, rows))
        build.used(values.workspace)


def _waiting(s: KernelSweep, rows: Rows) -> str:
    """Number of steps that wait to be gathered: all slots, or the remaining steps."""
    code = s.code
    left = code.index(f"sub nsw i64 %end, {s.t}") if s.stepwise else "1"
    below = code.index(f"icmp slt i64 {left}, {rows.steps}")
    return code.index(f"select i1 {below}, i64 {left}, i64 {rows.steps}")


def _cotangents(s: KernelSweep, values: EmittedValues, transposed: Transposed) -> None:
    """Binds the cotangents of this phase's outputs."""
    layouts, final = s.build.layouts, s.phase.name == "final"
    layout = layouts["weights" if final else "cotangent"]
    base = s.block_row("weights") if final else field("cotangent")
    for value, i in zip(transposed.cotangents, transposed.moving):
        values.bind(value, layout.address(s.phase.outputs[i][0], base))
        if value.size <= BIG:
            values.small(value)
    if len(transposed.cotangents) > len(transposed.moving):
        bound = layouts["bounds"].address("bound", s.block_row("bounds"))
        values.bind(transposed.cotangents[-1], bound)


def _pass_back(s: KernelSweep, values: EmittedValues, transposed: Transposed) -> None:
    """Writes the cotangents of this phase's inputs."""
    layouts = s.build.layouts
    pairs: list[tuple[ProgramValue, ArrayPlace]] = []
    for value, i in zip(transposed.back, transposed.active):
        key = s.phase.inputs[i][0]
        if key[0] == "start":
            position = layouts["start_cotangent"].address(key, s.block_row("start_cotangent"))
        else:
            position = layouts["cotangent"].address(key, field("cotangent"))
        pairs.append((value, position))
    replace_all(values, pairs)


def run(build: Build) -> None:
    """The function `run(context, first block, last block)`: it runs every block forward, and in an
    adjoint kernel also backward.

    A horizon whose tape would be too long is divided into segments: the carry at each segment's
    start is saved on the way forward, and on the way back a segment goes forward again, with a
    tape. Several columns of weights are propagated backwards one after the other, over the same
    tape.
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
        """A reverse sweep of every column, with the column's table."""
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
    program = flatten.forward(phase.cut.path, _avals(phase))
    program = optimize(program, build.equal(program, phase.cut.path.reads))
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
    program = optimize(both.program, build.equal(both.program, path.reads))
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


@dataclass(frozen=True)
class KernelCode:
    """All that is needed to run a kernel: the text of its module, and the bytes of its rows.

    - `strides`: {layout: bytes of a row}; `sizes`: {name: bytes of scratch memory}.
    - `filled`: {layout: bytes of a row that come from the caller}; `prepare` computes the others.
    """

    text: str
    adjoint: bool
    strides: dict[str, int]
    filled: dict[str, int]
    sizes: dict[str, int]

    @property
    def entries(self) -> dict[str, int]:
        """The functions that are called from outside, with the number of their integers."""
        both = {"prepare": 0, "run": 2}
        return both | {"finish": 0} if self.adjoint else both


@dataclass(eq=False)
class Kernel:
    """The text of a module, and how memory is laid out for it."""

    text: str
    lanes: int
    trees: KernelTrees
    layouts: Layouts
    sizes: dict[str, int]

    @property
    def code(self) -> KernelCode:
        """The data needed to run it, without the conversion back to the caller's trees."""
        strides = {name: layout.stride for name, layout in self.layouts.items()}
        leaves = {"table": self.trees.call, "steps": self.trees.now}
        filled = {name: self.layouts[name].size_to(keys) for name, keys in leaves.items()}
        return KernelCode(self.text, self.trees.setup.adjoint, strides, filled, self.sizes)


def emit(traced: Traced, processor: Processor, stages: KernelStages | None = None) -> Kernel:
    """Writes every function of a kernel, and appends the intermediate programs to `stages`."""
    build = Build.start(traced, processor, stages)
    shared.trace(build)
    for name in ("initial", "step", "final"):
        emit_phase(build, traced.phases[name])
    shared.prepare(build)
    if build.adjoint:
        shared.finish(build)
    run(build)
    sizes = {"work": build.work, "chunk": build.chunk}
    return Kernel(build.module.text(), build.module.lanes, traced, build.layouts, sizes)
