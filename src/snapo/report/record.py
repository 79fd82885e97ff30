"""run.json as typed records; a missing key, as in a run of an earlier version, is empty."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

Entries = TypeVar("Entries", bound=tuple)
EMPTY: Mapping[str, Any] = MappingProxyType({})


def entries_of(kind: type[Entries], table: Any) -> Entries:
    """The named tuple with the entries of a JSON table; it is empty for data that is not a
    table."""
    table = table if isinstance(table, Mapping) else EMPTY
    names: Sequence[str] = kind._fields  # pyright: ignore[reportAttributeAccessIssue]
    return kind(**{name: table[name] for name in names if name in table})


class PartState(NamedTuple):
    """The status of a part: "done", "failed" or "skipped", and the reason if the part was not done.
    - `seconds`: its time in seconds; `files`: {name: checksum} of the files that the part wrote.
    """

    state: str = ""
    note: str = ""
    seconds: float = 0.0
    files: Mapping[str, str] | None = None


class PreviousRun(NamedTuple):
    """The previous run: its name, value and standard error, and the settings that differ from it.

    - `difference`, `difference_error`: the difference of the values and its error; `paired`:
      whether both are on the same paths.
    """

    run: str | None = None
    value: float | None = None
    standard_error: float | None = None
    changes: Sequence[Mapping[str, Any]] = ()
    difference: float | None = None
    difference_error: float | None = None
    paired: bool = False


class RunOrigin(NamedTuple):
    """The origin of a run.

    - `run`: its name; `began`, `began_utc`: the time at which it began, in ISO 8601.
    - `case`: folder and file of the case; `sha256`: the hash of the file; `assignments`: the
      assignments of `--set`.
    - `previous`: the previous run, read with `PreviousRun`; None if there is none.
    """

    run: str | None = None
    began: str = ""
    began_utc: str | None = None
    case: str = ""
    sha256: str = ""
    assignments: Sequence[str] = ()
    machine: str = ""
    previous: dict[str, Any] | None = None


class StepTimes(NamedTuple):
    """The times of the steps in `about`: `local_times` as in `local_times_of`, and the `step`,
    "day" or "hour"; empty if steps have only numbers."""

    local_times: Sequence[tuple[int, str]] = ()
    step: str = ""


class PageTexts(NamedTuple):
    """`[report]` of a case: texts of the page, and the name of a picture."""

    title: str | None = None
    author: str | None = None
    note: str | None = None
    logo: str | None = None


class LibraryVersions(NamedTuple):
    """The versions of snapo and Python; the table also has the versions of other libraries."""

    snapo: str = ""
    python: str = ""


class RunSettings(NamedTuple):
    """The settings that determine the numbers of a run: its case, the options of the command, and
    versions."""

    case: Mapping[str, Any] = EMPTY
    options: Mapping[str, Any] = EMPTY
    versions: Mapping[str, str] = EMPTY


class RunRecord(NamedTuple):
    """The tables of run.json.

    - `about`: the description of the study; `parts`: {name: state}; read a state with `PartState`.
    - `beside`: the time of work outside of the parts, in seconds, by name; `result`: the checksum
      of result.json.
    """

    kind: str | None = None
    decides: Mapping[str, Any] = EMPTY
    about: Mapping[str, Any] = EMPTY
    parts: Mapping[str, Mapping[str, Any]] = EMPTY
    provenance: Mapping[str, Any] | None = None
    beside: Mapping[str, float] = EMPTY
    result: str | None = None

    def part(self, name: str) -> PartState:
        """The status of a part; empty if it has not started."""
        return entries_of(PartState, self.parts.get(name))

    @property
    def origin(self) -> RunOrigin:
        return entries_of(RunOrigin, self.provenance)

    @property
    def settings(self) -> RunSettings:
        return entries_of(RunSettings, self.decides)
