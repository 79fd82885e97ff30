"""The functions of everything that paths share: computed before them, transposed after them."""

import numpy as np

from snapo.lanes import body
from snapo.lanes.emit.storage import ArrayPlace, Shared, Small
from snapo.lanes.emit.values import EmittedValues
from snapo.lanes.gradients.adding import add
from snapo.lanes.program.cut import Leaf, Piece
from snapo.lanes.program.flatten import forward, joint
from snapo.lanes.program.passes import optimize
from snapo.lanes.program.program import Op, Program, ProgramValue

from .context import Build, Function, field


def bind(
    values: EmittedValues, program: Program, piece: Piece, tables: Shared, fixed: bool
) -> None:
    """Binds the positions of all that a piece reads; if `fixed`, tables do not change."""
    for value, leaf in zip(program.inputs, piece.reads):
        values.bind(value, tables.address(leaf, fixed))


def trace(build: Build) -> None:
    """The programs of all that the paths share, and which of their outputs are equal.

    The functions of a simulator compute some numbers of a step separately, such as limits of the
    flow for the observation and for the step. Operations of paths on equal numbers are done once.
    """
    phases = build.traced.phases.values()
    pieces = [(phase.cut.call, phase.cut.call_leaves) for phase in phases]
    step = build.traced.phases["step"].cut
    for piece, leaves in [*pieces, (step.step, step.step_leaves)]:
        if not leaves:
            continue
        program = forward(piece, (), False)
        program = build.shared[piece] = optimize(program, build.equal(program, piece.reads))
        first: dict[ProgramValue, Leaf] = {}
        for value, leaf in zip(program.outputs, leaves):
            build.first[leaf] = first.setdefault(value, leaf)


def prepare(build: Build) -> None:
    """Writes the function that computes everything that the paths share."""
    function = build.function("prepare")
    for phase in build.traced.phases.values():
        tables = function.tables()
        _computed(build, function, phase.cut.call, phase.cut.call_leaves, tables, phase.name)
    step = build.traced.phases["step"].cut
    if step.step_leaves:
        with function.code.loop(field("length")) as loop:
            tables = function.tables(function.row(field("steps"), loop.i, "steps"))
            _computed(build, function, step.step, step.step_leaves, tables, "step")
    function.close()


def _computed(
    build: Build, function: Function, piece: Piece, leaves: list[Leaf], tables: Shared, name: str
) -> None:
    """A piece's outputs, written to their tables."""
    if not leaves:
        return
    program = build.shared[piece]
    build.show(f"{name}: computed once per {'step' if tables.step_row else 'call'}", program)
    homes: dict[ProgramValue, ArrayPlace] = {}
    for value, leaf in zip(program.outputs, leaves):
        homes.setdefault(value, tables.address(leaf))
    values = EmittedValues(function.code, build.workspace(), homes)
    bind(values, program, piece, tables, fixed=False)
    body.write(values, program.ops, program.outputs)
    for value, leaf in zip(program.outputs, leaves):
        array = tables.address(leaf)
        if homes[value].offset != array.offset or value.constant is not None:
            values.copy(value, array)
    build.used(values.workspace)


def finish(build: Build) -> None:
    """Writes the function of the transposes of `prepare`, on sums over paths."""
    function = build.function("finish")
    step = build.traced.phases["step"].cut
    if any(leaf.active for leaf in step.step_leaves):
        with function.code.loop(field("length")) as loop:
            tables = function.tables(function.row(field("steps"), loop.i, "steps"))
            sums = function.sums(function.row(field("step_sums"), loop.i, "step_sums"))
            _transposed(build, function, step.step, step.step_leaves, tables, sums)
    for phase in reversed(build.traced.phases.values()):
        values = function.tables(), function.sums()
        _transposed(build, function, phase.cut.call, phase.cut.call_leaves, *values)
    function.close()


def _transposed(
    build: Build, function: Function, piece: Piece, leaves: list[Leaf], tables: Shared, sums: Shared
) -> None:
    """The sums of a piece's outputs, transposed to the piece's inputs."""
    moving = [i for i, leaf in enumerate(leaves) if leaf.active]
    if not moving:
        return
    both = joint(piece, moving, own_path=False)
    back = both.program.outputs[both.outputs :]
    program = optimize(Program(both.program.inputs, both.program.ops, back))
    values = EmittedValues(function.code, build.workspace())
    bind(values, program, piece, tables, fixed=True)
    for value, i in zip(program.inputs[len(piece.reads) :], moving):
        values.bind(value, _narrowed(values, sums.address(leaves[i]), value))
    body.write(values, program.ops, program.outputs)
    for value, slot in zip(program.outputs, both.read_slots):
        add(values, value, sums.address(piece.reads[slot]))
    build.used(values.workspace)


def _narrowed(
    values: EmittedValues, position: ArrayPlace, value: ProgramValue
) -> Small | ArrayPlace:
    """Sums are kept in float64; the transposes run in the call's precision."""
    if value.dtype == np.float64:
        return position
    wide = ProgramValue(value.shape, np.dtype(np.float64))
    values.bind(wide, position)
    narrow = Op("convert_element_type", [wide], [value], {"new_dtype": value.dtype})
    body.write(values, [narrow], [value])
    return values.get(value)
