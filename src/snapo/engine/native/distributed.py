"""Groups of paths computed by other processes: a part of a run of a kernel, as bytes.

A job contains the rows that some groups read. The kernel and the numbers of its steps, which are
the same at every step of training, are sent to a worker that does not have them yet. It needs
neither the simulator nor the policy. The result has the rows that the kernel wrote, with separate
sums for every group: they are added in the same way in all runs, so that the bits are those of one
process.
"""

import hashlib
import json
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from itertools import pairwise
from time import perf_counter
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from snapo.lanes.machine import disk
from snapo.lanes.machine.code_cache import linked_code
from snapo.lanes.machine.linked import KernelMemory

from ..workers import OTHER, Lost, Workers
from .kernel.kernel import KernelCode
from .runtime import GroupRunner, KernelInputs, Runner

MIN_SECONDS = 0.05  # seconds of a run on this machine from which on workers compute it
RATE = 2e8  # bytes a second that jobs and results move
UNKNOWN = b"unknown"  # the reply of a worker that needs the kernel, or the numbers of its steps
LASTING = 16  # kernels that a worker keeps, and numbers of steps
SHARED = ("table", "keys", "noise", "noise_initial")  # rows that belong to no block
BY_COLUMN = ("weights", "start_cotangent")  # rows of all blocks, column after column

ByteRows = Mapping[str, np.ndarray]


