"""A pharma case from the file to the run folder: what `snapo solve` does."""

import hashlib
import json
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from snapo.solver.files import write_csv, write_text
from snapo.solver.solution import RESULT
from snapo.solver.versions import versions
from snapo.study.run_folder import check_folder, copy_case, plain_json

from .control.closed_loop import train
from .flowsheet.case import PharmaCase
from .flowsheet.inputs import pharma_inputs
from .flowsheet.process import Process
from .quality.capability import Capability, capability
from .quality.sampling import sampler
from .report import write_report
from .results import batch, derivatives, quality
from .results.statement import statement

DETAILS, PROFILE, SPACE = "details.json", "profile.csv", "design_space.csv"
SLOPES = "attribute_sensitivities.csv"  # of the attributes; a policy has a table of its own

Tell = Callable[[str], None]


def check(case: PharmaCase) -> list[str]:
    """What the case says, in a few lines: nothing is integrated."""
    inputs = pharma_inputs(case)
    numbers = sum(entry.value.size for entry in inputs.values())
    lines = [
        f"{case.title}: {' -> '.join(unit.name for unit in case.units)}",
        f"{len(case.network.reactions)} reactions among {len(case.network.species)} species, "
        "each conserves mass",
        f"{len(inputs)} inputs with {numbers} numbers, each with a sensitivity",
        f"{len(case.parameters)} process parameters, {len(case.attributes)} quality attributes",
        f"time by the {case.numerics.method} method",
    ]
    if case.optimise is not None:
        lines.append(f"{len(case.optimise.decisions)} numbers are chosen for the best recipe")
    if case.control is not None:
        lines.append(f"a policy decides {', '.join(m.input for m in case.control.manipulated)}")
    return lines


def solve(
    case: PharmaCase,
    *,
    out: Path,
    seed: int,
    engine: str = "auto",
    reference: bool = False,
    resume: bool = False,
    progress: Tell = print,
) -> dict[str, Any]:
    """Solves a case into the folder `out` and returns what `result.json` says.

    Every part that fails leaves a note and a status; what was found before it stays.
    """
    out = Path(out)
    check_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    copy_case(case.file, out)
    started = time.perf_counter()
    process = Process(case)
    work = Parts(progress)
    found: dict[str, Any] = {"title": case.title, **statement(case), "seed": seed}
    found |= {"versions": _versions(), "hashes": _hashes(out / "case"), "notes": list(case.notes)}
    capable = _open_loop(process, work, found, seed)
    loop = None
    if case.control is not None:
        loop = work(
            "closed loop", lambda: train(case, process, out, seed, engine, resume, progress)
        )
        found["closed_loop"] = loop
    status = _status(found, work, loop)
    total = time.perf_counter() - started
    found |= {"seconds": {**work.seconds, "total": total}, "failures": work.failures}
    found["notes"] += [f"{part} failed: {what}" for part, what in work.failures.items()]
    result = _result(case, capable, loop, seed, status, found["seconds"], out)
    return _write(out, result, found, process, work, progress)


def report(folder: Path) -> Path:
    """Writes `report.html` afresh from the files of a run folder."""
    return write_report(Path(folder))


class Parts:
    """Runs the parts of a study one after another; what fails is a note, not a lost run."""

    def __init__(self, tell: Tell):
        self.tell = tell
        self.failures: dict[str, str] = {}
        self.seconds: dict[str, float] = {}

    def __call__(self, name: str, make: Callable[[], Any]) -> Any:
        """The part's result, or None."""
        self.tell(name)
        started = time.perf_counter()
        try:
            return make()
        except Exception as error:
            text = (str(error).strip().splitlines() or [type(error).__name__])[0]
            self.failures[name] = f"{type(error).__name__}: {text}"[:300]
            self.tell(f"{name} failed: {text}")
            return None
        finally:
            self.seconds[name] = time.perf_counter() - started


