"""One sweep of a phase while it is written: its function, its arrays, the current step."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from snapo.lanes.emit.code import Code
from snapo.lanes.emit.storage import ArrayPlace
from snapo.lanes.emit.values import EmittedValues
from snapo.lanes.program.program import Program, ProgramValue

from ..rollout import Phase
from .context import TAPES, Build, Function, field
from .shared import bind

ARGUMENTS = ", i64 %block, i64 %begin, i64 %end, i64 %stride"


@dataclass(eq=False)
class KernelSweep:
    """One sweep of a phase at step `t`; `relative` counts from the segment's first step."""

    build: Build
    phase: Phase
    function: Function
    t: str
    relative: str

    @property
    def code(self) -> Code:
        return self.function.code

    @property
    def initial(self) -> bool:
        return self.phase.name == "initial"

    @property
    def stepwise(self) -> bool:
        return self.phase.name == "step"

    def tape_row(self) -> str:
        """The address of this step's row of the tape."""
        distance = self.code.index(f"mul nsw i64 {self.relative}, %stride")
        return self.code.pointer(field(TAPES[self.phase.name]), distance)

    def values(self, program: Program, homes: dict[ProgramValue, ArrayPlace]) -> EmittedValues:
        """The arrays of a program; those that all paths share already have values."""
        values = EmittedValues(self.code, self.build.workspace(), homes)
        row = self.function.row(field("steps"), self.t, "steps")
        bind(values, program, self.phase.cut.path, self.function.tables(row), fixed=True)
        return values

    def block_row(self, layout: str) -> str:
        """This block's row of [blocks, ...]."""
        return self.function.row(field(layout), "%block", layout)

    def step_row(self, layout: str) -> str:
        """This block's and step's row of [blocks, steps, ...]."""
        index = self.code.index(f"mul nsw i64 %block, {field('length')}")
        index = self.code.index(f"add nsw i64 {index}, {self.t}")
        return self.function.row(field(layout), index, layout)


@contextmanager
def sweep(build: Build, phase: Phase, direction: str) -> Iterator[KernelSweep]:
    """The function of one sweep; only the sweep of a step has a loop over time."""
    function = build.function(f"{phase.name}_{direction}", ARGUMENTS)
    code = function.code
    if phase.name == "step":
        with code.loop("%end", first="%begin", down=direction == "reverse") as time:
            yield _at(build, phase, function, time.i)
    else:
        yield _at(build, phase, function, "%begin")
    function.close()


def _at(build: Build, phase: Phase, function: Function, t: str) -> KernelSweep:
    relative = function.code.index(f"sub nsw i64 {t}, %begin")
    return KernelSweep(build, phase, function, t, relative)


def replace_all(values: EmittedValues, pairs: list[tuple[ProgramValue, ArrayPlace]]) -> None:
    """Writes new values over old ones that some of them may still be views of."""
    for value, position in pairs:
        available = values.get(value)
        if (
            isinstance(available, ArrayPlace)
            and available.base in (field("carry"), field("cotangent"))
            and not _same(available, position)
        ):
            aside = values.workspace.allocate(available.shape, available.dtype, available.lanes)
            values.copy(value, aside)
            values.bind(value, aside)
    for value, position in pairs:
        available = values.get(value)
        if not (isinstance(available, ArrayPlace) and _same(available, position)):
            values.copy(value, position)


def _same(a: ArrayPlace, b: ArrayPlace) -> bool:
    return a.base == b.base and a.offset == b.offset and a.strides == b.strides
