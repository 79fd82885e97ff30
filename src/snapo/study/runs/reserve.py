"""The folder into which a case is solved: a new folder, or the folder of the run to resume."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from snapo.case.error import CaseError, Unquoted
from snapo.problem.carry.latest import LATEST, RUNS

from .. import run_folder
from .store import adopt, folders, home_of, new_folder, working_in


@contextmanager
def reserved(home: Path, out: Path | None, same: Callable[[Path], bool] | None) -> Iterator[Path]:
    """The folder of a run of the case in `home`, into which no other process writes.

    - `out`: the folder that the command names; None, or `run` in `home`, means a new folder in
      `runs`.
    - `same`: None for a new run; to resume a run, a function that returns whether a folder has the
      run that the command describes, or raises `CaseError` with the difference. The latest such run
      is resumed.

    A folder into which nothing was written is removed again.

    **Raises:** `CaseError` if the folder cannot be written, is the folder of the case, or has a run
    that must not be replaced.
    """
    _check_links(home, out)
    if out is not None and not (out.name == LATEST and out.parent.resolve() == home.resolve()):
        folder = _explicit(home, out, same is not None)
    else:
        run_folder.check_writable(home / RUNS)
        adopt(home)
        folder = (_to_resume(home, same) if same is not None else None) or new_folder(home)
    try:
        with working_in(folder):
            yield folder
    finally:
        if home_of(folder) is not None:
            with suppress(OSError):
                folder.rmdir()
                folder.parent.rmdir()


def _check_links(home: Path, out: Path | None) -> None:
    try:
        same = out is not None and out.resolve() == home.resolve()
    except (OSError, RuntimeError):  # links in a circle
        message = "this cannot be the name of a folder, because its links form a circle"
        raise CaseError(str(out), "", None, message) from None
    if same:
        message = "this is the folder of the case; a run needs a separate folder"
        raise CaseError("--out", "", Unquoted(str(out)), message)


def _explicit(home: Path, out: Path, resume: bool) -> Path:
    run_folder.check_writable(out)
    if not resume and home_of(out.resolve()) is not None and (out / run_folder.RUN).exists():
        message = (
            "this folder contains a stored run, which is not replaced; omit --out, or name "
            "another folder"
        )
        raise CaseError("--out", "", Unquoted(str(out)), message)
    return out


def _to_resume(home: Path, same: Callable[[Path], bool]) -> Path | None:
    """The latest run that the command describes; None if there is no run at all.

    **Raises:** `CaseError` if no run fits the description, or a process is working on it.
    """
    errors: list[CaseError] = []
    for folder in reversed(folders(home)):
        try:
            if same(folder):
                return folder
        except CaseError as error:
            errors.append(error)
    if errors:
        raise errors[0]
    return None
