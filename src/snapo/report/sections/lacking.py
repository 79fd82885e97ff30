"""The sentence that stands in a report for numbers that are not there."""

from ..folder import Folder
from ..page import Missing


def lacking(run: Folder, part: str) -> Missing:
    """Why the numbers of a part are not in this run."""
    state = run.parts.get(part)
    if state is None:
        return Missing(f"This run stopped before its part “{part}”.")
    if state.get("note"):
        return Missing(f"The part “{part}” {state.get('state', 'failed')}: {state['note']}.")
    return Missing(f"The part “{part}” has nothing to show.")
