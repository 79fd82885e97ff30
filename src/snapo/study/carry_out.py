"""Runs a study into a folder, part by part so that it can be resumed, and writes its report."""

import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.case.report import logo
from snapo.problem.code.version import reading_once
from snapo.report.checksums import changed_files, checksum, stamps, written_since
from snapo.report.evidence import seeds, with_verdicts
from snapo.report.folder import RunResult, lookup
from snapo.report.page import Page, Text, render
from snapo.report.provenance import date, provenance
from snapo.report.record import PageTexts, RunRecord, entries_of
from snapo.solver.bound import Penalty
from snapo.solver.learning.progress import INTERRUPTED, Interrupted
from snapo.solver.solution import POLICY, SOLUTION
from snapo.solver.tables import write_text

from . import run_folder
from .chapters.bound import BOUND, measure
from .domain import GOOD, Domain
from .run_folder import REPORT
from .runs.origin import add_difference
from .runs.store import home_of, point_to
from .study import Part, ProgressCallback, Study, StudyRun
from .training import TRAINING, no_policy


def write_report(domain: Domain, folder: Path) -> Path:
    """Writes `report.html` into a run folder and returns its path."""
    write_text(folder / REPORT, page_of(domain, folder))
    return folder / REPORT


def page_of(domain: Domain, folder: Path) -> str:
    """The report of a run folder as HTML. If a file or a key is missing, the section says so. The
    same files give the same page, byte for byte.
    """
    summary = domain.report()
    run = summary.folder.read(folder)
    record = entries_of(RunRecord, run_folder.read_table(folder / run_folder.RUN))
    texts = entries_of(PageTexts, lookup(record.decides, "case.report"))
    sections = [section(run) for section in summary.sections]
    menu = summary.links(sections)
    sections[0] = with_verdicts(sections[0], run)
    if run.get("by_seed"):
        sections.insert(1, seeds(run))
        menu.insert(0, (sections[1].name, sections[1].short))
    sections.append(provenance(run, record, folder))
    menu += [(x.name, x.short) for x in sections[-1:] if x.blocks]
    if note := texts.note:
        sections[0] = replace(sections[0], blocks=[Text(note), *sections[0].blocks])
    made = ("Author", texts.author), ("Date", date(record.origin))
    page = Page(
        title=str(texts.title or run.get("title") or summary.title),
        about=[(name, value) for name, value in (*summary.about(run), *made) if value],
        sections=sections,
        menu=menu,
        footer=_footer(run.get("versions.snapo")),
        logo=_logo(folder, texts.logo),
    )
    return render(page)


def _logo(folder: Path, name: str | None) -> str:
    """The picture that the case names, from the copy of the case; "" if the picture is gone."""
    try:
        return logo(folder / run_folder.CASE, name) if name else ""
    except (OSError, ValueError):
        return ""


def _footer(version: str | None) -> str:
    available = version and version[:1].isdigit()  # else a text: it is not installed
    made = f"Made by snapo {version}" if available else "Made by snapo"
    return f"{made} from the files of one run folder; the page uses no network."


NOT_OF_A_PART = (run_folder.RUN, run_folder.RESULT, run_folder.REPORT, run_folder.CHECKPOINT)
# A report is written before the end where the work since took so many times its own time, and no
# less than so many seconds: one costs a second or two, and an interrupted run writes its own.
OFTEN, MINIMUM = 30.0, 60.0
DONE, FAILED, SKIPPED = "done", "failed", "skipped"


