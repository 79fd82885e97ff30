"""Lines of progress during a long part of a run, some seconds apart."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

EVERY = 10.0  # seconds between two lines

_listeners: list[list] = []  # [callback, start of the part, time of the last report]


@contextmanager
def reporting(progress: Callable[[str], None]) -> Iterator[None]:
    """Within this context, `say` passes its lines to `progress`."""
    now = time.perf_counter()
    _listeners.append([progress, now, now])
    try:
        yield
    finally:
        _listeners.pop()


def say(text: str) -> None:
    """Reports a line of progress, if the last one was long enough ago and there is a receiver."""
    if not _listeners:
        return
    progress, began, last = _listeners[-1]
    now = time.perf_counter()
    if now - last >= EVERY:
        _listeners[-1][2] = now
        progress(f"  {text}, {now - began:.0f} s")
