"""Machine code on disk, reused between runs, made in this process or in a separate one.

LLVM's passes do not release 0.2 megabytes of memory for a small kernel (measured with `mallinfo2`;
modules, contexts, pass managers and targets release all of theirs). After many compilations a new
process makes the code, to keep this memory bounded."""

import hashlib
import itertools
import os
import stat
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from . import pipeline
from .pipeline import PIPELINE

HERE = 64  # compilations in this process; those after them take 0.3 s longer each

_numbers = itertools.count()
_CHILD = """
import sys
from snapo.lanes.machine.pipeline import object_code
sys.stdout.buffer.write(object_code(sys.stdin.buffer.read().decode()))
"""


def object_code(text: str) -> bytes:
    """Machine code for a module's text, ready to be linked."""
    apart = _apart(text) if next(_numbers) >= HERE else None
    return pipeline.object_code(text) if apart is None else apart


def _apart(text: str) -> bytes | None:
    """Machine code made by a new process, which frees its memory as it ends; None if that fails."""
    if not sys.executable:
        return None
    root = str(Path(__file__).parents[3])
    positions = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(positions)}
    command = [sys.executable, "-c", _CHILD]
    try:
        done = subprocess.run(command, input=text.encode(), capture_output=True, env=environment)
    except OSError:
        return None
    return done.stdout if done.returncode == 0 and done.stdout else None


MARK = b"snapo kernel 2\n"  # of the layout: mark, checksum of name and code, code
CHECKSUM = 32
MAX_BYTES = 512 * 2**20  # of the folder; the least recently used code is removed first
MAX_SECONDS = 60 * 86_400  # that code stays unused
ENDING = ".o"


def cached(text: str, folder: Path) -> bytes:
    """Machine code for this text, from the folder if it was compiled before.

    The name of a file is a hash of the text and of the pipeline's identity, so that code made by
    other passes or another LLVM, or for another processor, is never used. A file is used if it
    belongs to this user, no other user may write it, and its checksum is correct; otherwise the
    code is compiled again.
    """
    path = folder / f"{key(text)}{ENDING}"
    data = read(path)
    if data is None:
        data = object_code(text)
        write(path, data)
    return data


def key(text: str) -> str:
    """The name under which code is stored."""
    digest = hashlib.sha256()
    for part in (PIPELINE.identity(), text):
        digest.update(hashlib.sha256(part.encode()).digest())
    return digest.hexdigest()


def cache_home() -> Path:
    """The user's folder for files that can be made again."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def evict(folder: Path) -> None:
    """Removes code that has not been used for long, and the oldest beyond the limit of size."""
    rows = []
    with suppress(OSError):
        for item in os.scandir(folder):
            with suppress(OSError):
                if item.is_file(follow_symlinks=False):
                    state = item.stat(follow_symlinks=False)
                    rows.append((state.st_mtime, state.st_size, item.path))
    size, now = 0, time.time()
    for used, bytes_, path in sorted(rows, reverse=True):
        size += bytes_
        if size > MAX_BYTES or now - used > MAX_SECONDS:
            with suppress(OSError):
                os.unlink(path)


def _checksum(name: str, data: bytes) -> bytes:
    return hashlib.sha256(name.encode() + data).digest()


def read(path: Path) -> bytes | None:
    """The content of a file of the folder; None if it cannot be trusted or does not exist."""
    try:
        with open(path, "rb") as file:
            state = os.fstat(file.fileno())
            if not (stat.S_ISREG(state.st_mode) and is_private(state)):
                return None
            content = file.read()
    except OSError:
        return None
    start = len(MARK) + CHECKSUM
    data = content[start:]
    if content[:start] != MARK + _checksum(path.stem, data):
        return None
    with suppress(OSError):
        os.utime(path)  # used just now
    return data


def is_private(state: os.stat_result) -> bool:
    """Whether a file or a folder is this user's, and not writable by others."""
    if not hasattr(os, "geteuid"):  # Windows: the folder lies in the user's own
        return True
    return state.st_uid == os.geteuid() and not state.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def write(path: Path, data: bytes) -> None:
    """Writes a file of the folder, atomically, and removes the oldest files beyond its limits.

    If the disk cannot be written, no error is raised.
    """
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            try:
                file.write(MARK + _checksum(path.stem, data) + data)
                file.flush()
                os.replace(file.name, path)
            except BaseException:
                os.unlink(file.name)
                raise
    evict(path.parent)
