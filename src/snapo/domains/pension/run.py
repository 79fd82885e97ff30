"""A pension case from the file to the run folder: what `snapo solve` does."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from snapo.case.error import CaseError
from snapo.case.settings import make_objective
from snapo.engine import Engines, choose
from snapo.problem.inputs import Input, plain
from snapo.problem.objective import Objective, Weighted
from snapo.problem.policy import Policy
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Scenarios, Supplied
from snapo.problem.simulator import Schedule
from snapo.solver import solve as solver
from snapo.solver.solution import Solution
from snapo.solver.train import Training
from snapo.study.run_folder import Pages, Task, check_folder, copy_case, solve_into, write_run

from .fund.simulator import PensionSimulator
from .policies.network import new_policy
from .records.case import PensionCase
from .records.inputs import pension_inputs
from .report import write_report
from .results.compare import compare
from .results.details import details, profile_rows
from .results.reconcile import Line
from .results.reconcile import check as reconcile


class Problem(NamedTuple):
    """A case made ready to solve."""

    case: PensionCase
    simulator: PensionSimulator
    inputs: dict[str, Input]
    schedule: Schedule
    policy: Policy
    objective: Objective
    training: Training
    evaluation: solver.Evaluation
    engines: Engines


def check(case: PensionCase) -> list[str]:
    """What the case says, in a few lines: nothing is trained."""
    inputs = pension_inputs(case)
    numbers = sum(entry.value.size for entry in inputs.values())
    scenarios = {"P": "real-world", "Q": "risk-neutral"}[case.measure]
    lines = [
        f"{case.title}: {case.steps} decisions over {case.steps * case.step:g} years, "
        f"{len(case.assets.classes)} classes, {case.buckets} swap tenors",
        f"scenarios: {'supplied' if case.scenarios else f'{case.measure} ({scenarios})'}",
        f"{len(inputs)} inputs with {numbers} numbers, each with a sensitivity; "
        f"{len(case.held)} held",
    ]
    for line in _reconciled(case):
        known = "" if line.given is None else f", given {line.given:,.6g}"
        lines.append(f"{line.name}: {line.own:,.6g}{known}")
    return lines


def _reconciled(case: PensionCase) -> list[Line]:
    """The lines of the reconciliation; a figure of the actuary's that is missed is a mistake."""
    lines = reconcile(case, plain(pension_inputs(case)))
    for line in lines:
        if not line.ok and line.given is not None and case.reconcile is not None:
            tolerance = case.reconcile.tolerance
            what = (
                f"this model's own figure is {line.own:.8g}, which differs by {line.error:.3g}; "
                f"the tolerance is {tolerance:g}"
            )
            raise CaseError(str(case.file), f"reconcile.{line.name}", line.given, what)
    return lines


def solve(
    case: PensionCase,
    *,
    out: Path,
    seed: int,
    engine: str = "auto",
    reference: bool = False,
    resume: bool = False,
    progress: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Solves a case into the folder `out` and returns what `result.json` says.

    `reference` asks for nothing more: the classical policies are always tuned for as long as the
    network is trained.
    """
    out = Path(out)
    check_folder(out)
    lines = _reconciled(case)
    problem = make_problem(case, seed, engine)
    out.mkdir(parents=True, exist_ok=True)
    copy_case(case.file, out)
    task = Task(
        problem.simulator,
        problem.inputs,
        problem.schedule,
        problem.policy,
        problem.objective,
        problem.training,
        problem.evaluation,
        problem.engines,
        supplied(case, "evaluation"),
        supplied(case, "training"),
    )
    solution, troubles = solve_into(out, task, resume, progress)
    return _write(problem, solution, out, lines, troubles, progress)


def report(folder: Path) -> Path:
    """Writes `report.html` afresh from the files of a run folder."""
    return write_report(Path(folder))


def make_problem(case: PensionCase, seed: int, engine: str = "auto") -> Problem:
    """Simulator, inputs, schedule, policy, objective and engines of a case."""
    inputs = pension_inputs(case)
    simulator = PensionSimulator(case)  # pyright: ignore[reportCallIssue]
    schedule = prepare(simulator, inputs)
    policy = new_policy(case, simulator, schedule, jax.random.key(seed))
    training = Training(**case.training.model_dump() | {"seed": seed})
    evaluation = solver.Evaluation(**case.evaluation.model_dump())
    if case.scenarios is not None:
        paths = min(evaluation.paths, len(case.scenarios.evaluation))
        evaluation = replace(evaluation, paths=paths)
    engines = choose(engine, simulator, policy, schedule)
    objective = objective_of(case)
    return Problem(
        case, simulator, inputs, schedule, policy, objective, training, evaluation, engines
    )


def objective_of(case: PensionCase) -> Objective:
    """The sum of the case's terms."""
    terms = [(term.weight, make_objective(term.objective, term.output)) for term in case.objective]
    if len(terms) == 1 and terms[0][0] == 1:
        return terms[0][1]
    return Weighted(*terms)


def supplied(case: PensionCase, which: str) -> Supplied | None:
    """Ready-made paths in the order of time, "training" or "evaluation"; None where generated."""
    if case.scenarios is None:
        return None
    paths = getattr(case.scenarios, which)
    return Supplied(np.ascontiguousarray(np.swapaxes(paths, 0, 1)))


def evaluation_source(problem: Problem) -> Scenarios:
    """The scenarios on which policies are measured and compared: none of them was trained on."""
    return supplied(problem.case, "evaluation") or problem.evaluation.source(problem.training.seed)


def _write(
    problem: Problem,
    solution: Solution,
    out: Path,
    lines: list[Line],
    troubles: list[str],
    progress: Callable[[str], None],
) -> dict[str, Any]:
    """Compares with the classical policies, and writes the run folder."""
    source = evaluation_source(problem)
    rivals = compare(problem, solution, source, progress)
    references = {each["key"]: each["value"] for each in rivals if each["key"] != "learned"}
    pages = Pages(
        lambda: details(problem, solution, source, rivals, lines, progress),
        profile_rows,
        write_report,
    )
    return write_run(out, problem.case.kind, solution, references, troubles, pages, progress)
