"""Gives orders to executors and collects their answers; an order that is lost is given out again.

Anything with `submit` serves: `concurrent.futures`, Dask's `Client.get_executor(pure=False)`,
Parsl, mpi4py. On one machine every worker is a pool of one process, so that a process that dies
loses one order only, and the order that killed it is known.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import NamedTuple, Protocol

LOSSES = 3  # after which an order is given up
REFUSALS = 20  # of an order by workers of another processor, after which it is given up
OTHER = b"other processor"  # the answer of a worker that would compute other bits

Work = Callable[[bytes], bytes]


class Submits(Protocol):
    """The methods of an executor that a book uses."""

    def submit(self, fn: Work, order: bytes, /) -> "Future[bytes]": ...

    def shutdown(self, wait: bool = True) -> None: ...


@dataclass(frozen=True)
class WorkerPool:
    """Where orders are computed.

    - `make`: a new executor, at the beginning and where one broke.
    - `waiting`: how many orders it has in work or before it at most.
    - `close`: leaves the cluster.
    """

    make: Callable[[], Executor | Submits]
    waiting: int = 2
    close: Callable[[], object] = lambda: None


class Lost(NamedTuple):
    """An order that no worker answered, and the reason."""

    reason: str


class _Worker:
    """An executor that is made again where it broke."""

    def __init__(self, pool: WorkerPool):
        self.pool, self.busy = pool, 0
        self.executor: Executor | Submits | None = None

    def submit(self, work: Work, order: bytes) -> "Future[bytes]":
        self.busy += 1
        if self.executor is not None:
            try:
                return self.executor.submit(work, order)
            except (BrokenProcessPool, RuntimeError):
                self.stop()
        self.executor = self.pool.make()
        return self.executor.submit(work, order)

    def stop(self) -> None:
        """Ends the executor after the order in work."""
        if self.executor is not None:
            self.executor.shutdown(wait=False)
            self.executor = None


Flight = dict["Future[bytes]", tuple[_Worker, bytes]]


def answers(
    next_order: Callable[[], bytes | None], work: Work, worker_pools: Sequence[WorkerPool]
) -> Iterator[tuple[bytes, bytes | Lost]]:
    """(order, answer) as they come; `work` depends on nothing but the order's bytes.

    - `next_order`: the next order, None where there is none until another answer has come.

    An order that is lost three times is answered by `Lost`; one that was in the queue of a process
    when another one broke it has lost nothing.
    """
    workers = [_Worker(pool) for pool in worker_pools]
    repeated: deque[bytes] = deque()
    losses, refusals = Counter[bytes](), Counter[bytes]()
    flight: Flight = {}

    def order_to_give() -> bytes | None:
        return repeated.popleft() if repeated else next_order()

    try:
        while True:
            _fill(workers, order_to_give, work, flight)
            if not flight:
                return
            done, _ = wait(flight, return_when=FIRST_COMPLETED)
            blamed: set[_Worker] = set()
            # In the order in which they were given out: the first one of a broken process is the
            # one that was in work.
            for future in [future for future in flight if future in done]:
                worker, order = flight.pop(future)
                worker.busy -= 1
                result, count, maximum = _result(future), losses, LOSSES
                if result == OTHER:
                    result = Lost("no worker has the processor that the book names")
                    count, maximum = refusals, REFUSALS
                if isinstance(result, Lost):
                    count[order] += worker not in blamed
                    blamed.add(worker)
                    if count[order] < maximum:
                        repeated.append(order)
                        continue
                yield order, result
    finally:
        for future in flight:
            future.cancel()
        for worker in workers:
            worker.stop()
            worker.pool.close()


def _fill(
    workers: Sequence[_Worker], next_order: Callable[[], bytes | None], work: Work, flight: Flight
) -> None:
    """Gives every worker as many orders as it may have, one after the other."""
    while idle := [worker for worker in workers if worker.busy < worker.pool.waiting]:
        for worker in sorted(idle, key=lambda worker: worker.busy):
            if (order := next_order()) is None:
                return
            flight[worker.submit(work, order)] = worker, order


def _result(future: "Future[bytes]") -> bytes | Lost:
    try:
        return bytes(future.result())
    except (Exception, CancelledError) as error:
        return Lost(f"{type(error).__name__}: {error}"[:500])
