"""The forward and the reverse sweep of one phase, as functions of a kernel.

In an adjoint kernel both come from one joint program: its primal part, with what the tape needs,
is the forward sweep; the rest, with what is computed again, is the reverse sweep.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from . import gradients, noise, passes, trace
from .body import Body, Workspace
from .code import Code
from .program import Value
from .rollout import Phase
from .storage import Place, row_major

AHEAD = 2  # rows of tape that are fetched before they are needed


class PhaseEmitter:
    """The forward and the reverse sweep of one phase."""

    ARGUMENTS = ", i64 %block, i64 %begin, i64 %end, i64 %stride"

    def __init__(self, owner, phase: Phase):
        self.owner, self.phase = owner, phase
        self.layouts = owner.layouts
        self.name = phase.name
        self.tape = {"initial": "tape_initial", "step": "tape", "final": "tape_final"}[self.name]

    def emit(self) -> None:
        if self.owner.adjoint:
            self.joint()
        else:
            self.program = passes.optimize(trace.forward(self.phase.cut.path, self.avals()))
            self.owner.show(f"{self.name}: one path", self.program)
            self.outputs = self.program.outputs
            self.forward(self.program.ops, [])

    def avals(self) -> list:
        return [aval for _, aval in self.phase.inputs]

    # The forward sweep.

    def forward(self, ops, taped: list[Value]) -> None:
        owner = self.owner
        code = owner.function(f"{self.name}_forward", self.ARGUMENTS)
        tape = owner.field(code, self.tape)
        for value in taped:
            self.layouts[self.tape].add(value, value.shape, value.dtype)
        self.common(code)
        with self.steps(code) as t:
            relative = code.index(f"sub nsw i64 {t}, %begin")
            row = code.pointer(tape, code.index(f"mul nsw i64 {relative}, %stride"))
            homes = {v: self.layouts[self.tape].place(v, row) for v in taped}
            body = Body(code, Workspace(self.work), homes)
            piece = self.phase.cut.path
            owner.reads(body, self.program, piece, self.table, self.row(code, t))
            self.inputs(code, body, t, ops, taped)
            body.run(ops, [*self.outputs, *taped])
            self.deliver(code, body, t)
            owner.used(body.workspace)
        owner.close(code)

    def common(self, code: Code) -> None:
        owner = self.owner
        self.table, self.steps_base = owner.field(code, "table"), owner.field(code, "steps")
        self.work = owner.field(code, "work")

    def row(self, code: Code, t: str) -> str:
        return self.owner.row(code, self.steps_base, t, "steps")

    @contextmanager
    def steps(self, code: Code, down: bool = False) -> Iterator[str]:
        """The loop over time; the other phases happen once."""
        if self.name != "step":
            yield "%begin"
            return
        with code.loop("%end", first="%begin", down=down) as time:
            yield time.i

    def inputs(self, code: Code, body: Body, t: str, ops, taped) -> None:
        """Binds the path's arrays: carry, noise, actions, given states."""
        owner = self.owner
        read = {v for op in ops for v in op.inputs} | set(taped) | set(self.outputs)
        piece = self.phase.cut.path
        for value, (key, _) in zip(self.program.inputs[len(piece.reads) :], self.phase.inputs):
            if value not in read:
                continue
            if key == "noise":
                self.noise(code, body, value, t)
            elif key == "action":
                base = self.block_row(code, "actions", t)
                body.where[value] = self.layouts["actions"].place(key, base)
            else:
                layout = "start" if key[0] == "start" else "carry"
                base = owner.field(code, layout)
                if layout == "start":
                    base = code.pointer(
                        base, code.index(f"mul nsw i64 %block, {self.layouts[layout].stride}")
                    )
                body.where[value] = self.layouts[layout].place(key, base)
            if value.size <= passes.BIG:
                body.small(value)

    def block_row(self, code: Code, layout: str, t: str) -> str:
        """A row of [blocks, steps, ...]."""
        length = self.owner.field(code, "length")
        index = code.index(f"mul nsw i64 %block, {length}")
        index = code.index(f"add nsw i64 {index}, {t}")
        return self.owner.row(code, self.owner.field(code, layout), index, layout)

    def noise(self, code: Code, body: Body, value: Value, t: str) -> None:
        owner, setup = self.owner, self.owner.traced.setup
        initial = self.name == "initial"
        if not setup.counter:
            self.supplied(code, body, value, "noise_initial" if initial else "noise", t)
            return
        if not value.size:
            body.set(value, np.empty(value.shape, object))
            return
        size, steps = value.size, 1 if initial else noise.ahead(value.size)
        rows = steps * size + noise.SPARE
        out = body.workspace.allocate((rows,), value.dtype, code.lanes)
        words = body.workspace.allocate((rows,), np.uint32, code.lanes)
        name = noise.draw_function(code.module, size, value.dtype.name, setup.antithetic)
        key = code.pointer(owner.field(code, "keys"), 8 if initial else 0)
        lanes = code.index(f"mul nsw i64 %block, {4 * code.lanes}")
        paths = code.pointer(owner.field(code, "paths"), lanes)

        def draw(first: str, count: str) -> None:
            code.do(
                f"call void @{name}(ptr {key}, ptr {paths}, i64 {first}, i64 {count}, "
                f"ptr {code.pointer(out.base, out.offset)}, "
                f"ptr {code.pointer(words.base, words.offset)})"
            )

        if initial:
            draw("0", "1")
            base = out.base
        else:
            relative = code.index(f"sub nsw i64 {t}, %begin")
            slot = code.index(f"and i64 {relative}, {steps - 1}")
            with code.branch(code.index(f"icmp eq i64 {slot}, 0")):
                left = code.index(f"sub nsw i64 %end, {t}")
                below = code.index(f"icmp slt i64 {left}, {steps}")
                first = code.index(f"add nsw i64 {t}, {owner.field(code, 'first')}")
                draw(first, code.index(f"select i1 {below}, i64 {left}, i64 {steps}"))
            row = code.index(f"mul nsw i64 {slot}, {size * out.unit}")
            base = code.pointer(out.base, row)
        shape = value.shape
        body.where[value] = Place(
            base, out.offset, shape, row_major(shape), value.dtype, code.lanes
        )

    def supplied(self, code: Code, body: Body, value: Value, slot: str, t: str) -> None:
        """Given numbers [steps, paths, size], gathered from where the caller has them."""
        owner, size = self.owner, value.size
        unit = value.dtype.itemsize
        row = code.index(f"mul nsw i64 {t}, {owner.field(code, 'count')}")
        base = code.pointer(
            owner.field(code, slot), code.index(f"mul nsw i64 {row}, {size * unit}")
        )
        lanes = code.index(f"mul nsw i64 %block, {8 * code.lanes}")
        position = code.load(
            code.pointer(owner.field(code, "positions"), lanes), "int64", code.lanes, True
        )
        offsets = code.mul(position, code.constant(size * unit, "int64"))
        if size <= passes.BIG:
            refs = [
                code.gather(code.pointer(base, k * unit), offsets, value.dtype) for k in range(size)
            ]
            items = np.empty(size, object)
            items[:] = refs
            body.set(value, items.reshape(value.shape))
            return
        place = body.target(value)
        with code.loop(size) as loop:
            here = code.pointer(base, code.index(f"mul nsw i64 {loop.i}, {unit}"))
            place.write(code, [loop.i], code.gather(here, offsets, value.dtype))
        body.where[value] = place

    def deliver(self, code: Code, body: Body, t: str) -> None:
        """Writes the outputs: the next carry, totals and final states, records."""
        owner = self.owner
        carry: list[tuple[Value, Place]] = []
        for value, (key, _) in zip(self.outputs, self.phase.outputs):
            if key[0] == "scale":
                continue
            if key[0] == "record":
                place = self.layouts["records"].place(key, self.block_row(code, "records", t))
                body.copy(value, place)
            elif key[0] in ("final", "end"):
                base = owner.row(code, owner.field(code, "final"), "%block", "final")
                body.copy(value, self.layouts["final"].place(key, base))
            else:
                carry.append((value, self.layouts["carry"].place(key, owner.field(code, "carry"))))
        replace_all(body, carry)

    # The joint program, its division, and the reverse sweep.

    def joint(self) -> None:
        phase, cut = self.phase, self.phase.cut
        moving = [
            i for i, (key, aval) in enumerate(phase.outputs)
            if key[0] in ("state", "total", "final") and np.issubdtype(aval.dtype, np.floating)
        ]  # fmt: skip
        active = [
            i for i, (key, aval) in enumerate(phase.inputs)
            if key not in ("noise", "action") and np.issubdtype(aval.dtype, np.floating)
        ]  # fmt: skip
        bound = self.owner.traced.bound if self.name == "step" else None
        joint = trace.joint(cut.path, moving, self.avals(), active, bound)
        self.moving, self.active, self.slots = moving, active, joint.read_slots
        self.program = program = passes.optimize(joint.program)
        self.owner.show(f"{self.name}: one path and its transpose", program)
        count = joint.outputs
        self.outputs = program.outputs[:count]
        reads = program.outputs[count : count + len(joint.read_slots)]
        self.back = program.outputs[count + len(joint.read_slots) :]
        known = len(cut.path.reads) + len(phase.inputs)
        cotangents = program.inputs[known:]
        later = passes.dependents(program, cotangents)
        self.gradients = gradients.plan(
            program, later, [cut.path.reads[s] for s in self.slots], reads
        )
        wanted = [*self.back, *self.gradients.wanted(later)]
        kept = self.gradients.kept(later)
        division = passes.plan(program, cotangents, self.outputs, wanted, kept)
        self.forward(division.forward, division.tape)
        self.reverse(division, cotangents, wanted)

    def reverse(self, division, cotangents: list[Value], wanted: list[Value]) -> None:
        owner = self.owner
        code = owner.function(f"{self.name}_reverse", self.ARGUMENTS)
        tape, chunk = owner.field(code, self.tape), owner.field(code, "chunk")
        stepwise = self.name == "step"
        rows = gradients.Rows(
            self.gradients, self.layouts[self.tape], division.tape, code, stepwise
        )
        owner.chunk = max(owner.chunk, rows.bytes)
        self.common(code)
        calls, sums = owner.field(code, "call_sums"), owner.field(code, "step_sums")
        with self.steps(code, down=True) as t:
            relative = code.index(f"sub nsw i64 {t}, %begin")
            row = code.pointer(tape, code.index(f"mul nsw i64 {relative}, %stride"))
            if stepwise:
                fetch_ahead(code, row, self.layouts[self.tape].stride)
            slot = code.index(f"and i64 {relative}, {rows.steps - 1}")
            chunk_row = rows.row(code, chunk, slot)
            body = Body(code, Workspace(self.work), rows.homes(chunk_row))
            owner.reads(body, self.program, self.phase.cut.path, self.table, self.row(code, t))
            for value in division.tape:
                body.where[value] = self.layouts[self.tape].place(value, row)
            self.cotangents(code, body, cotangents)
            body.run(division.reverse, wanted)
            step_row = owner.row(code, sums, t, "step_sums") if stepwise else None
            gradients.accumulate(body, rows, owner, calls, step_row, row, chunk_row)
            self.pass_back(code, body)
            if rows.fields:
                with code.branch(code.index(f"icmp eq i64 {slot}, 0")):
                    left = code.index(f"sub nsw i64 %end, {t}") if stepwise else "1"
                    below = code.index(f"icmp slt i64 {left}, {rows.steps}")
                    count = code.index(f"select i1 {below}, i64 {left}, i64 {rows.steps}")
                    rows.gather(code, owner, calls, row, chunk_row, count)
            owner.used(body.workspace)
        owner.close(code)

    def cotangents(self, code: Code, body: Body, cotangents: list[Value]) -> None:
        """Reads the cotangents of what this phase gave."""
        owner = self.owner
        layout = "weights" if self.name == "final" else "cotangent"
        base = owner.field(code, layout)
        if layout == "weights":
            base = owner.row(code, base, "%block", layout)
        for value, i in zip(cotangents, self.moving):
            body.where[value] = self.layouts[layout].place(self.phase.outputs[i][0], base)
            if value.size <= passes.BIG:
                body.small(value)
        if len(cotangents) > len(self.moving):
            base = owner.row(code, owner.field(code, "bounds"), "%block", "bounds")
            body.where[cotangents[-1]] = self.layouts["bounds"].place("bound", base)

    def pass_back(self, code: Code, body: Body) -> None:
        """Writes the cotangents of what this phase was given."""
        owner = self.owner
        pairs = []
        for value, i in zip(self.back, self.active):
            key = self.phase.inputs[i][0]
            if key[0] == "start":
                base = owner.row(
                    code, owner.field(code, "start_cotangent"), "%block", "start_cotangent"
                )
                pairs.append((value, self.layouts["start_cotangent"].place(key, base)))
            else:
                pairs.append(
                    (value, self.layouts["cotangent"].place(key, owner.field(code, "cotangent")))
                )
        replace_all(body, pairs)


