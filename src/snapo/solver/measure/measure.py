"""The result of a training: the reported policy, its value, and its derivatives."""

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from snapo.engine import Engine, Engines, Native
from snapo.lanes.machine.threads import in_thread
from snapo.problem.objective import Totals
from snapo.problem.policies.memory import remembered
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import EXACT, Smooth
from snapo.problem.unseen import note

from ..derivatives.margin import floor_of, margin_of, passes, with_margin
from ..derivatives.rebuilt import LONG, fewer, rebuilt_once
from ..derivatives.surface import Surface, coordinates, rollouts, surface_of
from ..derivatives.table import Sensitivities
from ..derivatives.verdict import held_alone, reported, tested_by_bumps
from ..evaluate import (
    Value,
    estimate,
    path_totals,
    ruined,
    shares_of,
    totals_and_decisions,
    value_of,
)
from ..learning.log import start_notes
from ..learning.progress import INTERRUPTED
from ..learning.settings import TrainingPlan
from ..limits import limits_found, notes_of
from ..provenance import why_broken
from ..sensitivity import sensitivities_and_totals, through_policy
from ..statistics import of_shares
from ..train import Progress
from ..verdict.convergence import AS_BEGUN, ending
from .selection import (
    FEWEST,
    HIGHEST,
    NEWEST,
    PAIR,
    START,
    Effort,
    Evaluation,
    Selection,
    select,
)

GAP_PATHS = 4096  # at most: paths are paired, so the gap is known far better than the value
TAIL = 200  # paths in a tail, below which the error of its measure is inaccurate
KEPT = "start kept"  # how a training ended whose starting rule is reported
WHERE = {"train": "training", "evaluate": "the value", "sensitivities": "the sensitivities"}


class MeasuredRun(NamedTuple):
    """A training that is to be measured: the problem, the rule it began with, and its settings.

    `drawn`: whether the networks of this rule were drawn at random for this training.
    """

    problem: Problem
    start: Policy
    progress: Progress
    training: TrainingPlan
    evaluation: Evaluation
    engines: Engines
    drawn: bool = False

    @property
    def held_paths(self) -> int:
        """The number of paths for the held derivatives."""
        return min(self.evaluation.sensitivity_paths, self.evaluation.paths)

    @property
    def effort(self) -> Effort:
        """The number of paths for derivatives, in addition to the training."""
        steps, maximum = (
            max(1, self.progress.step),
            min(self.evaluation.search_paths, self.held_paths),
        )
        return Effort.for_training(
            steps * self.training.paths, self.problem.simulator.horizon, maximum
        )

    @property
    def smooth(self) -> Smooth:
        """The smooth simulator at the end of training."""
        return Smooth(np.float64(self.training.temperature(self.training.steps)))


def measure(run: MeasuredRun) -> dict[str, Any]:
    """The reported policy with its value, smoothing gap, sensitivities and the outcome of training,
    as fields of a `Solution`."""
    problem, training, engine = run.problem, run.training, run.engines.evaluate
    objective, evaluation = problem.objective, run.evaluation
    source, controls = problem.sources.evaluation, problem.simulator.control_variates()
    with _compiled_meanwhile(run):
        selection, surface = _selection(run)
        run = run._replace(progress=replace(run.progress, best=selection.policy))
        progress, policy = run.progress, selection.policy
        values = problem, policy, evaluation.paths, run.held_paths
        exact, decisions = totals_and_decisions(*values, engine=engine)
    value = estimate(objective, exact, source, controls)
    limits = limits_found(problem, policy, exact, progress.dual, run.smooth, engine)
    within = problem.priced([abs(limit.price) for limit in limits])
    if problem.constraints and evaluation.judge_paths:
        surface = _surface(run, within)
    table, soft = _sensitivities(run, within, selection, surface, exact, decisions)
    gap, gap_error = _smoothing_gap(problem, policy, exact, soft, run.smooth, engine)
    gradient = table and table.policy_gradient
    values = problem, run.start, progress, training, exact, run.held_paths, decisions
    ended = ending(*values, engine, gradient, run.drawn)
    norm, noise = gradient or (float("nan"), float("nan"))
    dropped = {
        "train": sum(record.bad_paths for record in progress.history),
        "evaluate": value.dropped,
        "sensitivities": table.dropped if table else 0,
    }
    selected = selection.kind == START
    unseen = note(problem.partly_observed, remembered(policy) > 0)
    broken = why_broken(problem, progress, training, run.engines.train)
    notes = (
        *_notes(value, dropped, ruined(objective, exact)),
        *_tails(problem, len(exact[objective.outputs[0]])),
        *filter(None, [broken, unseen, selection.description]),
        *start_notes(progress),
        *ended.notes,
        *_long(run, table),
        *notes_of(limits),
    )
    return {
        "value": value.value,
        "standard_error": value.standard_error,
        "control": value.control,
        "smooth_value": value.value - gap,
        "smoothing_gap": gap,
        "smoothing_gap_error": gap_error,
        "policy": policy,
        "selected": selection.kind,
        "gain": (selection.gain, selection.error),
        "policy_gradient_norm": norm,
        "policy_gradient_noise": noise,
        "sensitivities": table,
        "totals": exact,
        "paths": {"train": training.paths, "evaluate": source.available(evaluation.paths)},
        "roles": problem.sources.roles(
            training.paths, training.validation_paths, evaluation.paths, run.held_paths
        ),
        "dropped": dropped,
        "notes": notes,
        "constraints": limits,
        "growth": progress.growth,
        "window": progress.window,
        "clip": progress.clip,
        "keep": progress.keep,
        "convergence": KEPT if selected and ended.word == AS_BEGUN else ended.word,
        "status": _status(value.value, progress.status),
    }


