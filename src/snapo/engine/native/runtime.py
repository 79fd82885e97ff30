"""Running a kernel: aligned memory, blocks of paths over threads, sums in a fixed order."""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from .compiler import Machine
from .kernel import CONTEXT, Kernel

TAPE = 256 * 2**20  # bytes of tape per thread; longer horizons are done in segments, twice forward
SUMS = 256 * 2**20  # bytes of gradients of all groups together
SLOTS = {name: i for i, name in enumerate(CONTEXT)}
PROCESSORS = os.cpu_count() or 1
GROUPS = 32  # independent partial sums: fixed, so that threads do not change the answer


class Memory:
    """Named rows of zero bytes on 64-byte boundaries, and their addresses.

    They are of one allocation: kernels take addresses, and NumPy is slow to tell them.
    """

    def __init__(self, sizes: dict[str, int]):
        raw = np.zeros(64 + sum(map(_rounded, sizes.values())), np.uint8)
        base = address(raw)
        at = -base % 64
        self.rows: dict[str, np.ndarray] = {}
        self.where: dict[str, int] = {}
        for name, size in sizes.items():
            self.rows[name], self.where[name] = raw[at : at + size], base + at
            at += _rounded(size)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.rows[name]

    def lend(self, name: str, array: np.ndarray) -> None:
        """Adds an array that lies elsewhere."""
        self.rows[name], self.where[name] = array, address(array)

    def holds(self, sizes: dict[str, int]) -> bool:
        """Whether every row has at least its size."""
        return all(self.rows[name].size >= size for name, size in sizes.items())


