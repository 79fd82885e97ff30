"""A domain, which turns a user's file into a study, and a case that the domain has read.

Domains of this and other packages are found by the entry-point group `snapo.domains`. An entry
point names an object with the attributes of `Domain`; its module imports no large packages, so that
`snapo new` answers immediately.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from snapo.case.error import CaseError, Unquoted

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

    from snapo.report.folder import RunFiles
    from snapo.report.page import Section

    from .study import ProgressCallback, Study

GROUP = "snapo.domains"
BOOK = "book"  # the kind of a file with many cases, which is no domain
GOOD = ("ok", "trained", "stopped early")  # statuses of a run whose numbers are in order


class Options(NamedTuple):
    """The options of a command other than the case.

    - `engine`: "auto", "xla" or "native".
    - `reference`: whether to compute exact values as well, however long this takes.
    - `about`: the `about` of an earlier run of the same case that passed the checks, or None.
    - `ladder`: whether to value the contract by all methods, on common paths; `hedge`: whether to
      simulate its hedges; `gamma`: whether to measure the change of deltas with prices, by product.
    """

    engine: str = "auto"
    reference: bool = False
    about: Mapping[str, Any] | None = None
    ladder: bool = False
    hedge: bool = False
    gamma: bool = False


class Case(Protocol):
    """A case that has been read: its file, and remarks for the user."""

    @property
    def file(self) -> Path: ...

    @property
    def notes(self) -> Sequence[str]: ...


@dataclass(frozen=True)
class Report:
    """The layout of a run's report, from the files of its folder only.

    - `title`: the title of a run that has no title of its own.
    - `folder`: the class that reads the run; the class of a domain adds its units.
    - `about`: (name, value) pairs below the title. - `sections`: functions that make the sections
      of the page. - `menu`: {link: the first section of its group}; if it is empty, there is a link
      to every section.
    """

    title: str
    folder: "type[RunFiles]"
    about: "Callable[[Any], Sequence[tuple[str, str]]]"
    sections: "Sequence[Callable[[Any], Section]]"
    menu: "Mapping[str, Callable[[Any], Section]]" = field(default_factory=dict)

    def links(self, made: "Sequence[Section]") -> "list[tuple[str, str]]":
        """(anchor, text) for the menu; `made`: the sections; sections without blocks are not
        shown."""
        if not self.menu:
            return [(x.name, x.short) for x in made if x.blocks and x.short]
        names = {id(first): text for text, first in self.menu.items()}
        links, text = [], ""
        for section, result in zip(self.sections, made, strict=True):
            text = names.get(id(section), text)
            if text and result.blocks:
                links.append((result.name, text))
                text = ""
        return links


@runtime_checkable
class Domain(Protocol):
    """A kind of case.

    - `kind`: the word in a case's `kind`; `description`: a phrase for the list of `snapo new`.
    - `templates`: {size: folder that `snapo new` copies}; the first size is the default.
    """

    kind: str
    description: str

    @property
    def templates(self) -> "Mapping[str, Traversable]": ...

    def read(self, file: Path, data: Mapping[str, Any]) -> Case:
        """Makes the records from the tables of a case; **raises** `CaseError` for every mistake."""
        ...

    def check(self, case: Any) -> list[str]:
        """A summary of the case in a few lines; nothing is trained."""
        ...

    def study(self, case: Any, options: Options) -> "Study":
        """The study of the case, which a run carries out."""
        ...

    def report(self) -> Report:
        """The layout of a run's report."""
        ...

    def bench(self, engine: str, progress: "ProgressCallback") -> str:
        """The times of values and gradients on this machine, as a table in plain text."""
        ...


@runtime_checkable
class RunsCode(Protocol):
    """A domain whose cases run code, named only on the command line.

    - `example`: the code of the domain's template, as MODULE:CLASS.
    """

    example: str

    def with_simulator(self, module: str, name: str) -> Domain:
        """The same domain with the simulator class `name` of `module`."""
        ...

    def decides(self, case: Any) -> Mapping[str, Any]:
        """The code that affects the numbers of a run: its name and the hash of its file."""
        ...


