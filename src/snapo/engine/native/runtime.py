"""Running a kernel: aligned memory, blocks of paths over threads, sums in a fixed order."""

import os
import threading
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .compiler import Machine
from .kernel import CONTEXT, Kernel

TAPE = 256 * 2**20  # bytes of tape per thread; longer horizons are done in segments, twice forward
SUMS = 256 * 2**20  # bytes of gradients of all groups together
SLOTS = {name: i for i, name in enumerate(CONTEXT)}
PROCESSORS = os.cpu_count() or 1
GROUPS = 32  # independent partial sums: fixed, so that threads do not change the answer


def aligned(size: int, zero: bool = False) -> np.ndarray:
    """Bytes that begin on a 64-byte boundary."""
    raw = (np.zeros if zero else np.empty)(size + 64, np.uint8)
    start = -address(raw) % 64
    return raw[start : start + size]


@dataclass(eq=False)
class Inputs:
    """What one run reads, as rows of the kernel's layouts; missing ones stay None."""

    paths: int
    length: int
    first: int
    rows: dict[str, np.ndarray]
    records: bool = False


@dataclass(eq=False)
class Outputs:
    """What one run wrote, as rows of the kernel's layouts."""

    final: np.ndarray
    records: np.ndarray | None
    call_sums: np.ndarray | None
    step_sums: np.ndarray | None
    start_cotangent: np.ndarray | None


class Runner:
    """A compiled kernel with scratch memory that is used again from call to call."""

    def __init__(self, kernel: Kernel, machine: Machine):
        self.kernel, self.machine = kernel, machine
        self._spare: list[dict[str, np.ndarray]] = []
        self._lock = threading.Lock()

    def blocks(self, paths: int) -> int:
        return -(-paths // self.kernel.lanes)

    def run(self, inputs: Inputs, threads: int) -> Outputs:
        """All blocks, forward and (in an adjoint kernel) back."""
        kernel, layouts = self.kernel, self.kernel.layouts
        blocks = self.blocks(inputs.paths)
        adjoint = kernel.traced.setup.adjoint
        out = Outputs(aligned(blocks * layouts["final"].stride), None, None, None, None)
        if inputs.records:
            out.records = aligned(blocks * inputs.length * layouts["records"].stride)
        segment = self.segment(inputs.length)
        call_size, step_size = (
            layouts["call_sums"].stride,
            inputs.length * layouts["step_sums"].stride,
        )
        groups = _groups(blocks, call_size + step_size) if adjoint else min(blocks, GROUPS)
        sums = None
        if adjoint:
            sums = aligned(groups * (call_size + step_size), zero=True)
            out.start_cotangent = aligned(blocks * layouts["start_cotangent"].stride)
        stop = aligned(8, zero=True)
        shared = {
            **inputs.rows, "final": out.final, "records": out.records,
            "start_cotangent": out.start_cotangent, "stop": stop,
        }  # fmt: skip
        numbers = {
            "length": inputs.length,
            "first": inputs.first,
            "segment": segment,
            "count": inputs.paths,
        }
        context = _context(shared, numbers)
        sizes = segment, -(-inputs.length // segment)
        self._alone("prepare", context, sizes)
        bounds = [blocks * g // groups for g in range(groups + 1)]
        base = 0 if sums is None else address(sums)

        def one(group: int, own: np.ndarray) -> None:
            start = base + group * (call_size + step_size)
            own[SLOTS["call_sums"]], own[SLOTS["step_sums"]] = start, start + call_size
            self.machine.functions["run"](address(own), bounds[group], bounds[group + 1])

        self._spread(one, groups, min(threads, groups), stop, context, sizes)
        if sums is not None:
            table = sums.view(np.float64).reshape(groups, -1)
            total = aligned(call_size + step_size)
            np.sum(table, axis=0, out=total.view(np.float64))
            out.call_sums, out.step_sums = total[:call_size], total[call_size:]
            _place(context, {"call_sums": out.call_sums, "step_sums": out.step_sums})
            self._alone("finish", context, sizes)
        return out

    def _alone(self, name: str, context: np.ndarray, sizes) -> None:
        """A function that runs once, on this thread."""
        scratch = self._borrow(*sizes)
        try:
            _place(context, scratch)
            self.machine.functions[name](address(context))
        finally:
            self._return(scratch)

    def segment(self, length: int) -> int:
        """Steps whose tape is kept at once. It does not depend on the number of threads."""
        if not self.kernel.traced.setup.adjoint:
            return length
        return int(min(length, max(1, TAPE // self.kernel.layouts["tape"].stride)))

    def _spread(self, one, groups: int, threads: int, stop, context, sizes) -> None:
        """Hands groups to threads in turn; this thread takes its share and notices Ctrl-C."""
        waiting = iter(range(groups))
        lock = threading.Lock()
        failures: list[BaseException] = []

        def work() -> None:
            scratch = self._borrow(*sizes)
            own = aligned(8 * len(CONTEXT)).view(np.int64)
            own[:] = context
            _place(own, scratch)
            try:
                while not stop.any():
                    with lock:
                        group = next(waiting, None)
                    if group is None:
                        break
                    one(group, own)
            except BaseException as error:  # pragma: no cover
                failures.append(error)
                stop[:] = 1
            finally:
                self._return(scratch)

        others = [_pool(os.getpid()).submit(work) for _ in range(threads - 1)]
        try:
            work()
            wait(others)
        except BaseException:
            stop[:] = 1
            wait(others)
            raise
        if failures:
            raise failures[0]

    def _borrow(self, segment: int, segments: int) -> dict[str, np.ndarray]:
        """One thread's scratch memory, of at least the sizes needed."""
        layouts, sizes = self.kernel.layouts, self.kernel.sizes
        needed = {
            "work": sizes["work"], "carry": layouts["carry"].stride,
            "cotangent": layouts["cotangent"].stride,
            "tape_initial": layouts["tape_initial"].stride,
            "tape_final": layouts["tape_final"].stride,
            "tape": segment * layouts["tape"].stride, "chunk": sizes["chunk"],
            "saved": segments * layouts["carry"].stride,
        }  # fmt: skip
        with self._lock:
            scratch = self._spare.pop() if self._spare else {}
        for name, size in needed.items():
            if name not in scratch or scratch[name].size < size:
                scratch[name] = aligned(max(64, size))
        return scratch

    def _return(self, scratch: dict[str, np.ndarray]) -> None:
        with self._lock:
            if len(self._spare) < 2 * PROCESSORS:
                self._spare.append(scratch)


@lru_cache(maxsize=1)
def _pool(process: int) -> ThreadPoolExecutor:
    """Threads that wait for work: starting them anew would cost more than a small kernel.

    A forked child has none of its parent's threads, hence one pool per process.
    """
    return ThreadPoolExecutor(PROCESSORS, thread_name_prefix="snapo")


def _context(memory: dict, numbers: dict[str, int]) -> np.ndarray:
    """The table of addresses and numbers that kernel functions take."""
    context = aligned(8 * len(CONTEXT), zero=True).view(np.int64)
    _place(context, memory)
    for name, number in numbers.items():
        context[SLOTS[name]] = number
    return context


def _place(context: np.ndarray, memory: dict) -> None:
    for name, array in memory.items():
        if array is not None:
            context[SLOTS[name]] = address(array)


def address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def _groups(blocks: int, size: int) -> int:
    """How many partial sums: as many as memory allows, whatever the number of threads."""
    return int(max(1, min(blocks, GROUPS, SUMS // max(1, size))))
