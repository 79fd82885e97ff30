"""Running a kernel: blocks of paths over threads, sums in a fixed order."""

import os
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from snapo.lanes.machine import disk
from snapo.lanes.machine.linked import KernelMemory, Linked, address
from snapo.lanes.machine.threads import spread

from .kernel.context import CONTEXT
from .kernel.kernel import Kernel, KernelCode

TAPE = 256 * 2**20  # bytes of tape per thread; longer horizons are done in segments, twice forward
SUMS = 256 * 2**20  # bytes of gradients of all groups together
SLOTS = {name: i for i, name in enumerate(CONTEXT)}
SPARE = 2**30  # bytes of scratch memory that kernels keep between calls, next to inputs
ADDED = slice(SLOTS["call_sums"], SLOTS["step_sums"] + 1)  # neighbours in the table
GROUPS = 32  # independent partial sums: fixed, so that threads do not change the answer


@dataclass(eq=False)
class KernelInputs:
    """Everything that one run reads, as rows of the kernel's layouts, with weights for each column.

    `edges`: the blocks at which parts of the paths begin, whose sums are separate.
    """

    paths: int
    blocks: int
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
    """One column of an adjoint: sums over paths, and the cotangents of supplied states."""

    call_sums: np.ndarray
    step_sums: np.ndarray
    start_cotangent: np.ndarray


class ThreadTable(NamedTuple):
    """One thread's table of addresses, [columns, slots], and its own address."""

    table: np.ndarray
    address: int


