"""The two sweeps of a phase: forward with its tape, and in reverse with its gradients."""

from dataclasses import dataclass

from snapo.lanes import body
from snapo.lanes.emit.code import Code
from snapo.lanes.emit.storage import ArrayPlace
from snapo.lanes.emit.values import EmittedValues
from snapo.lanes.gradients.rows import Gradients, Rows, accumulate
from snapo.lanes.program.program import BIG, Op, Program, ProgramValue
from snapo.lanes.program.sweeps import SweepPlan, dependents

from ..rollout import Phase
from . import noise
from .context import TAPES, Build, field
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


@dataclass(eq=False)
class Transposed:
    """A phase's joint program, and the numbers of its outputs and inputs that have cotangents.

    - `cotangents`: those given, of the outputs `moving`; a last one holds the bound of clipping
      and the share that is kept.
    - `back`: those computed, of the inputs `active`.
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
        if stepwise:
            fetch_ahead(code, row, tape.stride)
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


def fetch_ahead(code: Code, row: str, stride: int) -> None:
    """Prefetches the next rows of the tape: they descend, which processors do not predict."""
    code.module.declare("declare void @llvm.prefetch.p0(ptr, i32, i32, i32)")
    lines = stride // 64
    with code.loop(-(-lines // 4)) as loop:
        at = code.pointer(row, code.index(f"mul nsw i64 {loop.i}, 256"))
        for line in range(4):
            ahead = code.pointer(at, 64 * line - AHEAD * stride)
            code.do(f"call void @llvm.prefetch.p0(ptr {ahead}, i32 0, i32 2, i32 1)")
