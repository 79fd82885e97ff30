"""Lists the runs of a case, with the differences from one run to the next, and removes runs."""

import secrets
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from snapo.case.error import CaseError, Unquoted, nearest
from snapo.problem.carry.latest import LATEST, target
from snapo.report.folder import RunResult
from snapo.report.record import LibraryVersions, RunRecord, entries_of
from snapo.solver.statistics import critical

from .. import run_folder
from ..run_folder import Difference, differences
from .store import adopt, case_folder, folders, is_busy, is_good, only_one, set_link

SHOWN = 3  # differences of a run that a person sees; all of them are in the table
RUNNING, STOPPED = "running", "stopped; snapo solve --resume continues the run"


class RunRow(NamedTuple):
    """One run of a case.

    - `run`: its name; `folder`: its folder; `latest`: whether the link `run` points to it; `began`:
      date and time.
    - `value`, `low`, `high`: the value and its 95 % interval, None if there is none.
    - `status`: the status in result.json, or "running", or the reason why there is no status.
    - `changes`: the settings that differ from the previous run.
    """

    run: str
    folder: str
    latest: bool
    began: str
    value: float | None
    low: float | None
    high: float | None
    seconds: float | None
    status: str
    version: str
    changes: tuple[Difference, ...]

    def table(self) -> dict[str, Any]:
        """The row as plain data."""
        return self._asdict() | {"changes": [change._asdict() for change in self.changes]}


def listed(path: Path) -> list[RunRow]:
    """The runs of the case that `path` names, with the oldest first.

    **Raises:** `CaseError` if there is no such folder.
    """
    home = _home(path)
    latest, rows = target(home / LATEST), []
    before: Mapping[str, Any] | None = None
    for folder in folders(home):
        plain = folder == home / LATEST
        row, decides = _row(folder, before, plain or folder == latest)
        rows.append(row)
        before = before if decides is None else decides
    return rows


def _home(path: Path) -> Path:
    home = case_folder(path)
    if not home.is_dir():
        raise CaseError(str(path), "", None, "there is no such case; name its folder or its file")
    return home


def _row(
    folder: Path, before: Mapping[str, Any] | None, latest: bool
) -> tuple[RunRow, Mapping[str, Any] | None]:
    """The row of a run, and the settings that decide it; None if they cannot be read."""
    result = RunResult.read(folder)
    status = RUNNING if is_busy(folder) else result.status or STOPPED
    try:
        record = entries_of(RunRecord, run_folder.read(folder))
    except CaseError as error:
        status, record = error.allowed, RunRecord()
    decides = run_folder.decisive_settings(record.decides) if record.decides else None
    known = before is not None and decides is not None
    changes = tuple(differences(before, decides)) if known else ()
    low, high = _interval(result)
    row = RunRow(
        folder.name,
        str(folder),
        latest,
        record.origin.began,
        result.value,
        low,
        high,
        result.seconds.get("total"),
        status,
        entries_of(LibraryVersions, record.settings.versions).snapo,
        changes,
    )
    return row, decides


def _interval(result: RunResult) -> tuple[float | None, float | None]:
    if result.value is None or result.standard_error is None:
        return None, None
    half = critical() * result.standard_error
    return result.value - half, result.value + half


def described(rows: Sequence[RunRow]) -> Iterator[str]:
    """The list as text, with one or more lines for each run."""
    if not rows:
        yield "no runs yet; `snapo solve` computes one"
        return
    yield f"{'run':<24}{'value':>16}{'± (95 %)':>12}{'seconds':>10}  status"
    for row in rows:
        half = None if row.high is None or row.value is None else row.high - row.value
        cells = (
            f"{_cell(row.value, '.6g'):>16}{_cell(half, '.2g'):>12}{_cell(row.seconds, '.1f'):>10}"
        )
        yield f"{row.run + ' *' * row.latest:<24}{cells}  {row.status}"
        for text in _changes(row.changes):
            yield f"    {text}"
    yield (
        f"* * `{LATEST}` points to this run; below each run are the settings that differ from "
        "the previous one"
    )


def _cell(number: float | None, form: str) -> str:
    return "" if number is None else format(number, f",{form}")


def _changes(changes: Sequence[Difference]) -> Iterator[str]:
    yield from (change.describe() for change in changes[:SHOWN])
    if len(changes) > SHOWN:
        yield f"and {len(changes) - SHOWN} more, in --json"


def removed(path: Path, names: Sequence[str] = (), keep: int | None = None) -> list[str]:
    """Removes the runs with these names, or all but the last `keep` runs; returns their names. The
    last four letters of a name are sufficient. With `keep`, runs in progress and the run to which
    the link `run` points are never removed. If the latest run is removed, `run` points to the
    previous run.

    **Raises:** `CaseError` if there is no such run, or if it is in progress; then nothing is
    removed.
    """
    home = _home(path)
    adopt(home)
    with only_one(home):
        available = {folder.name: folder for folder in folders(home)}
        selected = [_named(name, available) for name in names]
        if keep is not None:
            latest = target(home / LATEST)
            older = list(available.values())[: max(0, len(available) - keep)]
            selected += [item for item in older if item != latest and not is_busy(item)]
        selected = list(dict.fromkeys(selected))
        if busy := next((folder for folder in selected if is_busy(folder)), None):
            message = "a process is working on this run; stop it first"
            raise CaseError(str(busy), "", None, message)
        _point_elsewhere(home, [item for item in available.values() if item not in selected])
        for folder in selected:
            _remove(folder)
    return [folder.name for folder in selected]


def _named(name: str, available: Mapping[str, Path]) -> Path:
    text = Path(name).name  # a path is as good as a name
    matches = [folder for full, folder in available.items() if text in (full, full[-4:])]
    if len(matches) != 1:
        message = nearest(text, available, "run") if available else "this case has no runs"
        if matches:
            message = (
                f"the names of several runs end with this text: "
                f"{', '.join(item.name for item in matches)}"
            )
        raise CaseError("--remove", "", Unquoted(name), message)
    return matches[0]


def _point_elsewhere(home: Path, left: Sequence[Path]) -> None:
    """Makes `run` point to one of the remaining runs; removes it if there are none."""
    if target(home / LATEST) in left:
        return
    best = [folder for folder in left if is_good(folder)] or left
    if best:
        set_link(home, best[-1])
    elif target(home / LATEST) is not None:
        (home / LATEST).unlink()


def _remove(folder: Path) -> None:
    """Removes a run in such a way that a partly removed run is no longer in the list."""
    moved = folder.with_name(f".removed-{secrets.token_hex(4)}")
    folder.rename(moved)
    shutil.rmtree(moved)
