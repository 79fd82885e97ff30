"""Distributes work to waiting threads."""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from contextvars import copy_context
from typing import TypeVar

import numpy as np

Own = TypeVar("Own")


def cores() -> int:
    """The processors that this process may run on, if the system reports them; otherwise all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def in_thread(work: Callable[[], object]) -> Iterator[None]:
    """Does the work in a thread while the block runs; leaving the block waits for it.

    For work that is repeated if its result is missing, such as compiling: a failure is ignored.
    """

    def done() -> None:
        with suppress(Exception):
            work()

    thread = threading.Thread(target=copy_context().run, args=(done,), name="beside")
    thread.start()
    try:
        yield
    finally:
        thread.join()


def spread(
    one: Callable[[int, Own], None],
    groups: int,
    threads: int,
    stop: np.ndarray,
    local: Callable[[], AbstractContextManager[Own]],
) -> None:
    """Hands groups to threads in turn; this thread takes its share and notices Ctrl-C.

    `local` gives each thread its own scratch memory, and `stop` is a flag that ends the work. After
    an interrupt the other threads finish their groups; a second interrupt does not wait for them,
    so that `one` must own all the memory that it reads and writes.
    """
    waiting = iter(range(groups))
    lock = threading.Lock()
    failures: list[BaseException] = []

    def work() -> None:
        with local() as mine:
            while not stop[0]:
                with lock:
                    group = next(waiting, None)
                if group is None:
                    break
                one(group, mine)

    def help() -> None:
        try:
            work()
        except BaseException as error:  # pragma: no cover
            failures.append(error)
            stop[:] = 1

    others: list[threading.Lock] = []
    try:
        for _ in range(threads - 1):
            others.append(_helper().take(help))
        work()
        _wait(others)
    except BaseException:
        stop[:] = 1
        _wait(others)
        raise
    if failures:
        raise failures[0]


class Helper(threading.Thread):
    """A thread that waits for work: starting a new one would cost more than a small kernel."""

    def __init__(self):
        super().__init__(name="lanes", daemon=True)
        self.gate = threading.Lock()
        self.gate.acquire()
        self.start()

    def take(self, work: Callable[[], None]) -> threading.Lock:
        """Begins the work, and returns the lock that is free once it is done."""
        done = threading.Lock()
        done.acquire()
        self.task = work, done
        self.gate.release()
        return done

    def run(self) -> None:
        while True:
            self.gate.acquire()
            work, done = self.task
            work()
            del work, self.task  # memory held by the work is free before the caller continues
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
    """Waits until each lock is free; a second call does no harm."""
    for done in others:
        with done:
            pass
