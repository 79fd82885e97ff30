"""Small runs of real cases: makes a template small and carries out its study, so that tests can
share the run.

    small = Miniature("pension", "small", ("fund.years=2", "training.steps=4"))
    run = once(session_folder / "pension", small.solve) / "run"

Tests of a report, of the commands and of a run folder read a solved miniature; `once` makes it only
one time for all processes of a test session.
"""

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from snapo.study import commands

CASE, RUN = "case", "run"


class Miniature(NamedTuple):
    """A case small enough to be solved in seconds: a template with smaller numbers and fewer parts.

    - `kind`: the kind of the domain, which must be installed.
    - `size`: the size of its template; by default the default size of the kind. - `assignments`:
      keys with new values, written as for `snapo solve --set`.
    - `simulator`: (module, class) next to the case, for a kind that runs the user's code.
    - `texts`: returns the files of the case, {name: text}, if it is not a template.
    """

    kind: str
    size: str | None = None
    assignments: tuple[str, ...] = ()
    simulator: tuple[str, str] | None = None
    texts: Callable[[], Mapping[str, str]] | None = None

    def request(self, folder: Path) -> commands.CaseRequest:
        """The request for a command on the case in `folder`/case."""
        return commands.CaseRequest(folder / CASE, self.assignments, self.simulator)

    def write(self, folder: Path) -> commands.CaseRequest:
        """Writes the template, or the files of `texts`, into `folder`/case."""
        if self.texts is None:
            commands.new(self.kind, folder / CASE, self.size)
        else:
            (folder / CASE).mkdir(parents=True)
            for name, text in self.texts().items():
                (folder / CASE / name).write_text(text, encoding="utf-8")
        return self.request(folder)

    def solve(self, folder: Path, **options: Any) -> dict[str, Any]:
        """Writes the case to `folder`/case and its run to `folder`/run; returns the result.

        `options` are those of `snapo.study.commands.solve`: engine, reference.
        """
        return commands.solve(self.write(folder), quiet, out=folder / RUN, **options)


def quiet(text: str) -> None:
    """Ignores a line of progress."""


def once(folder: Path, make: Callable[[Path], Any]) -> Path:
    """The folder, which `make(folder)` fills in the first process that calls this function; other
    processes wait.

    If `make` fails, its files are removed, and the next caller tries again. The lock is a lock of
    the operating system, which is released if the process is killed (POSIX only).
    """
    import fcntl

    folder.parent.mkdir(parents=True, exist_ok=True)
    done = folder.with_name(folder.name + ".done")
    with folder.with_name(folder.name + ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            try:
                make(folder)
            except BaseException:
                shutil.rmtree(folder, ignore_errors=True)
                raise
            done.touch()
    return folder
