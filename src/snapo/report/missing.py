"""The sentence in a report on missing numbers."""

from collections.abc import Callable
from functools import wraps
from typing import TypeVar

from .folder import LEFT_OUT, PLANNED, RunFiles
from .page import Missing, Section, Text

AnyFolder = TypeVar("AnyFolder", bound=RunFiles)
SectionFunction = Callable[[AnyFolder], Section]


def why_missing(run: RunFiles, part: str, table: str = "") -> Missing:
    """The reason why the numbers of a part are not in this run; `table`: the table of a case that
    requests the part."""
    state = run.parts.get(part)
    if state is None and run.left_out(part):
        return Missing(f"The part “{part}” is not among the `[report] parts`.")
    if state is None and part not in run.get(PLANNED, [part]):
        none = f"The case has no `[{table}]`." if table else f"This run has no part “{part}”."
        return Missing(none)
    if state is None:
        return Missing(f"This run stopped before its part “{part}”.")
    if state.note:
        return Missing(f"The part “{part}” {state.state}: {state.note}.")
    return Missing(f"The part “{part}” has nothing to show.")


def unless_left_out(section: SectionFunction, *parts: str) -> SectionFunction:
    """The section; an empty section if none of its parts was requested."""

    @wraps(section)
    def with_reason(run) -> Section:
        if run.left_out(*parts):
            return Section(section.__name__, "", "", [])
        return section(run)

    return with_reason


def not_asked(run: RunFiles) -> list[Text]:
    """A sentence on the parts that were not requested; none if all parts were."""
    names = [item for item in run.get(LEFT_OUT, []) if run.left_out(item)]
    if not names:
        return []
    listed = ", ".join(names)
    return [Text(f"Parts not requested for this run (`[report] parts`): {listed}.")]