def fetch_ahead(code: Code, row: str, stride: int) -> None:
    """Asks for the rows of the tape that come next: they descend, which no processor guesses."""
    code.module.declare("declare void @llvm.prefetch.p0(ptr, i32, i32, i32)")
    lines = stride // 64
    with code.loop(-(-lines // 4)) as loop:
        at = code.pointer(row, code.index(f"mul nsw i64 {loop.i}, 256"))
        for line in range(4):
            ahead = code.pointer(at, 64 * line - AHEAD * stride)
            code.do(f"call void @llvm.prefetch.p0(ptr {ahead}, i32 0, i32 2, i32 1)")


def replace_all(body: Body, pairs: list[tuple[Value, Place]]) -> None:
    """Writes new values over old ones that some of them may still be views of."""
    for value, place in pairs:
        known = body.get(value)
        if (
            isinstance(known, Place)
            and known.base in ("%c_carry", "%c_cotangent")
            and not _same(known, place)
        ):
            aside = body.workspace.allocate(known.shape, known.dtype, known.lanes)
            body.copy(value, aside)
            body.where[value] = aside
    for value, place in pairs:
        known = body.get(value)
        if not (isinstance(known, Place) and _same(known, place)):
            body.copy(value, place)


def _same(a: Place, b: Place) -> bool:
    return a.base == b.base and a.offset == b.offset and a.strides == b.strides