@cache
def installed() -> dict[str, EntryPoint]:
    """{kind: entry point} of all domains; none is imported.

    **Raises:** `CaseError` if two packages provide the same kind.
    """
    table: dict[str, EntryPoint] = {}
    for entry_point in entry_points(group=GROUP):
        if entry_point.name in table and entry_point.value != table[entry_point.name].value:
            message = (
                f"two packages provide the same kind: {table[entry_point.name].value} "
                f"and {entry_point.value}"
            )
            raise CaseError("kind", "", entry_point.name, message)
        table[entry_point.name] = entry_point
    return dict(sorted(table.items()))


def find(kind: Any, file: str, where: str = "kind") -> Domain:
    """The domain of a kind, the entry `where` of `file`."""
    available = installed()
    if not available:
        message = "no kind of case is installed; install snapo with pip"
        raise CaseError(file, where, kind, message)
    if not isinstance(kind, str) or kind not in available:
        raise _no_such_kind(kind, available, file, where)
    try:
        domain = available[kind].load()
    except (ImportError, AttributeError) as error:
        message = f"{available[kind].value} cannot be loaded ({error})"
        raise CaseError(file, where, kind, message) from error
    if not isinstance(domain, Domain):
        missing = [name for name in _MEMBERS if not hasattr(domain, name)]
        message = f"{available[kind].value} is not a domain: it has no {', '.join(missing)}"
        raise CaseError(file, where, kind, message)
    return domain


def _no_such_kind(kind: Any, available: Collection[str], file: str, where: str) -> CaseError:
    """The error for an unknown kind; the kind of a file may also be "book", for other commands."""
    if where and kind == BOOK:
        message = (
            "this is a book of contracts: use snapo book to value it, or snapo check to check it"
        )
        return CaseError(file, where, kind, message)
    names = [*available, BOOK] if where else list(available)
    kinds = ", ".join(f'"{item}"' for item in available)
    kinds += f', or "{BOOK}" in a file for snapo book' if where else ""
    if kind is None:
        return CaseError(file, where, None, f"this key is missing; it is one of {kinds}")
    close = get_close_matches(kind, names, n=1) if isinstance(kind, str) else []
    suggestion = f"; the nearest known kind is {close[0]}" if close else ""
    return CaseError(file, where, kind, f"it must be one of {kinds}{suggestion}")


_MEMBERS = ("kind", "description", "templates", "read", "check", "study", "report", "bench")


class CaseRequest(NamedTuple):
    """The options of a command for a case.

    - `path`: a TOML file, or a folder with case.toml.
    - `assignments`: keys with a new value for this run, "contract.inventory=2000".
    - `simulator`: (module, class) of the user, named only on the command line.
    """

    path: Path
    assignments: tuple[str, ...] = ()
    simulator: tuple[str, str] | None = None


class Loaded(NamedTuple):
    """A case that has been read: its domain, its file, its tables after all changes, its records,
    and the `assignments` that changed the tables."""

    domain: Domain
    file: Path
    data: Mapping[str, Any]
    case: Any
    assignments: tuple[str, ...] = ()


def load(request: CaseRequest) -> Loaded:
    """Reads a case with the domain that its `kind` names."""
    from snapo.case.load import load as load_tables

    from .assign import OPTION, assigned

    file, tables = load_tables(request.path)
    data, paths = assigned(tables, request.assignments)
    domain = find(data.get("kind"), str(file))
    if request.simulator is not None:
        if not isinstance(domain, RunsCode):
            got = Unquoted(":".join(request.simulator))
            message = (
                f'a case of kind "{domain.kind}" has a fixed simulator; for your own simulator '
                'write a case of kind "own"'
            )
            raise CaseError("--simulator", "", got, message)
        domain = domain.with_simulator(*request.simulator)
    try:
        return Loaded(domain, file, data, domain.read(file, data), request.assignments)
    except CaseError as error:
        for item in (error, *error.others):
            if item.where in paths:
                item.file = f"{item.file} with {OPTION}"
        raise


def remarks(
    notes: Iterable[str], progress: "ProgressCallback", ignored: Collection[str] = ()
) -> None:
    """Prints the remarks for the user of a case, except those in `ignored`."""
    for note in notes:
        if note not in ignored:
            progress(f"note: {note}")
