"""A case of every domain, small enough to be solved in seconds: the template with less of it."""

from pathlib import Path

from snapo.study.domain import find
from snapo.testing.miniature import case_folder, run

# Of each kind: the size of the template, and what is replaced in its case.toml.
MINIATURES: dict[str, tuple[str, dict[str, str]]] = {}


def case(kind: str, folder: Path) -> Path:
    """The miniature of a domain as a case in `folder`."""
    size, changes = MINIATURES[kind]
    return case_folder(find(kind, "tests").templates[size], folder, changes)


def solve(kind: str, folder: Path) -> None:
    """The miniature in `folder`/case, and its run in `folder`/run."""
    run(case(kind, folder / "case"), folder / "run")
