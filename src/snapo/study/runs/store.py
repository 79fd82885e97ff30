"""The folders of the runs of a case, and the link `run`, which points to the latest run.

mine/runs/2026-11-25T1530-7f3a     one run: the local time at which it began, and four digits
mine/run                           a symbolic link to the latest run (a text file without links)

The latest run is the last that finished with valid numbers or, if there is none, the last that
began. A run that is writing holds a lock of the operating system on a file. The lock is released if
the process is killed.
"""

import datetime
import errno
import os
import secrets
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from snapo.case.error import CaseError
from snapo.problem.carry.latest import LATEST, NAME, RUNS, followed, target
from snapo.report.record import RunRecord, entries_of

from .. import run_folder
from ..domain import GOOD

PAUSE = 0.02  # seconds between two attempts
BUSY = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


@contextmanager
def locked(file: Path, seconds: float = 0.2) -> Iterator[None]:
    """Holds a lock on a `file` while the block runs; the file is created before the block and
    removed after it.

    **Raises:** `BlockingIOError` if another process holds the lock for longer than `seconds`.
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
    """Whether the file still exists and was not removed by the process that held the lock
    before."""
    try:
        return os.path.samestat(os.fstat(stream.fileno()), file.stat())
    except OSError:
        return False


def _lock(stream: IO[bytes], shared: bool = False) -> bool:
    """Whether the lock was taken; on a file system without locks it is always taken."""
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


LOCK = ".lock"  # in a run folder while a process writes it; in `runs` while `run` is set
PATIENCE = 30.0  # seconds to wait for another process that sets `run`, which takes milliseconds


def new_folder(home: Path) -> Path:
    """Makes an empty folder for a run of the case in `home`; no other process gets the same
    folder."""
    while True:
        name = f"{datetime.datetime.now():%Y-%m-%dT%H%M}-{secrets.token_hex(2)}"
        try:
            (home / RUNS / name).mkdir(parents=True)
        except (FileExistsError, FileNotFoundError):  # of the same name; `runs` was just removed
            continue
        return home / RUNS / name


def home_of(folder: Path) -> Path | None:
    """The folder of the case, if `folder` is one of the runs in its `runs`; None for any other
    folder."""
    is_run = folder.parent.name == RUNS and NAME.fullmatch(folder.name)
    return folder.parent.parent if is_run else None


def folders(home: Path) -> list[Path]:
    """The runs of the case in `home`, with the oldest first; a run that has written nothing is
    omitted.

    A run of an earlier version of snapo, in a plain folder `run`, is the oldest.
    """
    runs = home / RUNS
    names = [file for file in runs.iterdir() if NAME.fullmatch(file.name)] if runs.is_dir() else []
    began = sorted((_began(file), file.name, file) for file in names if file.is_dir())
    plain = home / LATEST
    older = [plain] if not plain.is_symlink() and _is_run(plain) else []
    return [*older, *(file for when, _, file in began if when)]


def _began(folder: Path) -> str:
    """The time at which a run began, as text that can be sorted; "" if nothing was written."""
    record = entries_of(RunRecord, run_folder.read_table(folder / run_folder.RUN))
    exact = record.origin.began_utc
    if isinstance(exact, str):
        return exact
    files = [file for file in folder.iterdir() if file.name != LOCK]
    times = [file.stat().st_mtime for file in files]
    return _utc(min(times)) if times else ""


def _utc(seconds: float) -> str:
    moment = datetime.datetime.fromtimestamp(seconds, datetime.UTC)
    return moment.isoformat(timespec="milliseconds")


def _is_run(folder: Path) -> bool:
    names = (run_folder.RUN, run_folder.RESULT, run_folder.CHECKPOINT)
    return any((folder / name).is_file() for name in names)


def is_good(folder: Path) -> bool:
    """Whether a run finished with valid numbers."""
    result = run_folder.read_table(folder / run_folder.RESULT) or {}
    return result.get("status") in GOOD


def point_to(folder: Path) -> bool:
    """Makes `run` point to a run in `runs`, unless it points to a better run; returns whether it
    points to this run."""
    home = home_of(folder)
    if home is None:
        return False
    with only_one(home):
        now = target(home / LATEST)
        better = now is None or is_good(folder) or not is_good(now)
        if better:
            set_link(home, folder)
        return better or now == folder


def set_link(home: Path, folder: Path) -> None:
    """Replaces `run` in one step, so that it is never missing and never points elsewhere."""
    made = home / f".{LATEST}-{secrets.token_hex(4)}"
    text = f"{RUNS}/{folder.name}"
    try:
        if os.name == "nt":  # where a link to a folder cannot be replaced at once
            raise NotImplementedError
        made.symlink_to(text, target_is_directory=True)
    except (OSError, NotImplementedError):
        made.write_text(text + "\n", encoding="utf-8")
    try:
        made.replace(home / LATEST)
    except OSError:
        made.unlink(missing_ok=True)
        raise


@contextmanager
def only_one(home: Path) -> Iterator[None]:
    """Only one process at a time may set `run` or remove runs."""
    (home / RUNS).mkdir(exist_ok=True)
    with locked(home / RUNS / LOCK, PATIENCE):
        yield


def adopt(home: Path) -> None:
    """Moves a run of an earlier version from a plain folder `run` to the other runs, and makes
    `run` point to it. **Raises:** `CaseError` if `run` is something else, which is not changed.
    """
    plain = home / LATEST
    if target(plain) is not None or not os.path.lexists(plain):
        return
    with only_one(home):
        if target(plain) is not None or not os.path.lexists(plain):
            return
        is_folder = plain.is_dir() and not plain.is_symlink()
        if is_folder and _is_run(plain):
            began = datetime.datetime.fromtimestamp((plain / _marker(plain)).stat().st_mtime)
            folder = home / RUNS / f"{began:%Y-%m-%dT%H%M}-{secrets.token_hex(2)}"
            plain.rename(folder)
            set_link(home, folder)
            return
        if is_folder and not any(plain.iterdir()):
            plain.rmdir()
            return
    with suppress(OSError):
        (home / RUNS).rmdir()
    message = (
        "this is not a run, but it has the name of the link to the latest run; rename it, or name "
        "a folder with --out"
    )
    raise CaseError(str(plain), "", None, message)


def _marker(folder: Path) -> str:
    names = (run_folder.RUN, run_folder.RESULT, run_folder.CHECKPOINT)
    return next(name for name in names if (folder / name).is_file())


def located(path: Path) -> Path:
    """The folder of the run that a command means: a run folder, or the latest run of a case."""
    if (path / run_folder.RUN).is_file() or (path / "book.json").is_file():
        return followed(path)
    latest = case_folder(path) / LATEST
    return followed(latest if path != latest and os.path.lexists(latest) else path)


def case_folder(path: Path) -> Path:
    """The folder of the case that a command names by its folder, its file or one of its runs."""
    if path.suffix.lower() == ".xlsx":
        return path.with_suffix("")
    if path.is_file() and target(path) is None:
        return path.parent
    return home_of(followed(path)) or path


def shown(folder: Path) -> Path:
    """The shortest name of a run folder: `run` if this link points to it."""
    home = home_of(folder)
    return home / LATEST if home and target(home / LATEST) == folder else folder


def is_busy(folder: Path) -> bool:
    """Whether a process is writing into a run folder."""
    return is_locked(folder / LOCK)


@contextmanager
def working_in(folder: Path) -> Iterator[None]:
    """Only this process may write into a run folder within this context. **Raises:** `CaseError` if
    another process is writing into it.
    """
    missing = [item for item in (folder, *folder.parents) if not item.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with locked(folder / LOCK):
            yield
    except BlockingIOError:
        message = (
            "another process is working on this run; wait until it has finished, or solve "
            "into another folder"
        )
        raise CaseError(str(folder), "", None, message) from None
    finally:
        for item in missing:  # where nothing was written
            with suppress(OSError):
                item.rmdir()