def _open_loop(process: Process, work: Parts, found: dict, seed: int) -> Capability | None:
    """The parts of the recipe as it stands; `found` gains their tables."""
    case = process.case
    run = work("one batch", process.run)
    found["run"] = batch.one_batch(case, run)
    if run is None or run.status != "ok":
        return None
    found["balances"] = work("balances", lambda: batch.balance_rows(process))
    if case.numerics.refine:
        found["convergence"] = work("convergence", lambda: derivatives.convergence_rows(process))
    found["matrix"] = work("sensitivity matrix", lambda: derivatives.matrix_tables(process))
    found["certificate"] = work("certificate", lambda: derivatives.certificate_rows(process, seed))
    found["attribution"] = work(
        "attribution", lambda: derivatives.attribution_rows(process, found["matrix"])
    )
    found["profiles"] = work("profile sensitivities", lambda: derivatives.profile_gradients(case))
    if case.pairs:
        found["second"] = work("second derivatives", lambda: derivatives.second_rows(process))
    coarse = work("mesh of the statistics", lambda: sampler(process))
    sampled, found["sampling"] = coarse or (process, None)
    if sampled is not process:
        found["notes"].append(
            f"Statistics of many batches use {sampled.case.numerics.steps} steps per piece, which "
            f"moves no attribute by more than {coarse[1]['gap']:.1g} of its margin."
        )
    capable = work("capability", lambda: capability(sampled, quality.batch_count(case), seed + 1))
    found["capability"] = quality.capability_rows(case, capable)
    found["spread"] = work("spread", lambda: quality.spread_rows(case, found["matrix"]))
    if case.optimise is not None:
        found["optimise"] = work("best recipe", lambda: quality.best_recipe(process, sampled, seed))
    if case.design_space is not None:
        found["design_space"] = work("design space", lambda: quality.map_tables(sampled, seed))
        found["ranges"] = work("proven ranges", lambda: quality.range_rows(sampled, seed))
    if case.estimation is not None:
        found["estimation"] = work("estimation", lambda: quality.estimation_rows(process))
    return capable


def _status(found: dict, work: Parts, loop: dict | None) -> str:
    run = found.get("run") or {}
    if run.get("status") != "ok":
        return str(run.get("status") or "no batch was computed")
    if work.failures:
        return f"{', '.join(work.failures)} failed"
    if found.get("optimise") and not found["optimise"]["converged"]:
        return "the best recipe did not converge"
    return str(loop["status"]) if loop else "ok"


def _result(
    case: PharmaCase,
    capable: Capability | None,
    loop: dict | None,
    seed: int,
    status: str,
    seconds: dict[str, float],
    out: Path,
) -> dict[str, Any]:
    """The value is the probability of all limits: of the policy, or of the recipe as it stands."""
    recipe = None if capable is None else 1 - capable.joint
    value, error = recipe, None if capable is None else capable.joint_error
    references: dict[str, float | None] = {}
    if loop is not None:
        references = {"recipe_as_given": recipe, "best_fixed_recipe": loop["baseline"]}
        value, error = loop["value"], loop["standard_error"]
        if case.goal.kind != "probability":
            references |= {"goal": loop["objective"], "goal_of_recipe": loop["baseline_objective"]}
    batches = 0 if capable is None else capable.batches
    return {
        "kind": case.kind,
        "value": value,
        "standard_error": error,
        "meaning": "probability that a batch keeps all limits",
        "references": references,
        "seconds": seconds,
        "engine": loop["engine"] if loop else "none: no policy is trained",
        "paths": loop["paths"] if loop else {"evaluate": batches},
        "seed": seed,
        "status": status,
        "run": str(out),
    }


def _write(out: Path, result, found, process: Process, work: Parts, progress: Tell):
    """The run folder's files; what cannot be written becomes a status."""
    try:
        write_text(out / RESULT, json.dumps(plain_json(result), indent=1))
        write_text(out / DETAILS, json.dumps(plain_json(found)))
        if (found.get("run") or {}).get("status") == "ok":
            header = ("attribute", "input", "label", "value", "unit")
            rows = work("all sensitivities", lambda: list(derivatives.every_sensitivity(process)))
            write_csv(out / SLOPES, header, rows or [])
            header = ("unit", "time_s", "state", "value", "state_unit")
            write_csv(out / PROFILE, header, batch.profile_rows(process.case, found["run"]))
        if found.get("design_space"):
            write_csv(out / SPACE, *quality.space_rows(found["design_space"]))
        write_report(out)
    except OSError as error:
        progress(f"could not write: {error.filename or out}: {error.strerror}")
        result["status"] = "not written"
    return result


def _versions() -> dict[str, str]:
    found = versions()
    for name in ("diffrax", "pint", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of the case."""
    return {
        file.name: hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.iterdir())
        if file.is_file()
    }
