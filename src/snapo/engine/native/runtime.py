"""Running a kernel: blocks of paths over threads, sums in a fixed order."""

import os
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from snapo.lanes.machine.linked import KernelMemory, Linked, address
from snapo.lanes.machine.threads import spread

from .kernel.context import CONTEXT
from .kernel.kernel import Kernel

TAPE = 256 * 2**20  # bytes of tape per thread; longer horizons are done in segments, twice forward
SUMS = 256 * 2**20  # bytes of gradients of all groups together
SLOTS = {name: i for i, name in enumerate(CONTEXT)}
SPARE = 2**30  # bytes of scratch memory that all kernels together keep between calls
GROUPS = 32  # independent partial sums: fixed, so that threads do not change the answer


@dataclass(eq=False)
class KernelInputs:
    """All that one run reads, as rows of the kernel's layouts; weights for each column.

    `edges`: the blocks at which parts of the paths begin, whose sums are kept apart.
    """

    paths: int
    length: int
    first: int
    memory: KernelMemory
    records: bool = False
    columns: int = 1
    edges: np.ndarray | None = None


@dataclass(eq=False)
class KernelOutputs:
    """All that one run writes, as rows of layouts; in an adjoint kernel the sums of each column."""

    final: np.ndarray
    records: np.ndarray | None
    back: list["Back"] = field(default_factory=list)


@dataclass(eq=False)
class Back:
    """One column of an adjoint: sums over paths, and the cotangents of given states."""

    call_sums: np.ndarray
    step_sums: np.ndarray
    start_cotangent: np.ndarray


