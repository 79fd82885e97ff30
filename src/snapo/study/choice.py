"""The parts of a run that were asked for, with those that they need."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.report.folder import LEFT_OUT, PLANNED

from .study import Part
from .training import TRAINING


def with_needs(parts: Sequence[Part], requested: Sequence[str]) -> list[Part]:
    """The parts with these names, and all that they need; all where none is named."""
    if not requested:
        return list(parts)
    by_name = {part.name: part for part in parts}
    selected: set[str] = set()
    left = [name for name in requested if name in by_name]
    while left:
        name = left.pop()
        if name not in selected:
            selected.add(name)
            left += by_name[name].needs
    return [part for part in parts if part.name in selected]


def summary(parts: Sequence[Part], selected: Sequence[Part]) -> dict[str, list[str]]:
    """What a study's `about` says of them, for a report: names of parts, `selected` and left
    out."""
    return {
        PLANNED: [part.name for part in selected],
        LEFT_OUT: [part.name for part in parts if part not in selected],
    }


def no_policy(out: Path, record: Mapping[str, Any]) -> CaseError:
    """Why the run in a folder, with its record, has no trained policy."""
    message = "this run has no trained policy: solve its case again, or go on with --resume"
    if TRAINING.name in record.get("about", {}).get(LEFT_OUT, ()):
        message = "this run has no trained policy: its `[report] parts` leave out the training"
    return CaseError(str(out), "", None, message)
