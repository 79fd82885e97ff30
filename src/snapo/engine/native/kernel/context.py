"""The kernel under construction: its functions, and the table of addresses that they read."""

from dataclasses import dataclass

from snapo.lanes.emit.code import Code
from snapo.lanes.emit.module import Module
from snapo.lanes.emit.shared import Shared
from snapo.lanes.emit.values import Workspace
from snapo.lanes.machine.processor import Processor
from snapo.lanes.program.program import Program, walk

from ..rollout import Traced
from .layouts import Layouts, layouts

# The table of addresses and numbers that every function reads. Every column of an adjoint, which
# is one weight of each total, has a table: only its own cotangents, weights and sums differ.
CONTEXT = (
    "table", "steps", "work", "carry", "cotangent", "tape_initial", "tape", "tape_final", "chunk",
    "saved", "call_sums", "step_sums", "keys", "paths", "positions", "noise_initial", "noise",
    "actions", "start", "final", "weights", "bounds", "start_cotangent", "records", "length",
    "first", "segment", "count", "stop", "columns",
)  # fmt: skip
NUMBERS = ("length", "first", "segment", "count", "columns")

KernelStages = list[tuple[str, str]]  # titles and programs as text


def field(slot: str) -> str:
    """The register with an entry of the table; each function begins by loading them all."""
    assert slot in CONTEXT
    return f"%c_{slot}"


@dataclass(eq=False)
class Function:
    """One function of the kernel while it is written."""

    header: str
    code: Code
    layouts: Layouts

    def row(self, base: str, number: str, layout: str) -> str:
        """The address of a row: `number` rows of the layout after `base`."""
        stride = self.layouts[layout].stride
        return self.code.pointer(base, self.code.index(f"mul nsw i64 {number}, {stride}"))

    def tables(self, step_row: str | None = None) -> Shared:
        """The arrays that all paths share, with those of the step in `step_row`."""
        return Shared(self.layouts["table"], self.layouts["steps"], field("table"), step_row)

    def sums(self, step_row: str | None = None) -> Shared:
        """The sums of gradients by the shared arrays, with those of the step in `step_row`."""
        calls, steps = self.layouts["call_sums"], self.layouts["step_sums"]
        return Shared(calls, steps, field("call_sums"), step_row)

    def close(self) -> None:
        """Ends the function and adds it to the module."""
        self.code.do("ret void")
        self.code.define(self.header)


@dataclass(eq=False)
class Build:
    """Everything that the functions of a kernel have in common while they are written.

    `work` and `chunk` are the bytes of scratch memory that one thread needs for arrays between
    two regions and for waiting rows: the most that any function asks for.
    """

    traced: Traced
    processor: Processor
    module: Module
    layouts: Layouts
    stages: KernelStages | None
    work: int = 0
    chunk: int = 0

    @classmethod
    def start(cls, traced: Traced, processor: Processor, stages: KernelStages | None) -> "Build":
        lanes = processor.lanes(traced.setup.dtype)
        module = Module(lanes, processor.register)
        return cls(traced, processor, module, layouts(traced, lanes), stages)

    @property
    def adjoint(self) -> bool:
        return self.traced.setup.adjoint

    def function(self, name: str, arguments: str = "") -> Function:
        """A new function of the kernel, with the table loaded."""
        code = Code(self.module.lanes, self.module)
        for i, slot in enumerate(CONTEXT):
            kind = "i64" if slot in NUMBERS else "ptr"
            code.do(f"%slot_{slot} = getelementptr i8, ptr %context, i64 {8 * i}")
            code.do(f"{field(slot)} = load {kind}, ptr %slot_{slot}, align 8, !invariant.load !0")
        header = f"define void @{name}(ptr noalias %context{arguments}) nounwind"
        return Function(header, code, self.layouts)

    def workspace(self) -> Workspace:
        """Scratch memory for one function; `used` tells how much of it there is."""
        return Workspace(field("work"))

    def used(self, workspace: Workspace) -> None:
        self.work = max(self.work, workspace.size)

    def waiting(self, size: int) -> None:
        """A function keeps waiting rows of this many bytes."""
        self.chunk = max(self.chunk, size)

    def show(self, title: str, program: Program) -> None:
        """Tells the reader of an explanation of a program."""
        if self.stages is not None:
            self.stages.append((title, "\n".join(walk(program))))