class Runner:
    """A compiled kernel, with scratch memory that is used again from call to call."""

    def __init__(self, kernel: Kernel, machine: Linked):
        self.kernel, self.machine = kernel, machine
        self.reference = weakref.ref(self)

    def blocks(self, paths: int) -> int:
        return -(-paths // self.kernel.lanes)

    def run(self, inputs: KernelInputs, threads: int) -> KernelOutputs:
        """All blocks, forward and (in an adjoint kernel) back, for every column of weights."""
        layouts, adjoint = self.kernel.layouts, self.kernel.traced.setup.adjoint
        columns, length, edges = inputs.columns, inputs.length, inputs.edges
        calls, steps = self.sums(length)
        item, blocks = calls + steps, self.blocks(inputs.paths)
        if edges is None:
            groups = _groups(blocks, item if adjoint else 0)
            edges = blocks * np.arange(groups + 1) // groups
        groups, blocks = len(edges) - 1, int(edges[-1])
        starts = blocks * layouts["start_cotangent"].stride
        sizes = {"stop": 8, "final": blocks * layouts["final"].stride}
        if inputs.records:
            sizes["records"] = blocks * length * layouts["records"].stride
        if adjoint:
            sizes["start_cotangent"] = columns * starts
            sizes["total"], sizes["sums"] = columns * item, groups * columns * item
        memory = KernelMemory(sizes)
        segment = self.segment(length)
        numbers = {"length": length, "first": inputs.first, "count": inputs.paths}
        numbers |= {"segment": segment, "columns": columns}
        context = _context(inputs.memory.where | memory.where | numbers, columns)
        _apart(context, "weights", blocks * layouts["weights"].stride)
        _apart(context, "start_cotangent", starts)
        scratch = self._scratch(segment, -(-length // segment), columns)
        functions = self.machine.functions

        # A helper may continue after an interrupt: its work keeps the memory and the code alive.
        def one(
            group: int, context: np.ndarray, _held: tuple = (inputs, memory, self.machine)
        ) -> None:
            if adjoint:
                _add_up_in(context, memory.where["sums"] + group * columns * item, calls, item)
            functions["run"](address(context), int(edges[group]), int(edges[group + 1]))

        mine = partial(self._own, context, scratch)
        with mine() as local:
            functions["prepare"](address(local))
        spread(one, groups, min(threads, groups), memory["stop"], mine)
        out = KernelOutputs(memory["final"], memory.rows.get("records"))
        if adjoint:
            out.back = self._back(memory, mine, inputs, (groups, columns), (calls, steps))
        return out

    def _back(self, memory: KernelMemory, mine, inputs: KernelInputs, shape, sizes) -> list["Back"]:
        """The sums of every column, finished: over all paths, or over each part of them."""
        (groups, columns), (calls, steps) = shape, sizes
        rows, name, stride = memory["sums"], "sums", calls + steps
        if inputs.edges is None:
            rows, name = memory["total"], "total"
            sums = memory["sums"].view(np.float64).reshape(groups, -1)
            np.sum(sums, axis=0, out=rows.view(np.float64))
        rows = rows.reshape(-1, columns, stride)
        with mine() as local:
            for part in range(len(rows)):
                _add_up_in(local, memory.where[name] + part * columns * stride, calls, stride)
                for column in local:
                    self.machine.functions["finish"](address(column))
        rows = rows[0] if inputs.edges is None else rows
        left = memory["start_cotangent"].reshape(columns, -1)
        return [Back(rows[..., k, :calls], rows[..., k, calls:], left[k]) for k in range(columns)]

    def together(self, paths: int, length: int) -> int:
        """The maximum number of columns of one run, limited by memory for their gradients."""
        item = sum(self.sums(length))
        return int(max(1, SUMS // max(1, _groups(self.blocks(paths), item) * item)))

    def sums(self, length: int) -> tuple[int, int]:
        """Bytes of the gradients with respect to numbers of the call, and those of all steps."""
        layouts = self.kernel.layouts
        return layouts["call_sums"].stride, length * layouts["step_sums"].stride

    def segment(self, length: int) -> int:
        """Steps whose tape is kept at once. It does not depend on the number of threads."""
        if not self.kernel.traced.setup.adjoint:
            return length
        return int(min(length, max(1, TAPE // self.kernel.layouts["tape"].stride)))

    def _scratch(self, segment: int, segments: int, columns: int) -> dict[str, int]:
        """The sizes of one thread's scratch memory."""
        layouts, sizes = self.kernel.layouts, self.kernel.sizes
        return {
            "work": sizes["work"], "carry": layouts["carry"].stride,
            "cotangent": columns * layouts["cotangent"].stride,
            "tape_initial": layouts["tape_initial"].stride,
            "tape_final": layouts["tape_final"].stride,
            "tape": segment * layouts["tape"].stride, "chunk": sizes["chunk"],
            "saved": segments * layouts["carry"].stride,
        }  # fmt: skip

    @contextmanager
    def _own(self, context: np.ndarray, sizes: dict[str, int]) -> Iterator[np.ndarray]:
        """The context with separate scratch memory."""
        scratch = spare.take(self)
        if scratch is None or not scratch.suffices(sizes):
            scratch = KernelMemory(sizes)
        local = context.copy()
        for name, position in scratch.where.items():
            local[:, SLOTS[name]] = position
        _apart(local, "cotangent", self.kernel.layouts["cotangent"].stride)
        try:
            yield local
        finally:
            spare.give(self, scratch)


class Spare:
    """Scratch memory between calls: of all kernels together, at most `SPARE` bytes.

    Memory returns to the kernel that had it; memory unused for longest is freed first.
    """

    def __init__(self):
        self._lock = threading.Lock()
        self._waiting: list[tuple[weakref.ref[Runner], KernelMemory]] = []
        self._bytes = 0

    def take(self, runner: Runner) -> KernelMemory | None:
        """Memory that this kernel had before, the latest first; None where there is none."""
        with self._lock:
            for i in reversed(range(len(self._waiting))):
                if self._waiting[i][0]() is runner:
                    memory = self._waiting.pop(i)[1]
                    self._bytes -= memory.size
                    return memory
            self._keep([item for item in self._waiting if item[0]() is not None])
        return None

    def give(self, runner: Runner, memory: KernelMemory) -> None:
        """Keeps memory for this kernel's next call, if there is room."""
        with self._lock:
            self._waiting.append((runner.reference, memory))
            self._bytes += memory.size
            while self._bytes > SPARE:
                self._bytes -= self._waiting.pop(0)[1].size

    def _keep(self, waiting: list) -> None:
        self._waiting, self._bytes = waiting, sum(memory.size for _, memory in waiting)

    def bytes(self) -> int:
        """All that waits now."""
        with self._lock:
            return self._bytes


spare = Spare()


def _after_fork() -> None:
    spare.__init__()  # another thread may have held its lock


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def _context(values: dict[str, int], columns: int) -> np.ndarray:
    """[columns, slots]: the tables of addresses and numbers that kernel functions take."""
    return np.tile(np.array([values.get(name, 0) for name in CONTEXT], np.int64), (columns, 1))


def _apart(context: np.ndarray, name: str, size: int) -> None:
    """Every column's rows, of so many bytes, one column after the other."""
    context[:, SLOTS[name]] += size * np.arange(len(context))


def _add_up_in(context: np.ndarray, position: int, calls: int, stride: int) -> None:
    """By column, sums of the call from here on, then of the steps: `stride` bytes together."""
    positions = position + stride * np.arange(len(context))
    context[:, SLOTS["call_sums"]], context[:, SLOTS["step_sums"]] = positions, positions + calls


def _groups(blocks: int, size: int) -> int:
    """The number of partial sums: as many as memory allows, for any number of threads."""
    return int(max(1, min(blocks, GROUPS, SUMS // max(1, size))))