def _compiled_meanwhile(run: MeasuredRun) -> AbstractContextManager:
    """Compiles the smooth derivatives during the work of the block, if the engine's programs
    serve any number of paths and the objective is known already.

    For long paths this is done later: their tables need much memory, and other threads are busy.
    """
    problem, engine = run.problem, run.engines.evaluate
    requested = run.held_paths and run.evaluation.smooth_paths and not problem.constraints
    requested = requested and problem.simulator.horizon <= LONG
    if not requested or not isinstance(engine, Native):
        return nullcontext()
    return in_thread(through_policy(problem, run.progress.best, run.smooth, engine).compile)


def _surface(run: MeasuredRun, problem: Problem) -> Surface | None:
    """The value around the newest policy; None if no derivative is needed."""
    progress, effort = run.progress, run.effort
    if not effort.maximum or not np.isfinite(progress.best_value):
        return None
    newest = progress.best if problem.constraints or run.problem.constraints else progress.average
    around = coordinates(newest, progress.halfway if progress.step > 1 else None)
    count = len(around.directions)
    while count > PAIR and rollouts(count) * effort.fewest > effort.work:
        count -= 1
    around, paths = around.leading(count), effort.valued(rollouts(count))
    return surface_of(problem, around, paths, run.training.seed, run.engines.train)


def _selection(run: MeasuredRun) -> tuple[Selection, Surface | None]:
    """The reported policy, with limits the newest one, as in training; and the value around the
    newest policy, where the choice or the derivatives need it."""
    problem, progress, evaluation = run.problem, run.progress, run.evaluation
    paths = min(evaluation.selection_paths, max(evaluation.paths, run.training.validation_paths))
    judged = evaluation.judge_paths > 0
    if problem.constraints:
        return Selection(HIGHEST, progress.best), None
    surface = cache(lambda: _surface(run, problem))
    if not paths or not np.isfinite(progress.best_value):
        return Selection(HIGHEST, progress.best), surface() if judged else None

    def top() -> Policy | None:
        around = surface()
        return None if around is None else around.policy

    candidates = {NEWEST: progress.average, HIGHEST: progress.best}
    engine = run.engines.evaluate
    selection = select(problem, run.start, candidates, paths, engine, top, search=judged)
    return selection, surface() if judged else None


def _sensitivities(
    run: MeasuredRun,
    problem: Problem,
    selection: Selection,
    surface: Surface | None,
    exact: Totals,
    decisions: np.ndarray | None,
) -> tuple[Sensitivities | None, Totals | None]:
    """The table of the reported policy, whose totals are `exact` and whose first decisions are
    known, unless they are many, and the totals of the smooth simulator, if they are known.

    None if it has no paths.
    """
    evaluation, progress, engine = run.evaluation, run.progress, run.engines.evaluate
    policy, paths = progress.best, run.held_paths
    if not paths:
        return None, None
    smooth = run.smooth if evaluation.smooth_paths else EXACT
    earlier = progress.halfway if progress.step > 1 and evaluation.smooth_paths else None
    table, soft = sensitivities_and_totals(
        problem, policy, paths, smooth, evaluation.smooth_paths, earlier, engine, decisions
    )
    if not evaluation.judge_paths:
        return table._replace(reported=held_alone(problem, table.held)), soft
    bumped, result = tested_by_bumps(
        problem, policy, paths, table.held,
        maximum=evaluation.judge_paths, rollouts=run.effort.work, centre=exact, engine=engine,
    )  # fmt: skip
    derivatives = reported(problem, table.held, table.smooth, bumped, result)
    if surface is not None:
        paths = run.effort.gone_back(passes(surface))
        margin = margin_of(problem, policy, surface, paths, run.training.seed, engine)
        gap = _gap(problem, progress, selection, surface)
        derivatives = with_margin(problem, policy, derivatives, margin, gap, engine)
    return table._replace(verdicts=result, reported=derivatives), soft


