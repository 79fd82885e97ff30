"""Trains a policy and measures it against the best fixed recipe on the same fresh batches.

The recipe is tuned at least as hard as the policy: both are one `Feedback`, trained by the same
steps. From several starts the best recipe is kept; from there recipe and policy go on side by
side, for as many steps each.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from snapo.engine import Engines, choose
from snapo.problem.objective import CVaR, Mean, Objective
from snapo.problem.prepare import prepare
from snapo.problem.simulator import Schedule
from snapo.problem.smooth import Exact
from snapo.solver import solve as solver
from snapo.solver.evaluate import path_totals
from snapo.solver.train import Training, begin
from snapo.solver.train import train as climb
from snapo.study.run_folder import Task, Tell, solve_into

from ..flowsheet.case import PharmaCase
from ..flowsheet.process import Process
from .loop import Loop, closed_loop
from .policy import Feedback
from .records import Goal

SHORTFALL = 0.01  # a small share of the violation shows the way where no batch succeeds
STARTS, SPREAD = 3, 0.3  # recipes that tuning starts from: the case's own, and some moved ones


def objective(case: PharmaCase) -> Objective:
    """What `[goal]` makes large, of the totals "success", "violation" and "attribute.NAME"."""
    goal: Goal = case.goal
    if goal.kind == "probability":
        return Mean("success") - SHORTFALL * Mean("violation")
    margin = next(each.margin for each in case.attributes if each.name == goal.attribute)
    name = f"attribute.{goal.attribute}"
    kept: Objective = CVaR(name, goal.level) if goal.kind == "cvar" else goal.sense * Mean(name)
    return kept - goal.penalty * margin * Mean("violation")


def in_words(goal: Goal) -> str:
    """What `objective` is, in the unit of the goal's attribute where it has one."""
    if goal.kind == "probability":
        return "probability of all limits"
    which = f"mean of the worst {1 - goal.level:.3g}" if goal.kind == "cvar" else "mean"
    sign = "minus the " if goal.kind == "mean" and goal.sense < 0 else ""
    lost = f"less {goal.penalty:g} of its margins for every margin beyond a limit"
    return f"{sign}{which} of {goal.attribute}, {lost}"


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
    loop, goal = closed_loop(case, process.inputs, seed), objective(case)
    schedule = prepare(loop.simulator, loop.inputs)
    training = Training(**case.training.model_dump() | {"seed": seed})
    evaluation = solver.Evaluation(**case.evaluation.model_dump())
    # A step of a process is far more than the native engine takes, and asking it costs a trace.
    name = "xla" if engine == "auto" else engine
    engines = choose(name, loop.simulator, loop.policy, schedule)
    first, best = best_recipe(loop, schedule, goal, training, engines, tell)
    task = Task(
        loop.simulator, loop.inputs, schedule, first.closed(), goal, training, evaluation, engines
    )
    solution, troubles = solve_into(out, task, resume, tell)
    solution.save(out)
    given = (engines.evaluate, loop.simulator, best, schedule, evaluation.source(seed))
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
        "goal": in_words(case.goal),
        "objective": solution.value,
        "objective_error": solution.standard_error,
        "baseline_objective": float(goal.value(fixed)),
        "recipe": _recipe_rows(case, loop, best),
        "smoothing_gap": solution.smoothing_gap,
        "policy_gradient_norm": solution.policy_gradient_norm,
        "engine": solution.engine,
        "paths": dict(solution.paths),
        "seconds": dict(solution.seconds),
        "status": "not written" if troubles else solution.status,
    }


def best_recipe(
    loop: Loop,
    schedule: Schedule,
    goal: Objective,
    training: Training,
    engines: Engines,
    tell: Tell = lambda text: None,
) -> tuple[Feedback, Feedback]:
    """The best of several recipes, each trained; and it again, trained as long once more.

    The first is where a policy starts that is to be compared with the second.
    """

    def tuned(recipe: Feedback, plan: Training, what: str) -> tuple[float, Feedback]:
        start = begin(recipe, plan)
        found = climb(loop.simulator, schedule, start, goal, plan, engines.train)
        tell(f"{what}: exact value {found.best_value:,.7g}")
        assert isinstance(found.best, Feedback)
        return found.best_value, found.best

    own = loop.baseline
    starts = [own, *(own.moved(SPREAD, training.seed + k) for k in range(1, STARTS))]
    found = [tuned(each, training, f"recipe from start {i + 1}") for i, each in enumerate(starts)]
    first = max(found, key=lambda each: each[0])[1]
    again = replace(training, seed=training.seed + 1)  # other batches, or it would follow the first
    return first, tuned(first, again, "best recipe, trained on")[1]


def _recipe_rows(case: PharmaCase, loop: Loop, best: Feedback) -> list[dict[str, Any]]:
    """What the best fixed recipe decides, in the domain's units: one row per number decided."""
    assert case.control is not None
    actions, rows = best.actions(), []
    for stage in loop.stages:
        for place, i in enumerate(stage.decided):
            item = case.control.manipulated[i]
            part = actions[stage.before : stage.before + stage.horizon, place]
            values = item.low + part * (item.high - item.low)
            rows.append({"input": item.input, "unit": loop.inputs[item.input].unit,
                         "values": values.astype(float)})  # fmt: skip
    return rows


def _error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / np.sqrt(values.size))
