"""The forward sweep of a phase: inputs, operations, the tape, outputs."""

from snapo.lanes.body import operations
from snapo.lanes.emit.storage import ArrayPlace
from snapo.lanes.emit.values import EmittedValues
from snapo.lanes.program.program import BIG, Op, Program, ProgramValue

from ..rollout import Phase
from . import noise
from .context import Build, field
from .layouts import TAPES
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
        operations.write(values, ops, [*outputs, *taped])
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
    """Where an array of the path lies that is given to this phase."""
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
