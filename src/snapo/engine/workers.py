"""Sends jobs to executors and collects their results; a job that is lost is sent again.

Any object with `submit` can be used: `concurrent.futures`, Dask's
`Client.get_executor(pure=False)`, Parsl, mpi4py. On one machine every worker is a pool of one
process, so that a process that dies loses one job only, and the job that killed it is known.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Executor,
    Future,
    wait,
)
from dataclasses import dataclass
from typing import NamedTuple, Protocol

PARALLEL = 32  # jobs at once of an executor without a number of workers
LOSSES = 3  # after which a job is given up
REFUSALS = 20  # of a job by workers of another processor, after which it is given up
OTHER = b"other processor"  # the reply of a worker that would compute other bits

Work = Callable[[bytes], bytes]


class Submits(Protocol):
    """The methods of an executor that are used."""

    def submit(self, fn: Work, job: bytes, /) -> "Future[bytes]": ...

    def shutdown(self, wait: bool = True) -> None: ...


@dataclass(frozen=True)
class WorkerPool:
    """The place where jobs are computed.

    - `make`: creates an executor, at the start and after a failure.
    - `waiting`: the maximum number of jobs in work or queued; `parallel`: the number of jobs in
      work at once.
    - `close`: leaves the cluster.
    """

    make: Callable[[], Executor | Submits]
    waiting: int = 2
    close: Callable[[], object] = lambda: None
    parallel: int = 1

    @classmethod
    def of(cls, executor: Executor | Submits, waiting: int = 2) -> "WorkerPool":
        """An executor that cannot be created again."""
        parallel = getattr(executor, "_max_workers", PARALLEL)
        return cls(lambda: executor, max(waiting, parallel), parallel=parallel)


class Lost(NamedTuple):
    """A job that no worker computed, and the reason."""

    reason: str


class _Worker:
    """An executor that is created again if it breaks; `broken`: if that is impossible."""

    def __init__(self, pool: WorkerPool):
        self.pool, self.busy, self.broken = pool, 0, False
        self.executor: Executor | Submits | None = None

    def submit(self, work: Work, job: bytes) -> "Future[bytes] | None":
        """The job's result in the future; None if the executor is broken."""
        for _ in range(2):
            self.executor = self.executor or self.pool.make()
            try:
                future = self.executor.submit(work, job)
            except RuntimeError:  # it is broken, or was shut down
                self.stop()
            else:
                self.busy += 1
                return future
        self.broken = True
        return None

    def stop(self) -> None:
        """Ends the executor after the job in work."""
        if self.executor is not None:
            self.executor.shutdown(wait=False)
            self.executor = None


Flight = dict["Future[bytes]", tuple[_Worker, bytes]]


class Workers:
    """The executors of some pools, for one series of jobs after another.

    - `parallel`: the number of jobs that they compute at once.
    """

    def __init__(self, pools: Sequence[WorkerPool]):
        self._workers = [_Worker(pool) for pool in pools]
        self.parallel = sum(pool.parallel for pool in pools)

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.stop()
            worker.pool.close()

    def results(
        self, next_job: Callable[[], bytes | None], work: Work
    ) -> Iterator[tuple[bytes, bytes | Lost]]:
        """Pairs (job, result) in the order in which results arrive; `work` must depend on the job's
        bytes only.

        - `next_job`: returns the next job, None if there is none until another result has arrived.

        The result of a job that is lost three times is `Lost`; a job that was queued in a process
        when another job broke it does not count as lost.
        """
        repeated: deque[bytes] = deque()
        losses, refusals = Counter[bytes](), Counter[bytes]()
        flight: Flight = {}

        def job_to_send() -> bytes | None:
            return repeated.popleft() if repeated else next_job()

        try:
            while True:
                self._fill(job_to_send, repeated, work, flight)
                if not flight:
                    while self._are_broken() and (job := job_to_send()) is not None:
                        yield job, Lost("the executor is broken, and cannot be restarted")
                    return
                done, _ = wait(flight, return_when=FIRST_COMPLETED)
                blamed: set[_Worker] = set()
                # In the sequence in which they were sent: the first one of a broken process is
                # the one that was in work.
                for future in [future for future in flight if future in done]:
                    worker, job = flight.pop(future)
                    worker.busy -= 1
                    result, count, maximum = _result(future), losses, LOSSES
                    if result == OTHER:
                        result = Lost("no worker has a processor of the required kind")
                        count, maximum = refusals, REFUSALS
                    if isinstance(result, Lost):
                        count[job] += worker not in blamed
                        blamed.add(worker)
                        if count[job] < maximum:
                            repeated.append(job)
                            continue
                    yield job, result
        finally:
            for future, (worker, _) in flight.items():
                future.cancel()
                worker.busy -= 1

    def _are_broken(self) -> bool:
        return all(worker.broken for worker in self._workers)

    def _fill(
        self,
        next_job: Callable[[], bytes | None],
        repeated: deque[bytes],
        work: Work,
        flight: Flight,
    ) -> None:
        """Sends every worker as many jobs as it may have, one after the other."""
        while idle := [
            worker
            for worker in self._workers
            if worker.busy < worker.pool.waiting and not worker.broken
        ]:
            for worker in sorted(idle, key=lambda worker: worker.busy):
                if (job := next_job()) is None:
                    return
                future = worker.submit(work, job)
                if future is None:
                    repeated.appendleft(job)
                else:
                    flight[future] = worker, job


def results(
    next_job: Callable[[], bytes | None], work: Work, pools: Sequence[WorkerPool]
) -> Iterator[tuple[bytes, bytes | Lost]]:
    """The results of one series of jobs, after which the workers end: see `Workers.results`."""
    with Workers(pools) as workers:
        yield from workers.results(next_job, work)


def _result(future: "Future[bytes]") -> bytes | Lost:
    try:
        return bytes(future.result())
    except (Exception, CancelledError) as error:
        return Lost(f"{type(error).__name__}: {error}"[:500])
