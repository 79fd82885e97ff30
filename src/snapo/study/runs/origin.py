"""The origin of a run, for its report: case, date, machine, and the previous run."""

import datetime
import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.problem.carry.latest import LATEST, target
from snapo.report.checksums import checksum
from snapo.report.folder import RunResult
from snapo.report.record import RunRecord, RunSettings, entries_of

from .. import run_folder
from ..run_folder import differences
from .store import is_good


def origin(
    file: Path, assignments: tuple[str, ...], out: Path, decides: Mapping[str, Any]
) -> dict[str, Any]:
    """The origin of a run that begins now, in the folder `out`, of the case in `file`."""
    now = datetime.datetime.now().astimezone()
    return {
        "run": out.name,
        "began": now.isoformat(timespec="seconds"),
        "began_utc": now.astimezone(datetime.UTC).isoformat(timespec="milliseconds"),
        "case": f"{file.parent.resolve().name}/{file.name}",
        "sha256": checksum(file.read_bytes()),
        "assignments": list(assignments),
        "machine": f"{platform.platform()}, {os.cpu_count()} processors",
        "previous": _previous(file.parent, out, decides),
    }


def _previous(home: Path, out: Path, decides: Mapping[str, Any]) -> dict[str, Any] | None:
    """The run to which `run` points, and the settings that differ from it; None if there is no such
    run."""
    folder = target(home / LATEST)
    if folder is None or folder == out or not is_good(folder):
        return None
    try:
        old = run_folder.read(folder)["decides"]
    except CaseError:
        return None
    cases = (entries_of(RunSettings, item).case for item in (old, decides))
    if len({case.get("kind") for case in cases}) > 1:
        return None
    result = RunResult.read(folder)
    new = run_folder.plain_json(decides)
    old, new = run_folder.decisive_settings(old), run_folder.decisive_settings(new)
    changes = differences(old, new)
    return {
        "run": folder.name,
        "value": result.value,
        "standard_error": result.standard_error,
        "changes": [change._asdict() for change in changes],
    }


def add_difference(record: Mapping[str, Any], out: Path) -> None:
    """Adds the difference between the values of a run and the previous run to its record."""
    from ..compare import difference

    previous = entries_of(RunRecord, record).origin.previous
    if previous is None:
        return
    previous |= {"difference": None, "difference_error": None, "paired": False}
    try:
        value, error, paired = difference(out.parent / previous["run"], out)
    except (CaseError, OSError):  # the one before it was removed since
        return
    previous |= {"difference": value, "difference_error": error, "paired": paired}