class Distributed:
    """Runs of kernels whose groups of paths are computed by workers, if that saves time.

    A kernel's first run is timed on this machine. Later runs go to workers if they would take at
    least `MIN_SECONDS` here, plus the time to move their rows. If a worker loses a job, this
    process computes everything from then on.
    """

    def __init__(self, workers: Workers):
        self.workers = workers
        self.runs, self.longest, self.needed, self.lost = 0, 0.0, 0.0, ""
        self._seconds: WeakKeyDictionary[GroupRunner, float] = WeakKeyDictionary()

    @property
    def note(self) -> str:
        """The reason why workers computed nothing; empty if they did."""
        if self.lost:
            return f"Workers were not used after one job returned no result: {self.lost}."
        if self.runs or not self.longest:
            return ""
        return (
            f"Workers were not used: the paths of a step take {1e3 * self.longest:,.0f} ms on this "
            f"machine; workers save time from {1e3 * self.needed:,.0f} ms on (see training.paths)."
        )

    def groups(
        self,
        runner: Runner,
        inputs: KernelInputs,
        context: np.ndarray,
        edges: np.ndarray,
        threads: int,
    ) -> KernelMemory:
        """As `GroupRunner.groups`, with the same bits."""
        size = inputs.blocks * inputs.length * inputs.columns
        expected = size * self._seconds.get(runner, 0.0)
        needed = self._needed(runner, inputs, len(edges) - 1)
        if not self.lost and expected >= needed:
            memory = self._from_workers(runner, inputs, edges)
            if memory is not None:
                self.runs += 1
                return memory
        started = perf_counter()
        memory = runner.groups(inputs, context, edges, threads)
        seconds = (perf_counter() - started) / size
        seconds = self._seconds[runner] = min(seconds, self._seconds.get(runner, seconds))
        if seconds * size > self.longest:
            self.longest, self.needed = seconds * size, needed
        return memory

    def _needed(self, runner: Runner, inputs: KernelInputs, groups: int) -> float:
        """The seconds on this machine from which on workers help."""
        if not MIN_SECONDS:
            return 0.0
        rows = [*_rows(runner, inputs, 0, inputs.blocks).values()]
        size = sum(row.nbytes for row in rows) + sum(runner.results(inputs, groups).values())
        return MIN_SECONDS + size / RATE

    def _from_workers(
        self, runner: Runner, inputs: KernelInputs, edges: np.ndarray
    ) -> KernelMemory | None:
        """The rows of all blocks and groups; None if a job was lost."""
        groups = len(edges) - 1
        count = min(groups, self.workers.parallel)
        cuts = (groups * np.arange(count + 1) // count).tolist()
        steps = _filled(runner, "steps", inputs.memory["steps"])
        steps_name = hashlib.blake2b(steps.data, digest_size=16).hexdigest()
        parts = {
            _job(runner, steps_name, inputs, edges[first : last + 1]): (first, last)
            for first, last in pairwise(cuts)
        }
        memory = KernelMemory(runner.results(inputs, groups))
        waiting = deque(parts)
        for job, result in self.workers.results(partial(_next, waiting), compute):
            first, last = parts[job]
            if result == UNKNOWN:
                complete = job + _packed(asdict(runner.code), {"steps": steps})
                parts[complete] = first, last
                waiting.append(complete)
            elif isinstance(result, Lost):
                self.lost = result.reason
                return None
            else:
                for name, row in _unpacked(result)[1].items():
                    if name == "sums":
                        rows = memory[name].reshape(groups, -1)[first:last]
                    else:
                        rows = _blocks(name, memory[name], inputs, edges[first], edges[last])
                    rows[...] = row.reshape(rows.shape)
        return memory


def _next(waiting: deque[bytes]) -> bytes | None:
    return waiting.popleft() if waiting else None


def _blocks(name: str, row: np.ndarray, inputs: KernelInputs, first: int, last: int) -> np.ndarray:
    """The bytes of some blocks, of every column where columns have rows of their own."""
    columns = inputs.columns if name in BY_COLUMN else 1
    return row.reshape(columns, inputs.blocks, -1)[:, first:last]


def _filled(runner: Runner, name: str, rows: np.ndarray) -> np.ndarray:
    """The bytes of rows that `prepare` does not compute."""
    filled = rows.reshape(-1, runner.code.strides[name])[:, : runner.code.filled[name]]
    return np.ascontiguousarray(filled)


def _rows(runner: Runner, inputs: KernelInputs, first: int, last: int) -> dict[str, np.ndarray]:
    """The inputs of some blocks, except the numbers of the steps."""
    rows = {
        name: row if name in SHARED else _blocks(name, row, inputs, first, last)
        for name, row in inputs.memory.rows.items()
        if name != "steps"
    }
    rows["table"] = _filled(runner, "table", rows["table"])
    if "positions" in rows:  # stored noise: that of the part's paths
        positions = np.ascontiguousarray(rows["positions"]).view(np.int64)
        start, stop = int(positions.min()), int(positions.max()) + 1
        rows |= {"positions": positions - start, "noise": rows["noise"][:, start:stop]}
        rows |= {"noise_initial": rows["noise_initial"][start:stop]}
    return rows


def _job(runner: Runner, steps: str, inputs: KernelInputs, edges: np.ndarray) -> bytes:
    """The job of the groups between these edges."""
    first, last = int(edges[0]), int(edges[-1])
    rows = _rows(runner, inputs, first, last)
    paths = rows["noise"].shape[1] if "noise" in rows else inputs.paths
    run = {"paths": paths, "blocks": last - first, "length": inputs.length, "first": inputs.first}
    run |= {"records": inputs.records, "columns": inputs.columns}
    table = {"kernel": runner.name, "steps": steps, "run": run, "edges": edges.tolist()}
    return _packed(table, rows)


def compute(job: bytes) -> bytes:
    """The result of a job: the same on all processors for which its kernel has the same name."""
    table, rows, lasting = _unpacked(job)
    if lasting and not _learn(table, lasting):
        return OTHER
    runner, steps = _runners.get(table["kernel"]), _steps.get(table["steps"])
    if runner is None or steps is None:
        return UNKNOWN
    strides, filled, run = runner.code.strides, runner.code.filled, table["run"]
    sizes = {name: row.size for name, row in rows.items()}
    sizes |= {"table": strides["table"], "steps": run["length"] * strides["steps"]}
    memory = KernelMemory(sizes)
    for name, row in (*rows.items(), ("steps", steps)):
        if name in filled:
            memory[name].reshape(-1, strides[name])[:, : filled[name]] = row
        else:
            memory[name][:] = row
    inputs, edges = KernelInputs(memory=memory, **run), np.array(table["edges"])
    results = runner.groups(inputs, runner.prepared(inputs), edges - edges[0], 1).rows
    return _packed({}, {name: row for name, row in results.items() if name != "stop"})


def _learn(table: Mapping[str, Any], lasting: bytes) -> bool:
    """Keeps a kernel and the numbers of its steps; False if its bits would be others here."""
    content, rows, _ = _unpacked(lasting)
    del content["rows"]
    code = KernelCode(**content)
    if table["kernel"] not in _runners:
        if disk.key(code.text) != table["kernel"]:
            return False
        _runners[table["kernel"]] = GroupRunner(code, linked_code(code.text, code.entries))
    shape = table["run"]["length"], code.filled["steps"]
    _steps[table["steps"]] = rows["steps"].reshape(shape)
    for cache in (_runners, _steps):
        while len(cache) > LASTING:
            del cache[next(iter(cache))]
    return True


_runners: dict[str, GroupRunner] = {}
_steps: dict[str, np.ndarray] = {}


def _packed(table: dict[str, Any], rows: ByteRows) -> bytes:
    """A line of JSON, and the bytes of the rows one after another."""
    head = json.dumps(table | {"rows": {name: row.nbytes for name, row in rows.items()}})
    return b"".join(
        [head.encode(), b"\n", *(np.ascontiguousarray(row).data for row in rows.values())]
    )


def _unpacked(data: bytes) -> tuple[dict[str, Any], ByteRows, bytes]:
    """The table, the rows, and the bytes after them."""
    at = data.index(b"\n") + 1
    table, rows = json.loads(data[:at]), {}
    for name, size in table["rows"].items():
        rows[name] = np.frombuffer(data, np.uint8, size, at)
        at += size
    return table, rows, data[at:]
