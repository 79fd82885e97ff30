"""Seconds by stage, the compiler's apart."""

import threading
import time
from typing import Any

import jax

COMPILERS = ("/jax/core/compile", "/snapo/compile")  # events that tell of compiling


class Clock:
    """Books the time of a run under the names of its stages, and that of compiling apart.

    A context manager: it listens to JAX's compiler and to that of the native engine until it is
    left. Compiling within compiling, as the tracing of a kernel is, counts once; that of other
    threads takes none of this one's time.
    """

    def __init__(self):
        self.seconds = {"compile": 0.0, "train": 0.0, "evaluate": 0.0}
        self._started, self._thread = time.perf_counter(), threading.get_ident()
        self._compiled: list[tuple[float, float]] = []
        self._listener: Any = self._heard

    def __enter__(self) -> "Clock":
        jax.monitoring.register_event_duration_secs_listener(self._listener)
        return self

    def __exit__(self, *_: object) -> None:
        jax.monitoring.unregister_event_duration_listener(self._listener)

    def _heard(self, event: str, duration: float, **_: Any) -> None:
        """An event is told when it ends."""
        if event.startswith(COMPILERS) and threading.get_ident() == self._thread:
            now = time.perf_counter()
            self._compiled.append((now - duration, now))

    def stage(self, name: str) -> None:
        """Books the time since the last call under this name, less the compiling in it."""
        now, heard = time.perf_counter(), sorted(self._compiled)
        compiled, reached = 0.0, self._started
        for first, last in heard:
            compiled += max(0.0, last - max(first, reached))
            reached = max(reached, last)
        self.seconds[name] += max(0.0, now - self._started - compiled)
        self.seconds["compile"] += compiled
        self._started, self._compiled = now, []

    def total(self) -> dict[str, float]:
        """The seconds of every stage, and of all together."""
        return self.seconds | {"total": sum(self.seconds.values())}
