"""A lock of the operating system on a file, which a killed process gives back."""

import errno
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

PAUSE = 0.02  # seconds between two attempts
BUSY = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


@contextmanager
def locked(file: Path, seconds: float = 0.2) -> Iterator[None]:
    """Holds the lock of `file`, which is made for it and removed after it.

    **Raises:** `BlockingIOError` where another process holds it for longer than these seconds.
    """
    stream = _taken(file, seconds)
    try:
        yield
    finally:
        if os.name == "nt":  # an open file cannot be removed there
            stream.close()
        with suppress(OSError):
            file.unlink()
        stream.close()


def is_locked(file: Path) -> bool:
    """Whether a process holds the lock of `file`."""
    try:
        with file.open("rb") as stream:
            return not _lock(stream, shared=True)
    except OSError:
        return False


def _taken(file: Path, seconds: float) -> IO[bytes]:
    ends = time.monotonic() + seconds
    while True:
        stream = file.open("ab")
        if _lock(stream) and _is_current(stream, file):
            return stream
        stream.close()
        if time.monotonic() > ends:
            raise BlockingIOError(errno.EAGAIN, "another process holds this lock", str(file))
        time.sleep(PAUSE)


def _is_current(stream: IO[bytes], file: Path) -> bool:
    """Whether the file is still there, and not removed by the process that held it before."""
    try:
        return os.path.samestat(os.fstat(stream.fileno()), file.stat())
    except OSError:
        return False


def _lock(stream: IO[bytes], shared: bool = False) -> bool:
    """Whether the lock was taken; a file system without locks gives it to everyone."""
    try:
        if os.name == "nt":
            import msvcrt

            stream.seek(0)
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)  # pyright: ignore
        else:
            import fcntl

            kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
            fcntl.flock(stream, kind | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in BUSY
    return True
