"""A study carried out into a folder: part by part, whatever fails, and again from where it was."""

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.solver.bound import Penalty
from snapo.solver.files import write_text

from . import run_folder
from .domain import GOOD, Domain
from .parts.bound import BOUND, bounded
from .report import write_report
from .study import Part, Study, StudyRun, Tell
from .training import TRAINING

# A report is written again when the work since took so many times its own time, or that of any.
OFTEN, SHORT = 10.0, 0.3
DONE, FAILED, SKIPPED = "done", "failed", "skipped"


def carry_out(
    domain: Domain, study: Study, out: Path, decides: Mapping[str, Any], resume: bool, tell: Tell
) -> dict[str, Any]:
    """Does the parts of a study one after another, and returns what result.json says.

    A part that fails leaves a note and a status; parts that need it are skipped. On Ctrl-C the
    parts that are done are reported, and the interrupt goes on to the caller.
    """
    record = run_folder.start(out, study.kind, decides, resume)
    run = StudyRun(study, out, tell, resume)
    record["about"] = run_folder.plain_json(study.about)
    run.found |= json.loads(json.dumps(record["about"]))
    writer = _Writer(domain, run, record)
    try:
        for part in study.parts:
            _do(part, run, record)
            writer.part_done()
    except KeyboardInterrupt:
        writer.write()
        raise
    return writer.write()


def certify(
    domain: Domain, study: Study, out: Path, tell: Tell, paths: int, penalty: Penalty
) -> dict[str, Any]:
    """The bounds of a run that was carried out, kept with it: what its result.json says now.

    **Raises:** `CaseError` where the study has no bound, or the run no policy.
    """
    if isinstance(study.relaxation, str):
        raise CaseError(str(out), "", None, f"this run cannot be certified: {study.relaxation}")
    record = run_folder.read(out)
    if record["parts"].get(TRAINING.name, {}).get("state") != DONE:
        what = "this run has no trained policy: solve its case again, or go on with --resume"
        raise CaseError(str(out), "", None, what)
    run = StudyRun(study, out, tell, True)
    run.found |= record["about"]
    for part in study.parts:
        if part.name != BOUND.name:
            run.found |= run_folder.read_part(out, part) or {}
    record["parts"].pop(BOUND.name, None)
    _do(BOUND._replace(work=lambda run: bounded(run, paths, penalty)), run, record)
    return _Writer(domain, run, record).write()


def _do(part: Part, run: StudyRun, record: dict[str, Any]) -> None:
    """One part: read from its file when it was done before, else worked out and kept."""
    states = record["parts"]
    if states.get(part.name, {}).get("state") == DONE:
        tables = run_folder.read_part(run.folder, part)
        if tables is not None:
            run.found |= tables
            return
    lacking = [name for name in part.needs if states.get(name, {}).get("state") != DONE]
    if lacking:
        note = f"it needs {', '.join(lacking)}"
        states[part.name] = {"state": SKIPPED, "note": note, "seconds": 0.0}
        return
    run.tell(part.name)
    started = time.perf_counter()
    state: dict[str, Any] = {"state": DONE, "note": ""}
    try:
        tables = part.work(run)
        if twice := set(tables) & set(run.found):
            raise ValueError(f"another part gives {sorted(twice)} already")
        run.found |= run_folder.write_part(run.folder, part, tables)
    except CaseError:
        raise
    except Exception as error:
        state = {"state": FAILED, "note": _words(error)}
        run.tell(f"{part.name} failed: {state['note']}")
    states[part.name] = state | {"seconds": time.perf_counter() - started}
    _guarded(run, lambda: run_folder.save(run.folder, record))


def _words(error: Exception) -> str:
    """An exception in one line; a disk's with its file."""
    if isinstance(error, OSError) and error.strerror:
        return f"could not write: {error.filename or ''}: {error.strerror}"
    text = (str(error).strip().splitlines() or [""])[0]
    return f"{type(error).__name__}: {text}"[:300]


def _guarded(run: StudyRun, write) -> None:
    """Writes; a disk that refuses is a status, not a lost run."""
    try:
        write()
    except OSError as error:
        run.troubles.append(f"{error.filename or run.folder}: {error.strerror}")
        run.tell(f"could not write: {run.troubles[-1]}")


class _Writer:
    """Writes result and report after the parts, but not so often that writing takes the time."""

    def __init__(self, domain: Domain, run: StudyRun, record: dict[str, Any]):
        self.domain, self.run, self.record = domain, run, record
        self.began = self.last = time.perf_counter()
        self.took = 0.0

    def part_done(self) -> None:
        """Writes where the last time is long enough ago."""
        if time.perf_counter() - self.last > OFTEN * max(self.took, SHORT):
            self.write()

    def write(self) -> dict[str, Any]:
        """Result and report of the run so far."""
        started, run = time.perf_counter(), self.run
        result = outcome(run, self.record)
        text = json.dumps(run_folder.plain_json(result), indent=1)
        _guarded(run, lambda: write_text(run.folder / run_folder.RESULT, text))
        _guarded(run, lambda: write_report(self.domain, run.folder))
        self.last = time.perf_counter()
        self.took = self.last - started
        if run.troubles:
            result["status"] = "not written"
        return result


def outcome(run: StudyRun, record: Mapping[str, Any]) -> dict[str, Any]:
    """What result.json says: the study's own words, and the state of its parts."""
    states = record["parts"]
    result = {"kind": run.study.kind, **run.study.result(run)}
    seconds = {name: state["seconds"] for name, state in states.items()}
    result["seconds"] = {
        **result.get("seconds", {}), **seconds, "total": sum(seconds.values())
    }  # fmt: skip
    failed = {name: state["note"] for name, state in states.items() if state["state"] != DONE}
    broken = [name for name in failed if states[name]["state"] == FAILED]
    todo = [part.name for part in run.study.parts if part.name not in states]
    status = result.get("status", "ok")
    if failed:
        # What was skipped follows from what failed, of which the study may know more.
        why = "" if status in GOOD else f": {status}"
        status = f"{', '.join(broken or failed)} failed{why}"
    elif todo:
        status = f"stopped before {todo[0]}"
    return result | {"status": status, "failures": failed, "run": str(run.folder)}