class GroupRunner:
    """The code of a kernel, with scratch memory that is used again from call to call.

    It computes groups of blocks; their sums are independent of one another, so that groups may be
    computed anywhere.
    """

    def __init__(self, code: KernelCode, machine: Linked):
        self.code, self.machine = code, machine
        self.reference = weakref.ref(self)

    @cached_property
    def name(self) -> str:
        """A name that is equal for kernels with the same results, to the last bit."""
        return disk.key(self.code.text)

    def prepared(self, inputs: KernelInputs) -> np.ndarray:
        """The tables of addresses of a run, after all that its paths share has been computed."""
        numbers = {"length": inputs.length, "first": inputs.first, "count": inputs.paths}
        numbers |= {"segment": self.segment(inputs.length), "columns": inputs.columns}
        context = _context(inputs.memory.where | numbers, inputs.columns)
        _apart(context, "weights", inputs.blocks * self.code.strides["weights"])
        with self._own(context, inputs) as local:
            self.machine.functions["prepare"](local.address)
        return context

    def groups(
        self, inputs: KernelInputs, context: np.ndarray, edges: np.ndarray, threads: int
    ) -> KernelMemory:
        """Rows of all blocks, and the sums of every group, from one of the `edges` to the next."""
        columns, adjoint = inputs.columns, self.code.adjoint
        memory = KernelMemory({"stop": 8, **self.results(inputs, len(edges) - 1)})
        calls, steps = self.sums(inputs.length)
        item, context = calls + steps, context.copy()
        for name in memory.where.keys() & SLOTS.keys():
            context[:, SLOTS[name]] = memory.where[name]
        _apart(context, "start_cotangent", inputs.blocks * self.code.strides["start_cotangent"])
        run = self.machine.functions["run"]

        count, starts = len(edges) - 1, edges.tolist()
        sums = _sums(memory.where["sums"], (count, columns), calls, item) if adjoint else None

        # A helper may continue after an interrupt: its work keeps the memory and the code alive.
        def one(
            group: int, local: ThreadTable, _held: tuple = (inputs, memory, self.machine)
        ) -> None:
            if sums is not None:
                local.table[:, ADDED] = sums[group]
            run(local.address, starts[group], starts[group + 1])

        mine = partial(self._own, context, inputs)
        spread(one, count, min(threads, count), memory["stop"], mine)
        return memory

    def results(self, inputs: KernelInputs, groups: int) -> dict[str, int]:
        """{row: bytes} that `groups` returns: the rows of blocks, and the sums of groups."""
        strides, blocks = self.code.strides, inputs.blocks
        sizes = {"final": blocks * strides["final"]}
        if inputs.records:
            sizes["records"] = blocks * inputs.length * strides["records"]
        if self.code.adjoint:
            sizes["start_cotangent"] = inputs.columns * blocks * strides["start_cotangent"]
            sizes["sums"] = groups * inputs.columns * sum(self.sums(inputs.length))
        return sizes

    def sums(self, length: int) -> tuple[int, int]:
        """Bytes of the gradients with respect to numbers of the call, and those of all steps."""
        return self.code.strides["call_sums"], length * self.code.strides["step_sums"]

    def segment(self, length: int) -> int:
        """Steps whose tape is kept at once. It does not depend on the number of threads."""
        if not self.code.adjoint:
            return length
        return int(min(length, max(1, TAPE // self.code.strides["tape"])))

    @contextmanager
    def _own(self, context: np.ndarray, inputs: KernelInputs) -> Iterator[ThreadTable]:
        """The context with separate scratch memory."""
        sizes = self._scratch(inputs.length, inputs.columns)
        limit = max(SPARE - 4 * inputs.memory.size, 0)
        scratch = spare.take(self)
        if scratch is None or not scratch.suffices(sizes):
            spare.shrink(limit - sum(sizes.values()))
            scratch = KernelMemory(sizes)
        local = context.copy()
        for name, position in scratch.where.items():
            local[:, SLOTS[name]] = position
        _apart(local, "cotangent", self.code.strides["cotangent"])
        try:
            yield ThreadTable(local, address(local))
        finally:
            spare.give(self, scratch, limit)

    def _scratch(self, length: int, columns: int) -> dict[str, int]:
        """The sizes of one thread's scratch memory."""
        strides, sizes, segment = self.code.strides, self.code.sizes, self.segment(length)
        return {
            "work": sizes["work"], "carry": strides["carry"],
            "cotangent": columns * strides["cotangent"],
            "tape_initial": strides["tape_initial"], "tape_final": strides["tape_final"],
            "tape": segment * strides["tape"], "chunk": sizes["chunk"],
            "saved": -(-length // segment) * strides["carry"],
        }  # fmt: skip


Groups = Callable[[KernelInputs, np.ndarray, np.ndarray, int], KernelMemory]


class Runner(GroupRunner):
    """A compiled kernel."""

    def __init__(self, kernel: Kernel, machine: Linked):
        super().__init__(kernel.code, machine)
        self.kernel = kernel

    def run(
        self, inputs: KernelInputs, threads: int, groups: Groups | None = None
    ) -> KernelOutputs:
        """Runs all blocks forward and (in an adjoint kernel) backward, for every column of
        weights. `groups`: computes the groups instead of `GroupRunner.groups`, with bit-identical
        results.
        """
        context, edges = self.prepared(inputs), inputs.edges
        if edges is None:
            item = sum(self.sums(inputs.length)) if self.code.adjoint else 0
            count = _groups(inputs.blocks, item)
            edges = inputs.blocks * np.arange(count + 1) // count
        memory = (groups or self.groups)(inputs, context, edges, threads)
        out = KernelOutputs(memory["final"], memory.rows.get("records"))
        if self.code.adjoint:
            out.back = self._back(inputs, context, memory)
        return out

    def _back(
        self, inputs: KernelInputs, context: np.ndarray, memory: KernelMemory
    ) -> list["Back"]:
        """The sums of every column, finished: over all paths, or over each part of them."""
        (calls, steps), columns = self.sums(inputs.length), inputs.columns
        rows, where, stride = memory["sums"], memory.where["sums"], calls + steps
        if inputs.edges is None:
            total = KernelMemory({"total": columns * stride})
            groups = rows.view(np.float64).reshape(-1, columns * stride // 8)
            rows, where = total["total"], total.where["total"]
            np.sum(groups, axis=0, out=rows.view(np.float64))
        rows = rows.reshape(-1, columns, stride)
        sums = _sums(where, (len(rows), columns), calls, stride)
        with self._own(context, inputs) as local:
            for part in sums:
                local.table[:, ADDED] = part
                for column in range(columns):
                    self.machine.functions["finish"](local.address + 8 * len(CONTEXT) * column)
        rows = rows[0] if inputs.edges is None else rows
        left = memory["start_cotangent"].reshape(columns, -1)
        return [Back(rows[..., k, :calls], rows[..., k, calls:], left[k]) for k in range(columns)]

    def together(self, paths: int, length: int) -> int:
        """The maximum number of columns of one run, limited by memory for their gradients."""
        item = sum(self.sums(length))
        return int(max(1, SUMS // max(1, _groups(-(-paths // self.kernel.lanes), item) * item)))


class Spare:
    """Scratch memory between calls, of all kernels together at most `SPARE` bytes minus four times
    the inputs of the latest call: the inputs of long paths are large, and the caller holds them in
    several problems.

    Memory is reused by the kernel that had it; memory unused for longest is freed first.
    """

    def __init__(self):
        self._lock = threading.Lock()
        self._waiting: list[tuple[weakref.ref[GroupRunner], KernelMemory]] = []
        self._bytes = 0

    def take(self, runner: GroupRunner) -> KernelMemory | None:
        """Memory that this kernel had before, the latest first; None if there is none."""
        with self._lock:
            for i in reversed(range(len(self._waiting))):
                if self._waiting[i][0]() is runner:
                    memory = self._waiting.pop(i)[1]
                    self._bytes -= memory.size
                    return memory
            self._keep([item for item in self._waiting if item[0]() is not None])
        return None

    def give(self, runner: GroupRunner, memory: KernelMemory, limit: int) -> None:
        """Keeps memory for this kernel's next call, if there is room."""
        with self._lock:
            self._waiting.append((runner.reference, memory))
            self._bytes += memory.size
        self.shrink(limit)

    def shrink(self, limit: int) -> None:
        """Frees memory until at most this number of bytes is left."""
        with self._lock:
            while self._waiting and self._bytes > limit:
                self._bytes -= self._waiting.pop(0)[1].size

    def _keep(self, waiting: list) -> None:
        self._waiting, self._bytes = waiting, sum(memory.size for _, memory in waiting)

    def bytes(self) -> int:
        """The memory of all waiting kernels."""
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


def _sums(position: int, shape: tuple[int, int], calls: int, stride: int) -> np.ndarray:
    """[*shape, 2]: the addresses of the sums of the call and, `calls` bytes on, of its steps, both
    together `stride` bytes: for every part and column, one after the other from `position` on."""
    first = position + stride * np.arange(shape[0] * shape[1]).reshape(shape)
    return np.stack([first, first + calls], axis=-1)


def _groups(blocks: int, size: int) -> int:
    """The number of partial sums: as many as memory allows, for any number of threads."""
    return int(max(1, min(blocks, GROUPS, SUMS // max(1, size))))
