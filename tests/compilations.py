"""What is compiled meanwhile."""

from collections.abc import Iterator
from contextlib import contextmanager

from jax import monitoring

EVENTS = ("/jax/core/compile/backend_compile_duration", "/snapo/compile")


@contextmanager
def compilations() -> Iterator[list[str]]:
    """The events of every program that XLA or the native engine compiles within."""
    made: list[str] = []

    def heard(event: str, duration_secs: float, **more) -> None:
        if event in EVENTS:
            made.append(event)

    monitoring.register_event_duration_secs_listener(heard)
    try:
        yield made
    finally:
        monitoring.unregister_event_duration_listener(heard)
