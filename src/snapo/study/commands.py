"""The functions of all commands, which are common to all domains; the command line only prints
their results."""

import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snapo.case.error import CaseError

from .domain import CaseRequest, Domain, RunsCode, find, installed, load, remarks

if TYPE_CHECKING:
    from snapo.engine import Workers
    from snapo.solver.bound import Penalty

    from .study import ProgressCallback


def kinds() -> list[tuple[str, str, tuple[str, ...]]]:
    """(kind, description, sizes) of every domain that is installed and can be loaded."""
    rows = []
    for kind in installed():
        try:
            domain = find(kind, "KIND", "")
        except CaseError as error:
            rows.append((kind, error.allowed, ()))
        else:
            rows.append((kind, domain.description, tuple(domain.templates)))
    return rows


def new_workbook(kind: str, folder: Path, size: str | None = None) -> list[Path]:
    """Writes the example of a kind as a workbook, case.xlsx, and the files that no sheet can hold.

    **Raises:** `CaseError` as `new` does, and if openpyxl is missing.
    """
    from tempfile import TemporaryDirectory

    from snapo.case.load import load as load_tables
    from snapo.case.workbook import write_workbook

    with TemporaryDirectory() as made:
        written = new(kind, Path(made), size)
        others = [item for item in written if item.suffix != ".csv" and item.name != "case.toml"]
        targets = [folder / "case.xlsx", *(folder / entry.name for entry in others)]
        for target in targets:
            if target.exists():
                raise CaseError(str(target), "", None, "this file exists; nothing was written")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_workbook(Path(made), load_tables(Path(made))[1], targets[0])
            for other in others:
                (folder / other.name).write_bytes(other.read_bytes())
        except OSError as error:
            message = f"the folder cannot be written ({error.strerror})"
            raise CaseError(str(folder), "", None, message) from None
    return targets


def new(kind: str, folder: Path, size: str | None = None) -> list[Path]:
    """Writes the commented example of a kind into `folder`; returns the files written.

    **Raises:** `CaseError` if there is no such kind or size, the folder cannot be used, or it
    already has a file of the same name; then nothing is written.
    """
    templates = find(kind, "KIND", "").templates
    sizes = list(templates)
    if size is not None and size not in templates:
        one = "this kind has one example only"
        message = one if len(sizes) == 1 else f"it must be one of {', '.join(sizes)}"
        raise CaseError("--size", "", size, message)
    source = templates[size or sizes[0]]
    contents = {file.name: file.read_bytes() for file in source.iterdir() if file.is_file()}
    for name in contents:
        if (folder / name).exists():
            raise CaseError(str(folder / name), "", None, "this file exists; nothing was written")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            (folder / name).write_bytes(content)
    except OSError as error:
        message = f"the folder cannot be written ({error.strerror})"
        raise CaseError(str(folder), "", None, message) from None
    return sorted(folder / name for name in contents)


def next_command(kind: str, folder: Path) -> str:
    """The command to run after an example has been written."""
    domain = find(kind, "KIND", "")
    code = f" --simulator {domain.example}" if isinstance(domain, RunsCode) else ""
    return f"snapo check {folder}{code}"


def check(request: CaseRequest, progress: "ProgressCallback") -> list[str]:
    """A summary of the case in a few lines; nothing is trained."""
    loaded = load(request)
    remarks(loaded.case.notes, progress)
    return loaded.domain.check(loaded.case)


def solve(
    request: CaseRequest,
    progress: "ProgressCallback",
    *,
    out: Path | None = None,
    engine: str = "auto",
    reference: bool = False,
    resume: bool = False,
    policy: Path | None = None,
    seeds: int | Sequence[int] | None = None,
    workers: "Workers | None" = None,
    ladder: bool = False,
    hedge: bool = False,
    gamma: bool = False,
) -> dict[str, Any]:
    """Carries out the study of a case into the folder `out`, by default a new folder in `runs` next
    to the case; the link `run` points to the latest run.

    `policy`: a run folder, or the file of a policy, with which training begins. `seeds`: the number
    of consecutive seeds from the seed of the case on, or the seeds themselves; the run is that of
    the best seed. `workers`: compute groups of the paths of a large problem, with bit-identical
    results. `ladder`: also value the contract by all methods. `hedge`: simulate its hedges.
    `gamma`: measure the gamma by product. Returns the content of result.json. On Ctrl-C the
    completed parts are reported, and `KeyboardInterrupt` is passed on to the caller.

    **Raises:** `CaseError` if the case has a mistake, or the policy does not fit it.
    """
    from .prepare import Wanted, carried_out, is_same, made_ready
    from .runs.reserve import reserved

    requested = Wanted(
        engine, reference, resume, policy, workers=workers, ladder=ladder, hedge=hedge, gamma=gamma
    )
    began = time.perf_counter()
    if seeds is not None:
        from .seeds import solve_seeds

        return solve_seeds(request, progress, out, requested, seeds)
    loaded = load(request)
    remarks(loaded.case.notes, progress)
    same = partial(is_same, loaded, requested=requested) if resume else None
    with reserved(loaded.file.parent, out, same) as folder:
        ready = made_ready(loaded, folder, requested)
        remarks(ready.study.about["notes"], progress, ignored=loaded.case.notes)
        return carried_out(ready, resume, progress, began)


