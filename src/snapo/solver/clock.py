"""Seconds by stage, the compiler's apart."""

import time
from typing import Any

import jax


class Clock:
    """Books the time of a run under the names of its stages, and that of compiling apart.

    A context manager: it listens to JAX's compiler until it is left.
    """

    def __init__(self):
        self.seconds = {"compile": 0.0, "train": 0.0, "evaluate": 0.0}
        self._started, self._compiled = time.perf_counter(), 0.0
        self._listener: Any = self._heard

    def __enter__(self) -> "Clock":
        jax.monitoring.register_event_duration_secs_listener(self._listener)
        return self

    def __exit__(self, *_: object) -> None:
        jax.monitoring.unregister_event_duration_listener(self._listener)

    def _heard(self, event: str, duration: float, **_: Any) -> None:
        if event.startswith("/jax/core/compile"):
            self._compiled += duration

    def stage(self, name: str) -> None:
        """Books the time since the last call under this name, less the compiling in it."""
        now = time.perf_counter()
        spent, compiled = now - self._started, self._compiled
        self.seconds[name] += max(0.0, spent - compiled)
        self.seconds["compile"] += min(spent, compiled)
        self._started, self._compiled = now, 0.0

    def total(self) -> dict[str, float]:
        """The seconds of every stage, and of all together."""
        return self.seconds | {"total": sum(self.seconds.values())}
