"""`[report] parts`: restricts the runs of a case to some of their parts."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from .error import CaseError, nearest
from .table import doc

PartNames = list[Annotated[str, Field(min_length=1)]]


def names_of_parts(example: str) -> Any:
    """The field `parts: Names` of a domain's table `[report]`."""
    message = f'names of parts such as ["{example}"]; the parts that these need are also computed'
    return doc("parts of the run to compute, by default all", [], message)


def known_parts(
    file: Path,
    requested: Sequence[str],
    available: Collection[str],
    missing: Mapping[str, str] | None = None,
) -> tuple[str, ...]:
    """The requested parts of a run, by name; () if none is named, which means all.

    - `available`: all parts of the domain; `missing`: {part: why a run of this case does not have
      it, as a clause}.

    **Raises:** `CaseError` for an unknown name, or the name of a missing part.
    """
    for i, name in enumerate(requested):
        message = ""
        if name not in available:
            message = f"there is no such part; {nearest(name, available, 'part')}"
        elif missing and name in missing:
            message = f"a run of this case has no such part: {missing[name]}"
        if message:
            raise CaseError(str(file), f"report.parts[{i}]", name, message)
    return tuple(requested)
