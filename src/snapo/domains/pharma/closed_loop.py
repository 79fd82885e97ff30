"""Trains a policy and measures it against the best fixed recipe on the same fresh batches."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ... import solver
from ...adjoint import prepare
from ...engine import choose
from ...evaluate import path_totals
from ...objective import CVaR, Mean, Objective
from ...runfolder import Task, Tell, solve_into
from ...smooth import Exact
from ...train import Training
from .process import Process
from .records import Goal, PharmaCase
from .simulator import Loop, closed_loop, corrected

SHORTFALL = 0.01  # a small share of the violation shows the way where no batch succeeds


def objective(case: PharmaCase) -> Objective:
    """What `[goal]` makes large, of the totals "success", "violation" and "attribute.NAME"."""
    goal: Goal = case.goal
    if goal.kind == "probability":
        return Mean("success") - SHORTFALL * Mean("violation")
    margin = next(each.margin for each in case.attributes if each.name == goal.attribute)
    name = f"attribute.{goal.attribute}"
    kept: Objective = CVaR(name, goal.level) if goal.kind == "cvar" else goal.sense * Mean(name)
    return kept - goal.penalty * margin * Mean("violation")


def train(
    case: PharmaCase,
    process: Process,
    out: Path,
    seed: int,
    engine: str,
    resume: bool,
    tell: Tell,
) -> dict[str, Any]:
    """The run's closed-loop part: probabilities of policy and best recipe, paired."""
    loop = closed_loop(case, process.inputs, seed)
    schedule = prepare(loop.simulator, loop.inputs)
    training = Training(**case.training.model_dump() | {"seed": seed})
    evaluation = solver.Evaluation(**case.evaluation.model_dump())
    best = _best_recipe(loop, objective(case), training, evaluation, engine)
    policy = corrected(loop.simulator, loop.inputs, best, seed)
    engines = choose(engine, loop.simulator, policy, schedule)
    task = Task(
        loop.simulator, loop.inputs, schedule, policy, objective(case), training, evaluation,
        engines,
    )  # fmt: skip
    solution, troubles = solve_into(out, task, resume, tell)
    solution.save(out)
    source = evaluation.source(seed)
    given = (engines.evaluate, loop.simulator, best, schedule, source)
    with jax.enable_x64(True):
        fixed = path_totals(*given, evaluation.paths, Exact())
    ours, theirs = np.asarray(solution.totals["success"]), np.asarray(fixed["success"])
    return {
        "value": float(ours.mean()),
        "standard_error": _error(ours),
        "baseline": float(theirs.mean()),
        "baseline_error": _error(theirs),
        "gain": float((ours - theirs).mean()),
        "gain_error": _error(ours - theirs),
        "objective": solution.value,
        "smoothing_gap": solution.smoothing_gap,
        "policy_gradient_norm": solution.policy_gradient_norm,
        "engine": solution.engine,
        "paths": dict(solution.paths),
        "seconds": dict(solution.seconds),
        "status": "not written" if troubles else solution.status,
    }


def _best_recipe(loop: Loop, goal: Objective, training, evaluation, engine: str) -> Any:
    """The fixed recipe that does best: the same training, on a policy that sees nothing."""
    little = replace(evaluation, sensitivity_paths=64, smooth_paths=0)
    return solver.solve(
        loop.simulator, loop.inputs, loop.baseline, objective=goal, training=training,
        evaluation=little, engine=engine,
    ).policy  # fmt: skip


def _error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / np.sqrt(values.size))
