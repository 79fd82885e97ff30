"""Gives orders to executors and collects their answers; an order that is lost is given out again.

Anything with `submit` serves: `concurrent.futures`, Dask's `Client.get_executor(pure=False)`, Parsl,
mpi4py. On one machine every worker is a pool of one process, so that a process that dies loses one
order only, and the order that killed it is known.
"""

import importlib
import multiprocessing
import os
import sys
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from typing import NamedTuple

from snapo.case.error import CaseError

LOSSES = 3  # after which an order is given up
WAITING = 2  # orders that every executor has: one in work and the next one

Make = Callable[[], Executor]


class Lost(NamedTuple):
    """An order that no worker answered, and why."""

    order: bytes
    reason: str


def local(workers: int | None = None) -> list[Make]:
    """So many processes of this machine, by default one for each core."""
    return [_process] * (workers or len(os.sched_getaffinity(0)))


def _process() -> Executor:
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, mp_context=context, initializer=_alone)


def _alone() -> None:
    """A worker has one thread for its kernels, and one for XLA: its sums have the same bits."""
    os.environ["OMP_NUM_THREADS"] = "1"
    os.environ["XLA_FLAGS"] = (
        f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false"
    )
    if hasattr(os, "sched_setaffinity"):
        mine = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {mine[os.getpid() % len(mine)]})


def named(where: str) -> list[Make]:
    """The executors of `--on MODULE:FACTORY`: the factory gives one, or several.

    **Raises:** `CaseError` where there is no such factory.
    """
    module, _, name = where.partition(":")
    try:
        sys.path.insert(0, os.getcwd())
        made = getattr(importlib.import_module(module), name)()
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        allowed = f"a function that gives an executor, as MODULE:FUNCTION ({error})"
        raise CaseError("--on", "", where, allowed) from None
    executors: Sequence[Executor] = [made] if hasattr(made, "submit") else list(made)
    return [lambda executor=executor: executor for executor in executors]


class _Worker:
    """An executor that is made again where it broke."""

    def __init__(self, make: Make):
        self.make, self.executor, self.busy = make, make(), 0

    def submit(self, work: Callable[[bytes], bytes], order: bytes) -> "Future[bytes]":
        try:
            return self.executor.submit(work, order)
        except Exception:
            self.executor.shutdown(wait=False, cancel_futures=True)
            self.executor = self.make()
            return self.executor.submit(work, order)


def answers(
    orders: Iterable[bytes], work: Callable[[bytes], bytes], makes: Sequence[Make]
) -> Iterator[tuple[bytes, bytes | Lost]]:
    """(order, answer) as they come; `work` is a function of the order's bytes alone.

    At most `WAITING` orders of every executor are in flight. One that was lost three times is `Lost`.
    """
    workers = [_Worker(make) for make in makes]
    waiting, losses = deque(), Counter[bytes]()
    source, flight = iter(orders), {}
    try:
        while True:
            for worker in workers:
                while worker.busy < WAITING and (order := _next(waiting, source)) is not None:
                    flight[worker.submit(work, order)] = worker, order
                    worker.busy += 1
            if not flight:
                return
            done, _ = wait(flight, return_when=FIRST_COMPLETED)
            for future in done:
                worker, order = flight.pop(future)
                worker.busy -= 1
                try:
                    yield order, future.result()
                except Exception as error:
                    losses[order] += 1
                    if losses[order] < LOSSES:
                        waiting.append(order)
                    else:
                        yield order, Lost(order, f"{type(error).__name__}: {error}"[:500])
    finally:
        for worker in workers:
            worker.executor.shutdown(wait=False, cancel_futures=True)


def _next(waiting: deque[bytes], source: Iterator[bytes]) -> bytes | None:
    return waiting.popleft() if waiting else next(source, None)
