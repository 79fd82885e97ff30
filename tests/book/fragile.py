"""Work of jobs that kills its worker, or fails: light, as every worker imports it."""

import os
import signal
import time
from pathlib import Path

MARK = "SNAPO_TEST_MARK"  # the variable that names the file of `dies_once`


def echo(job: bytes) -> bytes:
    """Once: where the job names a file that is not there, the worker makes it and dies. Poison
    kills every worker; "other" is refused by every one."""
    kind, _, file = job.decode().partition(":")
    if kind == "once" and not Path(file).exists():
        Path(file).touch()
        time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "poison":
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "fails":
        raise MemoryError("too large")
    if kind == "other":
        from snapo.engine.workers import OTHER

        return OTHER
    return job + b"!"


def dies_once(job: bytes) -> bytes:
    """Computes groups of paths; the first worker that has an answer dies before it gives it."""
    from snapo.engine.native.distributed import UNKNOWN, compute

    answer, mark = compute(job), Path(os.environ[MARK])
    if answer != UNKNOWN and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return answer
