"""Computes a book: sends out its jobs, stores their results, and makes its tables."""

import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from snapo.case.error import CaseError
from snapo.engine.workers import Lost, WorkerPool, results
from snapo.lanes.machine import pipeline
from snapo.solver.provenance import versions
from snapo.solver.tables import write_text
from snapo.study.study import ProgressCallback

from .collect import collect, reader
from .file import Book, BookContract
from .folder import REPORT, RESULT, BookFolder
from .job import BookJob, JobResult, name_of, opened
from .plan import BookPlan
from .work import compute

EVERY = 5.0  # seconds between two lines of progress


class Shard(NamedTuple):
    """The part `number` (from 1) of the `count` parts of a book."""

    number: int
    count: int


class Driver:
    """The jobs of some contracts, in sequence, and their results.

    - `lost`: {job: the reason} for the jobs that no worker computed.
    """

    def __init__(self, plan: BookPlan, contracts: Sequence[BookContract], folder: BookFolder):
        self.plan, self.folder = plan, folder
        self.waiting = deque(plan.needed(contracts))
        self.further_jobs: deque[BookJob] = deque()
        self.flight: dict[str, tuple[BookJob, BookContract | None]] = {}
        self.lost: dict[str, str] = {}
        self.computed = self.reused = 0
        self._read = reader(folder, self.lost)

    def next_job(self) -> bytes | None:
        """The next job without a result; None if all such jobs wait for a job that is being
        computed."""
        while True:
            job, contract = self._next()
            if job is None:
                return None
            data = job.pack()
            name = name_of(data)
            stored = self.folder.read(name)
            if stored is None:
                self.flight[name] = job, contract
                return data
            self.reused += 1
            if contract is not None:
                self._follow(contract, job, stored[0])

    def _next(self) -> tuple[BookJob | None, BookContract | None]:
        if self.further_jobs:
            return self.further_jobs.popleft(), None
        for i, contract in enumerate(self.waiting):
            job = self.plan.base(contract, self._read)
            if job is not None:
                del self.waiting[i]
                return job, contract
        return None, None

    def _follow(self, contract: BookContract, job: BookJob, result: JobResult) -> None:
        """The jobs that can be made once the first job of a contract has its result."""
        self.further_jobs.extend(self.plan.tests(contract, result))
        self.further_jobs.extend(self.plan.further(job, result))

    def take(self, data: bytes, result: bytes | Lost) -> None:
        """Stores a result.

        **Raises:** `OSError` if the disk is full."""
        name = name_of(data)
        job, contract = self.flight.pop(name)
        if not isinstance(result, Lost):
            try:
                complete, _ = opened(result)
                stored = JobResult.unpack(complete)
            except ValueError as error:
                result = Lost(f"its result cannot be read: {error}")
        if isinstance(result, Lost):
            self.lost[name] = result.reason
            return
        self.folder.write(name, result)
        self.computed += 1
        if contract is not None:
            self._follow(contract, job, stored)


def run_book(
    book: Book,
    progress: ProgressCallback,
    worker_pools: Sequence[WorkerPool],
    *,
    out: Path | None = None,
    shard: Shard | None = None,
    resume: bool = False,
) -> dict[str, Any]:
    """Values a book into the folder `out`, by default `run` next to its file.

    - `worker_pools`: where its jobs are computed; `shard`: the part of the contracts to value.
    - `resume`: whether results that are already in the folder are used again.

    Returns the content of result.json. If the run is interrupted or the disk is full, the results
    written so far remain.

    **Raises:** `CaseError` if the folder cannot be written.
    """
    began = time.perf_counter()
    folder = BookFolder(book.file.parent / "run" if out is None else out)
    plan = plan_of(book)
    folder.prepare(_record(book), keep=resume or shard is not None)
    contracts = plan.needed(book.contracts)
    if shard is not None:
        slice_ends = (len(contracts) * n // shard.count for n in (shard.number - 1, shard.number))
        contracts = contracts[slice(*slice_ends)]
    driver = Driver(plan, contracts, folder)
    _compute(driver, worker_pools, progress, began)
    seconds = time.perf_counter() - began
    cost = {
        "orders": {"computed": driver.computed, "reused": driver.reused, "lost": len(driver.lost)},
        "seconds": {"orders": seconds, "total": seconds},
        "workers": len(worker_pools),
        "versions": versions(),
        "run": str(folder.path),
    }
    if shard is not None and not _is_complete(plan, folder):
        return {
            "kind": "book",
            "status": "ok" if not driver.lost else "failed",
            "title": book.title,
            "shard": list(shard),
            **cost,
        }
    return write_results(plan, folder, driver.lost, cost, began)


def plan_of(book: Book) -> BookPlan:
    """The plan of a book; only processors of this kind may compute its jobs."""
    return BookPlan(book, "" if pipeline.unavailable() else pipeline.fingerprint())


def write_results(
    plan: BookPlan, folder: BookFolder, lost: Mapping[str, str], cost: dict[str, Any], began: float
) -> dict[str, Any]:
    """Writes the tables, result.json and the report; returns the content of result.json."""
    from snapo.report.page import render

    from .report import page

    results = collect(plan, folder, lost)
    cost["seconds"]["total"] = time.perf_counter() - began
    result = results.table() | cost
    write_text(folder.path / RESULT, _to_json(result), shared=True)
    write_text(folder.path / REPORT, render(page(result, folder.record())), shared=True)
    return result


def _compute(
    driver: Driver, worker_pools: Sequence[WorkerPool], progress: ProgressCallback, began: float
) -> None:
    reported_at, size = time.perf_counter(), driver.plan.size
    try:
        for job, result in results(driver.next_job, compute, worker_pools):
            driver.take(job, result)
            if (now := time.perf_counter()) - reported_at > EVERY:
                reported_at = now
                done = driver.computed + driver.reused + len(driver.lost)
                progress(f"{done:,} of {size:,} jobs, {now - began:,.0f} s")
    except OSError as error:
        message = (
            f"a result cannot be written ({error.strerror}); --resume continues "
            "with the saved results"
        )
        raise CaseError(str(driver.folder.path), "", None, message) from None


def _is_complete(plan: BookPlan, folder: BookFolder) -> bool:
    """Whether every job of the book has a result."""
    driver = Driver(plan, plan.book.contracts, folder)
    return driver.next_job() is None and not driver.waiting


def _record(book: Book) -> dict[str, Any]:
    return {
        "title": book.title,
        "cases": [
            {"name": x.name, "market": x.market, "quantity": x.quantity, "labels": dict(x.labels)}
            for x in book.contracts
        ],
        "stresses": [stress.name for stress in book.stresses],
        "by": list(book.by),
        "axes": [axis._asdict() for axis in book.axes],
        "tasks": book.tasks.model_dump(),
        "seed": book.run.seed,
        "processor": book.run.processor,
        "versions": versions(),
    }


def _to_json(result: Mapping[str, Any]) -> str:
    import json

    with suppress(ValueError):
        return json.dumps(result, indent=1, allow_nan=False)
    return json.dumps(_without_nan(result), indent=1)


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(x) for key, x in value.items()}
    if isinstance(value, list):
        return [_without_nan(x) for x in value]
    return None if isinstance(value, float) and value != value else value