@reading_once()
def carry_out(
    domain: Domain,
    study: Study,
    out: Path,
    decides: Mapping[str, Any],
    resume: bool,
    progress: ProgressCallback,
    preparing: float = 0.0,
    adjacent: Mapping[str, float] | None = None,
    origin: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Computes the parts of a study one after another; returns the content of result.json.
    `preparing`: the time, in seconds, of reading the case and making the study; `adjacent`: the
    time of other work for this run, in seconds, by name; `origin`: the origin of a new run, for its
    report. A part that fails gets a note and a status; parts that need it are skipped. On Ctrl-C
    the completed parts and the best policy so far are reported, and `Interrupted`, a
    `KeyboardInterrupt`, has the content of result.json.
    """
    record = run_folder.start(out, study.kind, decides, resume)
    run = StudyRun(study, out, progress, resume, mark=run_folder.mark(record["decides"]))
    record["about"] = run_folder.plain_json(study.about)
    run.results |= json.loads(json.dumps(record["about"]))
    _spend(record, "preparing", preparing)
    record["beside"] |= adjacent or {}
    if origin is not None and lookup(record, "provenance.run") != origin["run"]:
        record["provenance"] = run_folder.plain_json(origin)
    _guarded(run, lambda: point_to(out))
    writer = _Writer(domain, run, record)
    try:
        for part in study.parts:
            _do(part, run, record)
            writer.part_done()
    except KeyboardInterrupt:
        raise Interrupted(_finish(writer)) from None
    return _finish(writer)


def _finish(writer: "_Writer") -> dict[str, Any]:
    """Writes a run that has ended, and reports where `run` points if it does not point to
    this run."""
    _keep(writer.run, writer.record)
    add_difference(writer.record, writer.run.folder)
    result, run = writer.write(), writer.run

    def point() -> None:
        if home_of(run.folder) is not None and not point_to(run.folder):
            run.progress(
                "`run` still points to an earlier run, because of the status of this run: "
                f"{result['status']}"
            )

    _guarded(run, point)
    return result


def certify(
    domain: Domain,
    study: Study,
    out: Path,
    progress: ProgressCallback,
    paths: int,
    penalty: Penalty,
) -> dict[str, Any]:
    """Computes the bounds of a finished run and saves them in it; returns the new content of its
    result.json.

    **Raises:** `CaseError` if the study has no bound, or the run has no policy.
    """
    if isinstance(study.relaxation, str):
        raise CaseError(str(out), "", None, f"this run cannot be certified: {study.relaxation}")
    record = run_folder.read(out)
    states = entries_of(RunRecord, record)
    if states.part(TRAINING.name).state != DONE:
        raise no_policy(out, record)
    run_folder.check_whole(out, record, (POLICY, SOLUTION))
    run = StudyRun(study, out, progress, True, mark=run_folder.mark(record["decides"]))
    run.results |= record["about"]
    for part in study.parts:
        if part.name != BOUND.name and not changed_files(out, states.part(part.name).files):
            run.results |= run_folder.read_part(out, part) or {}
    record["parts"].pop(BOUND.name, None)
    _do(replace(BOUND, measure=lambda run: measure(run, paths, penalty)).part, run, record)
    return _Writer(domain, run, record).write()


def _do(part: Part, run: StudyRun, record: dict[str, Any]) -> None:
    """Computes and saves one part; if the part was done before, it is read from its file."""
    states = record["parts"]
    typed = entries_of(RunRecord, record)
    if typed.part(part.name).state == DONE:
        changed = changed_files(run.folder, typed.part(part.name).files)
        tables = None if changed else run_folder.read_part(run.folder, part)
        if tables is not None:
            run.results |= tables
            return
        message = changed[0] if changed else f"parts/{part.file}"
        run.progress(
            f"{part.name} is computed again: {message} was changed or damaged since it was written"
        )
    missing = [name for name in part.needs if typed.part(name).state != DONE]
    if missing:
        note = f"it needs {', '.join(missing)}"
        states[part.name] = {"state": SKIPPED, "note": note, "seconds": 0.0}
        return
    run.progress(part.name)
    started = time.perf_counter()
    state: dict[str, Any] = {"state": DONE, "note": ""}
    before = stamps(run.folder)
    try:
        try:
            tables = part.work(run)
        except Interrupted as stop:
            if not isinstance(stop.result, Mapping):
                raise
            tables, state["state"] = stop.result, INTERRUPTED
        if twice := set(tables) & set(run.results):
            raise ValueError(f"another part has already written {sorted(twice)}")
        run.results |= run_folder.write_part(run.folder, part, tables)
        state["files"] = written_since(run.folder, before, NOT_OF_A_PART)
        for other in states.values():  # a file is that of the part that wrote it last
            for name in state["files"]:
                other.get("files", {}).pop(name, None)
    except CaseError:
        raise
    except Exception as error:
        state = {"state": FAILED, "note": _words(error)}
        run.progress(f"{part.name} failed: {state['note']}")
    states[part.name] = state | {"seconds": time.perf_counter() - started}
    _guarded(run, lambda: run_folder.save(run.folder, record))
    if state["state"] == INTERRUPTED:
        raise KeyboardInterrupt


def _words(error: Exception) -> str:
    """An exception as one line; a disk error names its file."""
    if isinstance(error, OSError) and error.strerror:
        return f"could not write {error.filename or ''}: {error.strerror}"
    text = (str(error).strip().splitlines() or [""])[0]
    return f"{type(error).__name__}: {text}"[:300]


def _guarded(run: StudyRun, write) -> None:
    """Writes a file; a disk error is noted in the status, and the run continues."""
    try:
        write()
    except OSError as error:
        run.troubles.append(f"{error.filename or run.folder}: {error.strerror}")
        run.progress(f"could not write: {run.troubles[-1]}")


class _Writer:
    """Writes result and report after the parts, but not so often that writing takes too much
    time."""

    def __init__(self, domain: Domain, run: StudyRun, record: dict[str, Any]):
        self.domain, self.run, self.record = domain, run, record
        self.last = time.perf_counter()
        self.took = 0.0

    def part_done(self) -> None:
        """Writes if the last writing is long enough ago."""
        if time.perf_counter() - self.last > max(OFTEN * self.took, MINIMUM):
            self.write()

    def write(self) -> dict[str, Any]:
        """Writes the result and the report of the run so far."""
        started, run = time.perf_counter(), self.run
        _keep(run, self.record)
        _guarded(run, lambda: write_report(self.domain, run.folder))
        self.last = time.perf_counter()
        self.took = self.last - started
        # The time of writing belongs to the total, and is known only now.
        _spend(self.record, "report", self.took)
        result = _keep(run, self.record)
        if run.troubles:
            result["status"] = "not written"
        return result


def _spend(record: dict[str, Any], name: str, seconds: float) -> None:
    """Adds to the time that a run took outside of its parts, in this and in earlier sessions."""
    adjacent = record.setdefault("beside", {})
    adjacent[name] = adjacent.get(name, 0.0) + seconds


def _keep(run: StudyRun, record: dict[str, Any]) -> dict[str, Any]:
    """Writes the result, and before it the record with the result's checksum."""
    result = outcome(run, record)
    text = json.dumps(run_folder.plain_json(result), indent=1)
    record["result"] = checksum(text.encode())
    _guarded(run, lambda: run_folder.save(run.folder, record))
    _guarded(run, lambda: write_text(run.folder / run_folder.RESULT, text))
    return result


def outcome(run: StudyRun, record: Mapping[str, Any]) -> dict[str, Any]:
    """The content of result.json: the study's result, and the state of its parts. The last entries
    of "notes" are about the case and were written before the run. "seconds" has the time of every
    part and of preparing the case, with their sum as "total". It also has the time of writing
    reports, which the page cannot contain, and the times of the stages of training, which are
    included in the time of training.
    """
    states = record["parts"]
    result = {"kind": run.study.kind, **run.study.result(run)}
    head = RunResult.of(result)
    typed = entries_of(RunRecord, record)
    if notes := [*head.notes, *typed.about.get("notes", ())]:
        result["notes"] = list(dict.fromkeys(notes))
    seconds = {name: state["seconds"] for name, state in states.items()}
    seconds = {**typed.beside, **seconds}
    total = sum(seconds.values()) - seconds.get("report", 0.0)
    result["seconds"] = {**head.seconds, **seconds, "total": total}
    available = (DONE, INTERRUPTED)
    failed = {
        name: state["note"] for name, state in states.items() if state["state"] not in available
    }
    broken = [name for name in failed if states[name]["state"] == FAILED]
    todo = [part.name for part in run.study.parts if part.name not in states]
    status = head.status or "ok"
    if failed:
        # Parts are skipped because of a failed one, of which the study may know more.
        why = "" if status in GOOD else f": {status}"
        status = f"{', '.join(broken or failed)} failed{why}"
    elif todo and status != INTERRUPTED:
        status = f"stopped before {todo[0]}"
    return result | {"status": status, "failures": failed, "run": str(run.folder)}
