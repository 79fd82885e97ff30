"""A gas-storage case from the file to the run folder: what `snapo solve` does."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from snapo.case.settings import make_objective
from snapo.engine import Engines, choose
from snapo.problem.inputs import Input
from snapo.problem.objective import Mean
from snapo.problem.objective import Objective as CoreObjective
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Pseudo, Scenarios, Supplied
from snapo.problem.simulator import Schedule, probe
from snapo.solver import solve as solver
from snapo.solver.files import write_text
from snapo.solver.sensitivity import sensitivities
from snapo.solver.solution import RESULT, Solution
from snapo.solver.train import EVALUATE_STREAM, Training
from snapo.study.run_folder import DETAILS, Pages, Task, check_folder, copy_case, solve_into, write_run

from . import references
from .details import details, profile_rows
from .expiry import value_without_decisions
from .guide import Guide
from .inputs import storage_inputs
from .policy import GuidePolicy, StoragePolicy
from .records import StorageCase, SuppliedModel
from .report import write_report
from .simulator import StorageSimulator

OUTPUT = "cash_flow"
HEDGE_PATHS = 2048


class Problem(NamedTuple):
    """A case made ready to solve."""

    case: StorageCase
    simulator: StorageSimulator
    inputs: dict[str, Input]
    schedule: Schedule
    objective: CoreObjective
    training: Training
    evaluation: solver.Evaluation
    engines: Engines

    @property
    def interpolation(self):
        return self.case.contract.ratchets.interpolation


def check(case: StorageCase) -> list[str]:
    """What the case says, in a few lines: nothing is trained."""
    if not case.days:
        value = value_without_decisions(case)
        return [f"{case.title}: no decision day is left; the value is {value:,.2f}"]
    simulator = StorageSimulator(case)  # pyright: ignore[reportCallIssue]
    inputs = storage_inputs(case)
    schedule = prepare(simulator, inputs)
    plan = references.intrinsic(schedule, case.contract.ratchets.interpolation)
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
    """Solves a case into the folder `out` and returns what `result.json` says."""
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
        _evaluation_scenarios(problem),
        _training_scenarios(problem),
    )
    solution, troubles = solve_into(out, task, resume, progress)
    return _write(problem, solution, out, reference, troubles, progress)


def report(folder: Path) -> Path:
    """Writes `report.html` afresh from the files of a run folder."""
    return write_report(Path(folder))


def make_problem(case: StorageCase, seed: int, engine: str = "auto") -> Problem:
    """Simulator with its guide and its hedge, inputs, schedule, objective and engines."""
    inputs = storage_inputs(case)
    bare = StorageSimulator(case)  # pyright: ignore[reportCallIssue]
    schedule = prepare(bare, inputs)
    interpolation = case.contract.ratchets.interpolation
    noise = not isinstance(case.model, SuppliedModel)
    found = references.marginal_values(schedule, interpolation, noise=noise)
    # No hedge yet, but its place: the compiled `prepare` serves before and after.
    no_hedge = np.zeros(len(case.days))
    simulator = StorageSimulator(case, Guide.of(found), no_hedge)  # pyright: ignore
    schedule = prepare(simulator, inputs)
    training = Training(**case.training.model_dump() | {"seed": seed})
    evaluation = solver.Evaluation(**case.evaluation.model_dump())
    if isinstance(case.model, SuppliedModel):
        evaluation = replace(evaluation, paths=min(evaluation.paths, len(case.model.evaluation)))
    policy = StoragePolicy(probe(simulator, schedule)[1].shape[0], key=jax.random.key(seed))
    engines = choose(engine, simulator, policy, schedule)
    if noise:
        simulator = replace(simulator, hedge=_hedge(simulator, inputs, engines, seed))
        schedule = prepare(simulator, inputs)
    objective = make_objective(case.objective, OUTPUT)
    return Problem(case, simulator, inputs, schedule, objective, training, evaluation, engines)


def _hedge(simulator: StorageSimulator, inputs, engines: Engines, seed: int) -> np.ndarray:
    """Forward volumes [T] for the control variate: the deltas of the guide's rule."""
    source = Pseudo(seed, stream=(EVALUATE_STREAM << 32) + 2)
    rule = GuidePolicy()
    found = sensitivities(
        simulator, inputs, rule, Mean(OUTPUT), source, HEDGE_PATHS, engine=engines.evaluate
    )
    discount = prepare(simulator, inputs).steps.gas_discount
    return found.held["forward_curve"].value[: simulator.horizon] / discount


def new_policy(problem: Problem) -> StoragePolicy:
    """The untrained policy: the guide's rule, nearly."""
    features = probe(problem.simulator, problem.schedule)[1].shape[0]
    return StoragePolicy(features, key=jax.random.key(problem.training.seed))


def _training_scenarios(problem: Problem) -> Supplied | None:
    """The case's own paths to train on, where prices are supplied."""
    model = problem.case.model
    return supplied(model.training, problem.simulator) if isinstance(model, SuppliedModel) else None


def _evaluation_scenarios(problem: Problem) -> Scenarios | None:
    """The case's own paths to evaluate on, which are others, where prices are supplied."""
    model = problem.case.model
    if not isinstance(model, SuppliedModel):
        return None
    return supplied(model.evaluation, problem.simulator)


def supplied(paths: np.ndarray, simulator: StorageSimulator) -> Supplied:
    """Price paths [path, day] as scenarios: the first day's price starts a path."""
    days = simulator.horizon
    later = np.zeros((days, len(paths), 1))
    following = paths[:, 1 : days + 1].T
    later[: len(following), :, 0] = following
    return Supplied(later, paths[:, :1])


def _write(
    problem: Problem, solution: Solution, out: Path, reference: bool, troubles: list[str], progress
) -> dict[str, Any]:
    """Finds the references, and writes the run folder."""
    plan = references.intrinsic(problem.schedule, problem.interpolation)
    known: dict[str, float | None] = {"intrinsic": plan.value, "dynamic_programming": None}
    if reference and not isinstance(problem.case.model, SuppliedModel):
        progress("solving the reference by dynamic programming")
        known["dynamic_programming"] = references.lattice(
            problem.schedule, problem.interpolation
        ).value
    pages = Pages(lambda: details(problem, solution, plan, known), profile_rows, write_report)
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
