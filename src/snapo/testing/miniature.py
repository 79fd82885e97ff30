"""Small runs of real cases: a template made small, its study carried out, and shared by tests.

    folder = case_folder(domain.templates["small"], scratch / "case", {"years = 10": "years = 2"})
    result = run(folder, scratch / "run")

A solved miniature is what tests of a report, of the commands and of a run folder read; `once`
makes it a single time for all processes of a test session.
"""

from collections.abc import Callable, Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from snapo.case.table import load
from snapo.study.carry_out import carry_out
from snapo.study.domain import Domain, Options, find
from snapo.study.run_folder import copy_case, decisive


def case_folder(source: Traversable, target: Path, changes: Mapping[str, str]) -> Path:
    """A copy of the case in the folder `source`, with texts of its case.toml replaced.

    **Raises:** `ValueError` where a text to replace is not there: the template has changed.
    """
    target.mkdir(parents=True)
    for each in source.iterdir():
        if each.is_file():
            (target / each.name).write_bytes(each.read_bytes())
    file = target / "case.toml"
    text = file.read_text(encoding="utf-8")
    for old, new in changes.items():
        if old not in text:
            raise ValueError(f"{source.name}/case.toml has no {old!r}")
        text = text.replace(old, new, 1)
    file.write_text(text, encoding="utf-8")
    return target


def run(
    case: Path,
    out: Path,
    options: Options | None = None,
    *,
    domain: Domain | None = None,
    resume: bool = False,
    tell: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Reads the case at `case`, carries its study out into `out`, and returns the result.

    `domain` is the one that the case's `kind` names, or one that is not installed yet.
    """
    file, data = load(case)
    domain = domain or find(data.get("kind"), str(file))
    options = options or Options()
    study = domain.study(domain.read(file, data), options)
    out.mkdir(parents=True, exist_ok=True)
    copy_case(file, out)
    decides = decisive(file, data, options._asdict())
    return carry_out(domain, study, out, decides, resume, tell)


def once(folder: Path, make: Callable[[Path], Any]) -> Path:
    """The folder, filled by `make(folder)` by the first process that asks; the others wait.

    Where `make` fails, its exception goes to that caller, and the next one tries again. The lock
    is one of the operating system's, which a killed process gives back (POSIX only).
    """
    import fcntl

    folder.parent.mkdir(parents=True, exist_ok=True)
    done = folder.with_name(folder.name + ".done")
    with folder.with_name(folder.name + ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            make(folder)
            done.touch()
    return folder