def certify(
    run: Path,
    progress: "ProgressCallback",
    *,
    paths: int | None = None,
    penalty: "Penalty" = "value",
    engine: str = "auto",
    simulator: tuple[str, str] | None = None,
) -> dict[str, Any]:
    """Bounds the value of a run from both sides; returns the new content of its result.json.

    **Raises:** `CaseError` if there is no such run, or if its value cannot be bounded, with the
    reason.
    """
    from . import run_folder
    from .prepare import case_of_run, options_of_run, use_every_core

    record = run_folder.read(run)
    domain = domain_of_run(run, record, simulator)
    file, data = case_of_run(run, record)
    progress(f"reading {file}")
    use_every_core()
    from .carry_out import certify as certified
    from .chapters.bound import PATHS

    case = domain.read(file, data)
    study = domain.study(case, options_of_run(domain, case, record, engine))
    return certified(domain, study, run, progress, paths or PATHS, penalty)


def domain_of_run(
    run: Path, record: Mapping[str, Any], simulator: tuple[str, str] | None = None
) -> Domain:
    """The domain of a run, with the simulator that the command line names again.

    **Raises:** `CaseError` if the run's simulator is the user's code, and `simulator` is None.
    """
    from snapo.report.record import RunRecord, entries_of

    from . import run_folder

    domain = find(record["kind"], str(run / run_folder.RUN))
    code = entries_of(RunRecord, record).settings.options.get("simulator")
    if simulator is None and code:
        message = f"the run's simulator is the user's code; name it again: --simulator {code}"
        raise CaseError(str(run), "", None, message)
    if simulator is not None and isinstance(domain, RunsCode):
        return domain.with_simulator(*simulator)
    return domain


def report(run: Path) -> Path:
    """Writes the report of a run again from the files in its folder; returns the path of the
    report."""
    from . import run_folder
    from .carry_out import write_report

    record = run_folder.read(run)
    domain = find(record["kind"], str(run / run_folder.RUN))
    try:
        return write_report(domain, run)
    except OSError as error:
        message = f"the report cannot be written ({error.strerror})"
        raise CaseError(str(run), "", None, message) from None


def printed(run: Path) -> Path:
    """Prints the report of a run to a PDF next to the report; returns the path of the PDF.

    **Raises:** `CaseError` if no browser on this machine can print the report.
    """
    from snapo.report.page import BROWSERS, VARIABLE, browser, print_page

    from . import run_folder

    result, file = browser(), run / run_folder.PDF
    if result is None:
        names = ", ".join(BROWSERS[:3])
        message = (
            f"no browser was found that can print the report ({names}); {VARIABLE} may name one"
        )
        raise CaseError("--pdf", "", None, message)
    try:
        print_page(run / run_folder.REPORT, file, result)
    except OSError as error:
        raise CaseError("--pdf", "", None, str(error)) from None
    return file


def tables(run: Path) -> Path:
    """Writes the tables of a run to a workbook next to its report; returns the path of the
    workbook.

    **Raises:** `CaseError` if openpyxl is missing, or the folder cannot be written.
    """
    from . import run_folder
    from .workbook import write_run

    run_folder.read(run)
    try:
        return write_run(run)
    except ModuleNotFoundError as error:
        raise CaseError("--xlsx", "", None, str(error)) from None
    except OSError as error:
        message = f"the workbook cannot be written ({error.strerror})"
        raise CaseError(str(run), "", None, message) from None


def bench(kind: str | None, engine: str, progress: "ProgressCallback") -> dict[str, str]:
    """{kind: table of times} for one kind, or for all kinds that can be timed.

    **Raises:** `CaseError` if nothing can be timed for the requested kind.
    """
    from .prepare import use_every_core

    requested: Sequence[str] = list(installed()) if kind is None else [kind]
    table = {}
    for item in requested:
        domain = find(item, "KIND", "")
        use_every_core()
        try:
            table[item] = domain.bench(engine, progress)
        except CaseError as error:
            if kind is not None:
                raise
            progress(f"{item}: {error.allowed}")
    return table
