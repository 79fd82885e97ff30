"""A gas-storage case from the file to the run folder: the work of `snapo solve`."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from snapo.problem.prepare import prepare
from snapo.solver.files import write_text
from snapo.solver.solution import RESULT, Solution
from snapo.study.run_folder import (
    DETAILS,
    Pages,
    Task,
    check_folder,
    copy_case,
    solve_into,
    write_run,
)

from .contract.expiry import value_without_decisions
from .contract.inputs import storage_inputs
from .contract.records import StorageCase
from .contract.simulator import StorageSimulator
from .problem import Problem, make_problem, new_policy
from .references.intrinsic import intrinsic
from .references.lattice import lattice
from .report import write_report
from .results.details import details
from .results.profile import rows


def check(case: StorageCase) -> list[str]:
    """The case in a few lines: nothing is trained."""
    if not case.days:
        value = value_without_decisions(case)
        return [f"{case.title}: no decision day is left; the value is {value:,.2f}"]
    simulator = StorageSimulator(case)  # pyright: ignore[reportCallIssue]
    inputs = storage_inputs(case)
    schedule = prepare(simulator, inputs)
    plan = intrinsic(schedule, case.contract.ratchets.interpolation)
    numbers = sum(entry.value.size for entry in inputs.values())
    return [
        f"{case.title}: {len(case.days)} decision days, {case.days[0]} to {case.days[-1]}",
        f"{len(inputs)} inputs with {numbers} numbers, each with a sensitivity",
        f"intrinsic value {plan.value:,.2f} {case.currency}",
        "the contract can be met",
    ]


def solve(
    case: StorageCase,
    *,
    out: Path,
    seed: int,
    engine: str = "auto",
    reference: bool = False,
    resume: bool = False,
    progress: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Solves a case into the folder `out` and returns the content of `result.json`."""
    out = Path(out)
    check_folder(out)
    if not case.days:
        return _write_expired(case, out, seed)
    problem = make_problem(case, seed, engine)
    out.mkdir(parents=True, exist_ok=True)
    copy_case(case.file, out)
    task = Task(
        problem.simulator,
        problem.inputs,
        problem.schedule,
        new_policy(problem),
        problem.objective,
        problem.training,
        problem.evaluation,
        problem.engines,
        case.model.supplied("evaluation"),
        case.model.supplied("training"),
    )
    solution, troubles = solve_into(out, task, resume, progress)
    return _write(problem, solution, out, reference, troubles, progress)


def report(folder: Path) -> Path:
    """Writes `report.html` again from the files of a run folder."""
    return write_report(Path(folder))


def _write(
    problem: Problem, solution: Solution, out: Path, reference: bool, troubles: list[str], progress
) -> dict[str, Any]:
    """Finds the references, and writes the run folder."""
    plan = intrinsic(problem.schedule, problem.interpolation)
    known: dict[str, float | None] = {"intrinsic": plan.value, "dynamic_programming": None}
    factors = problem.factors
    if reference and factors is not None and factors.exact:
        progress("solving the reference by dynamic programming")
        found = lattice(problem.schedule, factors, problem.interpolation)
        known["dynamic_programming"] = found.value
    pages = Pages(lambda: details(problem, solution, plan, known), rows, write_report)
    return write_run(out, problem.case.kind, solution, known, troubles, pages, progress)


def _write_expired(case: StorageCase, out: Path, seed: int) -> dict[str, Any]:
    """A case without a decision left has a value, and nothing to train."""
    out.mkdir(parents=True, exist_ok=True)
    value = value_without_decisions(case)
    result = {
        "kind": case.kind,
        "value": value,
        "standard_error": 0.0,
        "smooth_value": value,
        "smoothing_gap": 0.0,
        "policy_gradient_norm": 0.0,
        "references": {"intrinsic": value, "dynamic_programming": value},
        "seconds": {"compile": 0.0, "train": 0.0, "evaluate": 0.0, "total": 0.0},
        "engine": "none",
        "paths": {"train": 0, "evaluate": 0},
        "seed": seed,
        "status": "ok",
        "run": str(out),
    }
    write_text(out / RESULT, json.dumps(result, indent=1))
    note = "No decision day is left."
    found = {"title": case.title, "currency": case.currency, "notes": [note, *case.notes]}
    write_text(out / DETAILS, json.dumps(found))
    write_report(out)
    return result
