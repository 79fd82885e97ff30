"""The kernel under construction: its rows of memory, its functions and their table of addresses."""

from dataclasses import dataclass

import numpy as np

from snapo.lanes.emit.code import Code
from snapo.lanes.emit.module import Module
from snapo.lanes.emit.storage import Layout, Shared
from snapo.lanes.emit.values import Workspace
from snapo.lanes.machine.pipeline import Processor
from snapo.lanes.program.cut import Leaf, Piece
from snapo.lanes.program.passes import Replaced
from snapo.lanes.program.program import Program, ProgramValue, walk

from ..rollout import Traced

Layouts = dict[str, Layout]

SHARED = ("table", "steps", "call_sums", "step_sums")
TAPES = {"initial": "tape_initial", "step": "tape", "final": "tape_final"}  # by phase
BLOCKS = (
    "carry", "cotangent", "start", "start_cotangent", "final", "weights", "records", "bounds",
    "actions", *TAPES.values(),
)  # fmt: skip


def layouts(t: Traced, lanes: int) -> Layouts:
    """The rows of one kernel by name; the rows of tapes are filled when a sweep is written."""
    rows = {name: Layout(1) for name in SHARED} | {name: Layout(lanes) for name in BLOCKS}
    _shared(rows, t)
    _state(rows, t)
    _totals(rows, t)
    step = t.phases["step"]
    for key, aval in step.outputs:
        if key[0] == "record":
            rows["records"].add(key, aval.shape, aval.dtype)
    for key, aval in step.inputs:
        if key == "action":
            rows["actions"].add(key, aval.shape, aval.dtype)
    return rows


def _shared(rows: Layouts, t: Traced) -> None:
    """Tables of the call and of its steps, and in float64 the sums of their gradients."""
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


def _state(rows: Layouts, t: Traced) -> None:
    """A path's state: current, initial and final; and the adjoints of the first two."""
    for i, x in enumerate(t.state):
        for name, key in (("carry", "state"), ("start", "start"), ("final", "end")):
            rows[name].add((key, i), x.shape, x.dtype)
        if x.dtype == t.setup.dtype:
            rows["cotangent"].add(("state", i), x.shape, x.dtype)
            rows["start_cotangent"].add(("start", i), x.shape, x.dtype)


def _totals(rows: Layouts, t: Traced) -> None:
    """A path's totals, their weights, and the bound of its adjoint with the share it keeps."""
    real = np.dtype(t.setup.dtype)
    for n in t.names:
        rows["carry"].add(("total", n), (), real)
        rows["cotangent"].add(("total", n), (), real)
    for n in t.final_names:
        rows["final"].add(("final", n), (), real)
        rows["weights"].add(("final", n), (), real)
    rows["bounds"].add("bound", (2,), real)


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
    """One function of the kernel while it is generated."""

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
        """The sums of the gradients of shared arrays, with those of the step in `step_row`."""
        calls, steps = self.layouts["call_sums"], self.layouts["step_sums"]
        return Shared(calls, steps, field("call_sums"), step_row)

    def close(self) -> None:
        """Ends the function and adds it to the module."""
        self.code.do("ret void")
        self.code.define(self.header)


@dataclass(eq=False)
class Build:
    """The common state of the functions of a kernel while they are generated.

    - `shared`: the programs of the pieces that are computed once for all paths; `first`: for each
      output, the first output that is the same number.
    - `work`, `chunk`: the bytes of scratch memory that one thread needs for arrays between two
      regions, and for rows that wait to be summed; both are the maximum over all functions.
    """

    traced: Traced
    processor: Processor
    module: Module
    layouts: Layouts
    stages: KernelStages | None
    shared: dict[Piece, Program]
    first: dict[Leaf, Leaf]
    work: int = 0
    chunk: int = 0

    @classmethod
    def start(cls, traced: Traced, processor: Processor, stages: KernelStages | None) -> "Build":
        lanes = processor.lanes(traced.setup.dtype)
        module = Module(lanes, processor.register)
        return cls(traced, processor, module, layouts(traced, lanes), stages, {}, {})

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

    def equal(self, program: Program, reads: list[Leaf]) -> Replaced:
        """The inputs of a program that repeat earlier ones; `reads` are the first inputs."""
        first: dict[Leaf, ProgramValue] = {}
        pairs = [
            (value, first.setdefault(self.first.get(leaf, leaf), value))
            for value, leaf in zip(program.inputs, reads)
        ]
        return {value: other for value, other in pairs if other is not value}

    def workspace(self) -> Workspace:
        """Scratch memory for one function; `used` is its size."""
        return Workspace(field("work"))

    def used(self, workspace: Workspace) -> None:
        self.work = max(self.work, workspace.size)

    def waiting(self, size: int) -> None:
        """Reserves this many bytes for the waiting rows of a function."""
        self.chunk = max(self.chunk, size)

    def show(self, title: str, program: Program) -> None:
        """Adds a program to the stages of an explanation."""
        if self.stages is not None:
            self.stages.append((title, "\n".join(walk(program))))
