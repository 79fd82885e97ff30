"""Work of orders that kills its worker, or fails: light, as every worker imports it."""

import os
import signal
import time
from pathlib import Path


def echo(order: bytes) -> bytes:
    """Once: where the order names a file that is not there, the worker makes it and dies. Poison
    kills every worker; "other" is refused by every one."""
    kind, _, file = order.decode().partition(":")
    if kind == "once" and not Path(file).exists():
        Path(file).touch()
        time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "poison":
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "fails":
        raise MemoryError("too large")
    if kind == "other":
        from snapo.book.workers import OTHER

        return OTHER
    return order + b"!"