def _rounded(size: int) -> int:
    return -(-size // 64) * 64


def address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


@dataclass(eq=False)
class Inputs:
    """What one run reads, as rows of the kernel's layouts."""

    paths: int
    length: int
    first: int
    memory: Memory
    records: bool = False


@dataclass(eq=False)
class Outputs:
    """What one run wrote, as rows of the kernel's layouts; the sums of an adjoint kernel only."""

    final: np.ndarray
    records: np.ndarray | None
    call_sums: np.ndarray | None = None
    step_sums: np.ndarray | None = None
    start_cotangent: np.ndarray | None = None


class Runner:
    """A compiled kernel with scratch memory that is used again from call to call."""

    def __init__(self, kernel: Kernel, machine: Machine):
        self.kernel, self.machine = kernel, machine
        self._spare: list[Memory] = []

    def blocks(self, paths: int) -> int:
        return -(-paths // self.kernel.lanes)

    def run(self, inputs: Inputs, threads: int) -> Outputs:
        """All blocks, forward and (in an adjoint kernel) back."""
        layouts, adjoint = self.kernel.layouts, self.kernel.traced.setup.adjoint
        blocks, length = self.blocks(inputs.paths), inputs.length
        calls, steps = layouts["call_sums"].stride, length * layouts["step_sums"].stride
        groups = _groups(blocks, calls + steps if adjoint else 0)
        sizes = {"stop": 8, "final": blocks * layouts["final"].stride}
        if inputs.records:
            sizes["records"] = blocks * length * layouts["records"].stride
        if adjoint:
            sizes["start_cotangent"] = blocks * layouts["start_cotangent"].stride
            sizes["total"], sizes["sums"] = calls + steps, groups * (calls + steps)
        memory = Memory(sizes)
        segment = self.segment(length)
        numbers = {"length": length, "first": inputs.first, "count": inputs.paths}
        context = _context(inputs.memory.where | memory.where | numbers | {"segment": segment})
        scratch = self._scratch(segment, -(-length // segment))
        functions = self.machine.functions

        def one(group: int, own: np.ndarray) -> None:
            if adjoint:
                _add_up_in(own, memory.where["sums"] + group * (calls + steps), calls)
            first, last = blocks * group // groups, blocks * (group + 1) // groups
            functions["run"](address(own), first, last)

        with self._own(context, scratch) as own:
            functions["prepare"](address(own))
        self._spread(one, groups, min(threads, groups), memory["stop"], context, scratch)
        out = Outputs(memory["final"], memory.rows.get("records"))
        if adjoint:
            sums, total = memory["sums"].view(np.float64), memory["total"]
            np.sum(sums.reshape(groups, -1), axis=0, out=total.view(np.float64))
            out.call_sums, out.step_sums = total[:calls], total[calls:]
            out.start_cotangent = memory["start_cotangent"]
            with self._own(context, scratch) as own:
                _add_up_in(own, memory.where["total"], calls)
                functions["finish"](address(own))
        return out

    def segment(self, length: int) -> int:
        """Steps whose tape is kept at once. It does not depend on the number of threads."""
        if not self.kernel.traced.setup.adjoint:
            return length
        return int(min(length, max(1, TAPE // self.kernel.layouts["tape"].stride)))

    def _spread(self, one, groups: int, threads: int, stop, context, scratch) -> None:
        """Hands groups to threads in turn; this thread takes its share and notices Ctrl-C."""
        waiting = iter(range(groups))
        lock = threading.Lock()
        failures: list[BaseException] = []

        def work() -> None:
            with self._own(context, scratch) as own:
                while not stop[0]:
                    with lock:
                        group = next(waiting, None)
                    if group is None:
                        break
                    one(group, own)

        def help() -> None:
            try:
                work()
            except BaseException as error:  # pragma: no cover
                failures.append(error)
                stop[:] = 1

        others = [_helper().take(help) for _ in range(threads - 1)]
        try:
            work()
            _wait(others)
        except BaseException:
            stop[:] = 1
            _wait(others)
            raise
        if failures:
            raise failures[0]

    def _scratch(self, segment: int, segments: int) -> dict[str, int]:
        """The sizes of one thread's scratch memory."""
        layouts, sizes = self.kernel.layouts, self.kernel.sizes
        return {
            "work": sizes["work"], "carry": layouts["carry"].stride,
            "cotangent": layouts["cotangent"].stride,
            "tape_initial": layouts["tape_initial"].stride,
            "tape_final": layouts["tape_final"].stride,
            "tape": segment * layouts["tape"].stride, "chunk": sizes["chunk"],
            "saved": segments * layouts["carry"].stride,
        }  # fmt: skip

    @contextmanager
    def _own(self, context: np.ndarray, sizes: dict[str, int]) -> Iterator[np.ndarray]:
        """The context with scratch memory of its own."""
        try:
            scratch = self._spare.pop()
        except IndexError:
            scratch = None
        if scratch is None or not scratch.holds(sizes):
            scratch = Memory(sizes)
        own = context.copy()
        for name, place in scratch.where.items():
            own[SLOTS[name]] = place
        try:
            yield own
        finally:
            if len(self._spare) < 2 * PROCESSORS:
                self._spare.append(scratch)


class Helper(threading.Thread):
    """A thread that waits for work: starting one anew would cost more than a small kernel."""

    def __init__(self):
        super().__init__(name="snapo", daemon=True)
        self.begin = threading.Lock()
        self.begin.acquire()
        self.start()

    def take(self, work: Callable[[], None]) -> threading.Lock:
        """Begins the work, and returns the lock that is free once it is done."""
        done = threading.Lock()
        done.acquire()
        self.task = work, done
        self.begin.release()
        return done

    def run(self) -> None:
        while True:
            self.begin.acquire()
            work, done = self.task
            work()
            del work, self.task  # what the work held is free before the caller goes on
            _idle.append(self)
            done.release()


_idle: list[Helper] = []
if hasattr(os, "register_at_fork"):  # a forked child has none of its parent's threads
    os.register_at_fork(after_in_child=_idle.clear)


def _helper() -> Helper:
    try:
        return _idle.pop()
    except IndexError:
        return Helper()


def _wait(others: list[threading.Lock]) -> None:
    """Until each lock is free; it may be done twice."""
    for done in others:
        with done:
            pass


def _context(values: dict[str, int]) -> np.ndarray:
    """The table of addresses and numbers that kernel functions take."""
    return np.array([values.get(name, 0) for name in CONTEXT], np.int64)


def _add_up_in(context: np.ndarray, place: int, calls: int) -> None:
    """Sums of the call from here on, then those of the steps."""
    context[SLOTS["call_sums"]], context[SLOTS["step_sums"]] = place, place + calls


def _groups(blocks: int, size: int) -> int:
    """How many partial sums: as many as memory allows, whatever the number of threads."""
    return int(max(1, min(blocks, GROUPS, SUMS // max(1, size))))