def _gap(problem: Problem, progress: Progress, selection: Selection, surface: Surface) -> float:
    """The amount by which the best policy may be above the reported one: the whole gain of the
    search with its error, and a part of the loss that the search could not distinguish from
    noise."""
    gain, error = selection.search
    floor = floor_of(problem.action) * surface.target
    return max(abs(gain) + error, surface.gain, floor, _spread(progress))


def _spread(progress: Progress) -> float:
    """The difference of the last two starts, minus the gain of the better one since: the other
    would have gained as much too, unless it is in another optimum."""
    values = progress.last_two
    if not values or not np.isfinite([*values, progress.best_value]).all():
        return 0.0
    return max(0.0, float(np.ptp(values)) - (progress.best_value - values[0]))


def _smoothing_gap(
    problem: Problem,
    policy: Policy,
    exact: Totals,
    soft: Totals | None,
    smooth: Smooth,
    engine: Engine,
) -> tuple[float, float]:
    """Exact minus smooth with its standard error, on the first of the paths whose exact totals are
    known; `soft`: the smooth totals on as many, if the derivatives have them."""
    objective, source = problem.objective, problem.sources.evaluation
    maximum = fewer(GAP_PATHS, problem.simulator.horizon)
    paths = min(maximum, len(exact[objective.outputs[0]]))
    if soft is None or len(soft[objective.outputs[0]]) < paths:
        soft = path_totals(problem, policy, paths, smooth=smooth, engine=engine, controls=False)
    same = {name: total[: len(soft[name])] for name, total in exact.items() if name in soft}
    with np.errstate(invalid="ignore"):
        gap = float(np.subtract(value_of(objective, same), value_of(objective, soft)))
        difference = shares_of(objective, same, source) - shares_of(objective, soft, source)
    return gap, of_shares(difference).standard_error


def _status(value: float, status: str) -> str:
    """The status of a run: that of its training, unless its value is not finite although all steps
    were taken."""
    if np.isfinite(value) or status in ("diverged", INTERRUPTED):
        return status
    return "ruined" if value < 0 else "not finite"


def _tails(problem: Problem, paths: int) -> list[str]:
    """A sentence for every measure of a tail that has few paths."""
    measures = problem.objective, *(limit.measure for limit in problem.constraints)
    return [
        f"There are few paths in the tail: the {item.describe()} uses {item.tail * paths:.0f} "
        f"of {paths:,} paths, and its error is inaccurate with fewer than {TAIL}; use "
        f"{int(np.ceil(round(TAIL / item.tail, 6))):,} paths."
        for item in measures
        if item.tail < 1 and item.tail * paths < TAIL
    ]


def _long(run: MeasuredRun, table: Sensitivities | None) -> list[str]:
    """A sentence about work that long paths save."""
    if table is None or run.problem.simulator.horizon <= LONG:
        return []
    notes = [
        f"Paths have more than {LONG:,} steps, so derivatives were measured on only "
        f"{run.held_paths:,} of them. Together they have as many steps as the requested "
        f"number of paths would have with {LONG:,} steps each."
    ]
    if run.evaluation.judge_paths:
        notes.append(
            "The part of the intervals of derivatives that is due to the policy was measured on "
            f"{run.effort.fewest} paths (if paths are shorter, {FEWEST} are used)."
        )
        if rebuilt_once(run.problem):
            notes.append(
                "For the bump of an input the policy's tables were recomputed at one move of the "
                "input; at its other moves they were approximated to first order."
            )
    return [" ".join(notes)]


def _notes(value: Value, dropped: Mapping[str, int], ruin: int) -> tuple[str, ...]:
    """Sentences that a reader of the value must see."""
    notes = [
        f"The control variate {name!r} is not used: its mean is not zero." for name in value.refused
    ]
    if ruin:
        notes.append(
            f"{ruin} {'path ends' if ruin == 1 else 'paths end'} in ruin, with a utility of "
            "minus infinity."
        )
    if any(dropped.values()):
        counts = ", ".join(f"{count} in {WHERE[name]}" for name, count in dropped.items() if count)
        notes.append(f"Paths left out since they are non-finite: {counts}.")
    return tuple(notes)
