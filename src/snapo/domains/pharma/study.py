"""A run of a pharma case: one part for every chapter of its report."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.solver.statistics import plus_minus
from snapo.study import training
from snapo.study.chapter import Chapter
from snapo.study.domain import Options
from snapo.study.study import LiveTable, Part, PathTotals, Study, StudyRun

from .chapters.attribution import ATTRIBUTION, PROFILES, SECOND
from .chapters.batch import ONE_BATCH
from .chapters.capability import CAPABILITY, SPREAD, STATISTICS_MESH
from .chapters.closed_loop import CLOSED_LOOP
from .chapters.design_space import SPACE
from .chapters.estimation import ESTIMATION
from .chapters.headline import Making, status
from .chapters.model import statement
from .chapters.optimum import OPTIMUM
from .chapters.ranges import PAIRS, RANGES
from .chapters.recipes import RECIPES, RULES, TRAINED
from .chapters.sensitivities import ALL_SENSITIVITIES, CRITICALITY, MATRIX
from .chapters.verification import BALANCES, CONVERGENCE, DIFFERENCES
from .control.closed_loop import ClosedLoop
from .flowsheet.case import PharmaCase
from .flowsheet.inputs import pharma_inputs
from .moved import RecipeCalculation, limits
from .progress import reporting
from .quality.batches import AttributeLimits
from .shared import SOUND, OpenLoop, PharmaStudy

COLUMNS = (
    ("attribute", ""), ("limits", ""), ("mean of batches", ""), ("standard deviation", ""),
    ("within limits", "%"), ("±", "%"),
)  # fmt: skip


def study(case: PharmaCase, options: Options) -> Study:
    """The parts of the case's recipe and, if the case has a [control], those of the closed loop."""
    if options.reference:
        allowed = "a process has no exact reference to compute; its certificate is part of every "
        raise CaseError("--reference", "", None, allowed + "run")
    parts, hooks = open_parts(case), dict[str, Any](recipe=OpenLoop(case))
    if case.control is not None:
        loop = ClosedLoop(case, options.engine)
        rules = [RULES.part] if case.control.rules else []
        needs = (TRAINED.name, *(part.name for part in rules))
        parts += [RECIPES.part, TRAINED, *rules, CLOSED_LOOP.part._replace(needs=needs)]
        hooks |= {
            "loop": loop,
            "setup": loop.setup,
            "setup_at": loop.setup_at,
            "live_tables": kept_limits,
        }
    else:
        hooks["recalculated"] = lambda: RecipeCalculation(case)
    selected = training.with_needs(parts, case.parts)
    entries = about(case) | training.summary(parts, selected)
    telling, entry = [_telling(part) for part in selected], partial(result, case)
    return PharmaStudy(case.kind, entries, telling, entry, inputs=pharma_inputs, **hooks)


def open_parts(case: PharmaCase) -> list[Part]:
    """The parts without a policy, in the order in which they are done."""
    chapters = (
        ONE_BATCH, Part(SOUND, sound, (ONE_BATCH.name,)), BALANCES, CONVERGENCE, DIFFERENCES,
        MATRIX, ALL_SENSITIVITIES, ATTRIBUTION, PROFILES, SECOND, STATISTICS_MESH, CAPABILITY,
        CRITICALITY, SPREAD, OPTIMUM, SPACE, RANGES, PAIRS, ESTIMATION,
    )  # fmt: skip
    request = {CONVERGENCE: case.numerics.refine, SECOND: bool(case.pairs)}
    request |= {
        x: getattr(case, x.table) is not None
        for x in chapters
        if isinstance(x, Chapter) and x.table
    }
    selected = [x for x in chapters if request.get(x, True)]
    return [x if isinstance(x, Part) else x.part for x in selected]


def sound(run: StudyRun) -> dict[str, Any]:
    """The batch that all other results need; an error if it could not be integrated."""
    batch = ONE_BATCH.of(run)
    if batch is None or batch.status != "ok":
        raise ArithmeticError(batch.status if batch else "there is no batch")
    return {}


def _telling(part: Part) -> Part:
    """The part, which reports progress while it runs."""

    def work(run: StudyRun) -> Mapping[str, Any]:
        with reporting(run.progress):
            return part.work(run)

    return part._replace(work=work)


def about(case: PharmaCase) -> dict[str, Any]:
    """Everything that is available before a number is computed."""
    made = {name: x for name, x in asdict(Making.of(case)).items() if x is not None}
    return {"title": case.title} | asdict(statement(case)) | made


def result(case: PharmaCase, run: StudyRun) -> dict[str, Any]:
    """The result of a run; its value is that of the policy, or of the recipe if no policy is
    trained."""
    batches, loop, best = CAPABILITY.of(run), CLOSED_LOOP.of(run), OPTIMUM.of(run)
    state = status(run)
    entries: dict[str, Any] = {
        "value": 1 - batches.joint if batches else None,
        "standard_error": batches.joint_error if batches else None,
        "meaning": "probability that a batch meets all limits, with the original recipe",
        "references": {"optimised_recipe": best.chance[1].probability} if best else {},
        "engine": "none: no policy is trained",
        "paths": {"evaluate": batches.batches if batches else 0},
        "seed": case.training.seed,
        "status": state,
    }
    if loop is None:
        return entries
    references = {"recipe_as_given": loop.given, "best_fixed_recipe": loop.baseline}
    references |= entries["references"]
    if case.goal.kind != "probability":
        references |= {"goal": loop.objective, "goal_of_recipe": loop.baseline_objective}
    return entries | {
        "value": loop.value, "standard_error": loop.standard_error, "engine": loop.engine,
        "paths": loop.paths, "status": loop.status if state == "ok" else state,
        "references": references,
        "meaning": "probability that a batch meets all limits, under the trained policy",
        "verdict": loop.verdict,
    }  # fmt: skip


def kept_limits(measured: PathTotals) -> Sequence[LiveTable]:
    """Every attribute with its limits, and how often batches meet these under the policy."""
    case: PharmaCase = measured.setup.case
    names = [f"attribute.{x.name}" for x in case.attributes]
    values = np.stack([np.asarray(measured.totals[name], np.float64) for name in names], -1)
    contains = AttributeLimits.of(case).hold(values)
    rows = []
    for i, attribute in enumerate(case.attributes):
        share, error = measured.mean(contains[:, i])
        mean, spread = values[:, i].mean(), values[:, i].std(ddof=1)
        bounds = limits(attribute.low, attribute.high, attribute.unit)
        rows.append((attribute.name, bounds, mean, spread, 100 * share, 100 * error))
    share, error = measured.mean(measured.totals["success"])
    text = f"{100 * share:.4g} % {plus_minus(100 * error)} of batches meet all limits (95 %)"
    units = ["" if x.unit == "1" else x.unit for x in case.attributes]
    facts = [(f"{row[0]}, mean", float(row[2]), unit) for row, unit in zip(rows, units)]
    return [LiveTable("Attributes and their limits", COLUMNS, rows, text, facts)]
