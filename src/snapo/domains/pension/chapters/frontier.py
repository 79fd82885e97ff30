"""The efficient frontier: contributions against the shortfall, for several weights of the two.

For shares s from 0 to 1 the aim is (1 - s) CVaR of min(F - 1, 0) at the horizon minus s times the
present value of contributions divided by the liability of today. The sweep goes up and then down
again. Every training starts from the policy that is so far the best for the new aim, whatever share
it was trained for. In the end every share takes the best of all policies. Policies are chosen on
the validation paths and measured on fresh ones. On the same paths the points would be in order by
construction: of two policies that are best for their aims, the one for the larger s has lower
contributions. On fresh paths they are in order within their errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from snapo.problem.objective import CVaR, Mean, Objective, Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Scenarios
from snapo.report.drawing import LIGHT, draw, number_axis, unit_above
from snapo.report.page import Block, Chart, Missing, Table, Text
from snapo.report.quantity import number, plus_minus
from snapo.solver.evaluate import estimate, path_totals, value_of
from snapo.solver.statistics import half_width
from snapo.solver.train import initial_progress, train
from snapo.study.chapter import Chapter, Number
from snapo.study.study import Setup, StudyRun

from ..records.case import Frontier
from ..results.setup import case_of
from ..run import PensionRun, points, share, with_measure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TAIL = 50  # paths that the tail of a training batch must hold: a smaller one is biased
CHECKS = 4  # validations in each training: a policy on the way may be better than the last one
CAPTION = (
    "Each point is the policy that is best on the validation paths for its weighting of the two "
    "objectives, among the policies trained with rising and with falling weights. All are valued "
    "on the same fresh paths; bars are 95 % intervals. Points further up and to the left are "
    "better. CVaR: mean of min(F − 1, 0) over the worst paths at the horizon. Efficient: no other "
    "point has both lower contributions and a smaller shortfall."
)


class Candidate(NamedTuple):
    """A policy, and its totals on the validation paths."""

    policy: Policy
    totals: Totals


@dataclass(frozen=True)
class FrontierPoint:
    """The results of a policy: the mean present value of contributions (money) and the CVaR of the
    shortfall (a ratio, at most 0) with standard errors, the median funding ratio, and the share of
    paths with a ratio below 1.

    - `share`: the weight of contributions, NaN for the policy of the run.
    - `efficient`: whether no other point has lower contributions and a smaller shortfall; None for
      the policy of the run.
    """

    share: Number = np.nan
    contributions: Number = np.nan
    contributions_error: Number = np.nan
    cvar: Number = np.nan
    cvar_error: Number = np.nan
    median: Number = np.nan
    underfunded: Number = np.nan
    efficient: bool | None = None


@dataclass(frozen=True)
class FrontierSweep:
    """The points of the sweep (none without `[frontier]`) and the policy of the run."""

    level: Number = np.nan
    points: tuple[FrontierPoint, ...] = ()
    learned: FrontierPoint = field(default_factory=FrontierPoint)


def measure(run: StudyRun) -> FrontierSweep:
    """The sweep of the weights requested in the case."""
    request, setup = case_of(run).frontier, run.setup
    if request is None:
        return FrontierSweep()
    assert run.solution.policy is not None
    problem, source = setup.problem, setup.problem.sources.evaluation
    weights = np.linspace(0.0, 1.0, request.points)
    goals = [_mixture(problem, request, weight) for weight in weights]
    sweep = []
    for weight, candidate in zip(weights, _swept(run, goals, request)):
        paths, engine = setup.evaluation.paths, setup.engines.evaluate
        totals = path_totals(problem, candidate.policy, paths, engine=engine)
        sweep.append(_measured(totals, source, request.level, weight))
    sweep = [replace(x, efficient=not any(_better(other, x) for other in sweep)) for x in sweep]
    local = {name: np.asarray(total) for name, total in run.solution.totals.items()}
    return FrontierSweep(request.level, tuple(sweep), _measured(local, source, request.level))


def _swept(run: StudyRun, goals: Sequence[Objective], frontier: Frontier) -> list[Candidate]:
    """The best policy for each goal, after training for the goals in order and back again."""
    setup, policy = run.setup, run.solution.policy
    assert policy is not None
    available = [_candidate(setup, policy)]
    upward = list(range(len(goals)))
    for goal in (*upward, *upward[-2::-1]):
        run.progress(f"frontier: point {goal + 1} of {len(goals)}")
        start = best(available, goals[goal])
        result = _trained(setup, start.policy, goals[goal], frontier)
        available.append(_candidate(setup, result))
    return [best(available, goal) for goal in goals]


def best(candidates: Sequence[Candidate], goal: Objective) -> Candidate:
    """The candidate with the highest value; the first one among equals."""
    values = np.array([value_of(goal, item.totals) for item in candidates])
    return candidates[int(np.argmax(np.where(np.isfinite(values), values, -np.inf)))]


def _candidate(setup: Setup, policy: Policy) -> Candidate:
    source = setup.problem.sources.validation
    paths = source.available(setup.training.validation_paths)
    engine = setup.engines.evaluate
    totals = path_totals(setup.problem, policy, paths, engine=engine, source=source)
    return Candidate(policy, totals)


def _mixture(problem: Problem, frontier: Frontier, share: float) -> Objective:
    scale = float(problem.schedule.constants.liability)
    tail = (1 - share) * CVaR("surplus_ratio", frontier.level)
    return tail - share / scale * Mean("pv_contribution")


def _trained(setup: Setup, start: Policy, goal: Objective, frontier: Frontier) -> Policy:
    """The best policy of a training that continues another one, at its last temperature and with a
    short warm-up."""
    values = setup.training
    training = replace(
        values,
        steps=frontier.steps,
        paths=max(values.paths, 2 * round(TAIL / (1 - frontier.level) / 2)),
        warmup=min(values.warmup, frontier.steps // 8),
        temperature_start=values.temperature_end,
        exploration=0.0,  # the policy is trained already
        validation_every=max(1, frontier.steps // CHECKS),
    )
    problem = replace(setup.problem, objective=goal)
    return train(problem, initial_progress(start, training), training, setup.engines.train).best


def _measured(
    totals: dict[str, np.ndarray], source: Scenarios, level: float, weight: float = np.nan
) -> FrontierPoint:
    paid = estimate(Mean("pv_contribution"), totals, source)
    short = estimate(CVaR("surplus_ratio", level), totals, source)
    final = totals["funding_ratio"]
    return FrontierPoint(
        weight,
        paid.value,
        paid.standard_error,
        short.value,
        short.standard_error,
        float(np.median(final)),
        float((final < 1).mean()),
    )


def _better(one: FrontierPoint, other: FrontierPoint) -> bool:
    """Whether `one` asks for less and leaves less of a shortfall."""
    return one.contributions < other.contributions and one.cvar > other.cvar


def show(run: PensionRun, result: FrontierSweep) -> Sequence[Block]:
    """The sweep as a picture and a table."""
    if not result.points:
        return [
            Missing("The case has no table `[frontier]`, so no efficient frontier was computed.")
        ]
    policies = [*result.points, result.learned]
    scale, unit = run.size([x.contributions for x in policies])
    level = share(result.level, 0)
    units = (f"Mean present value of contributions, {unit}", f"CVaR {level} of F − 1, points")
    first, last = result.points[0], result.points[-1]
    alt = (
        f"CVaR against contributions: from {points(first.cvar)} points at"
        f" {run.large(first.contributions)} to {points(last.cvar)} at"
        f" {run.large(last.contributions)}."
    )
    svg = draw("sweep", alt, lambda axes: _paint(axes, result, scale, units), 250)
    chart = Chart(svg, "The number at a point is the weight of contributions in its objective.")
    body = [_row(x, share(x.share, 0), scale) for x in result.points]
    body.append(_row(result.learned, "Learned policy", scale))
    head = [("Weight of contributions", ""), ("PV contributions", unit), ("", "")]
    head += [(f"CVaR {level}", "points"), ("", ""), ("Median F", "%")]
    head += [("P(F < 1)", "%"), ("Efficient", "")]
    return [chart, Table(head, body), Text(CAPTION, True)]


def _paint(axes: "Axes", result: FrontierSweep, scale: float, units: tuple[str, str]) -> None:
    """The sweep with its efficient points joined, and the learned policy."""
    best = sorted((x for x in result.points if x.efficient), key=lambda x: x.contributions)
    axes.plot(*_places(best, scale), color=LIGHT["main"], linewidth=1.2)
    _dots(axes, result.points, scale, "main", [share(x.share, 0) for x in result.points])
    _dots(axes, [result.learned], scale, "withdraw", ["Learned policy"], below=True)
    axes.margins(x=0.15, y=0.2)
    number_axis(axes.xaxis)
    number_axis(axes.yaxis)
    axes.set_xlabel(units[0])
    unit_above(axes, units[1])


def _row(point: FrontierPoint, name: str, scale: float) -> tuple[str, ...]:
    return (
        name,
        number(point.contributions / scale, 2),
        plus_minus(point.contributions_error / scale, 2),
        points(point.cvar),
        plus_minus(100 * point.cvar_error, 2),
        points(point.median, 1),
        points(point.underfunded, 1),
        {None: "", True: "yes", False: "no"}[point.efficient],
    )


def _places(dots: Sequence[FrontierPoint], scale: float) -> tuple[np.ndarray, np.ndarray]:
    x = np.array([dot.contributions for dot in dots]) / scale
    return x, 100 * np.array([dot.cvar for dot in dots])


def _dots(
    axes: "Axes", dots: Sequence[FrontierPoint], scale: float, colour: str, names, below=False
) -> None:
    x, y = _places(dots, scale)
    across = half_width(1 / scale) * np.nan_to_num([dot.contributions_error for dot in dots])
    up = half_width(100) * np.nan_to_num([dot.cvar_error for dot in dots])
    style = {"color": LIGHT[colour], "markersize": 6, "elinewidth": 1.0, "capsize": 2.5}
    axes.errorbar(x, y, xerr=across, yerr=up, fmt="o", **style)
    for name, right, high in zip(names, x, y):
        position = (6, -13 if below else 5)
        axes.annotate(name, (right, high), position, textcoords="offset points")


TITLE = with_measure("Efficient frontier")
FRONTIER = Chapter("frontier", TITLE, FrontierSweep, measure, show, key="frontier")
