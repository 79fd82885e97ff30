"""Personal pots: each cohort's pension at the horizon, its changes, and the solidarity reserve."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from snapo.engine import TRAJECTORY
from snapo.problem.smooth import Exact
from snapo.report.page import Block, Facts, Table, Text
from snapo.report.quantity import number
from snapo.study.chapter import Chapter, Floats, Number
from snapo.study.study import StudyRun

from ..pots.schedule import pots_of
from ..records.case import PensionCase
from ..records.pots import pensions
from ..results.setup import case_of
from ..run import PensionRun, points, share, with_measure

PATHS = 4096
QUANTILES = (0.05, 0.5, 0.95)
TINY = 1e-9  # of a pension: less is none
SMALL = 1e-6  # of a pension: a fall by less is round-off
CAVEAT = (
    "Pensions are nominal amounts per member and year under the learned policy. The assets minus "
    "the reserve are divided among the pots of today by the value of each cohort's accrued "
    "rights. A pot earns the return of its annuity (on the path's curve) on its protected share "
    "and the return of cash on the rest; the reserve earns the return of cash. All other return "
    "is excess return, and is shared by exposure. “Cut” is the share of years of payment in "
    "which the pension falls, and “Mean cut” is the mean fall in these years."
)


@dataclass(frozen=True)
class CohortPension:
    """A cohort under the trained policy, on the first paths of the evaluation, in nominal terms.

    - `pot`: money. `earned`, `pension`: the yearly pension of a member, as earned, and with the
      pots of today; `horizon`: quantiles of the pension at the horizon.
    - `of_salary`: the median of this pension as a share of today's salary, for active members.
    - `volatility`: the volatility of the yearly changes of the pension; `cut`: the probability that
      it falls in a year of payment, and `fall`: the mean fall in such years; None if there is no
      year of payment.
    """

    name: str
    pot: Number
    earned: Number
    pension: Number
    horizon: tuple[Number, ...]
    of_salary: float | None
    volatility: Number
    cut: float | None
    fall: float | None


@dataclass(frozen=True)
class PotsOutcome:
    """The cohorts, and the reserve as a share of all assets, at the starts of `years`.

    - `reserve` [years, quantiles]: the reserve; `level`: pensions of today divided by those earned.
    - `filled`, `released`: money paid into the reserve from excess return, and out of it, in total
      over the horizon; means over the paths.
    - `since`, `source`: date and source of the rules.
    """

    cohorts: tuple[CohortPension, ...]
    years: Floats
    reserve: Floats
    quantiles: tuple[float, ...]
    level: Number
    filled: Number
    released: Number
    since: str
    source: str


def measure(run: StudyRun) -> PotsOutcome:
    """A row for each cohort, the reserve by year, and the rules in force."""
    case, setup = case_of(run), run.setup
    terms = setup.problem.schedule.constants
    level, reserve = _recorded(run)
    start, totals = float(terms.level), run.solution.totals
    last = np.stack([np.asarray(totals[name]) for name in pensions(case.members)], -1) * start
    steps = round(1 / case.step)
    years = np.concatenate([level[::steps], last[None, : level.shape[1]]])
    drawing = np.asarray(setup.problem.schedule.steps.drawing)[steps - 1 :: steps] > 0
    rules = pots_of(case).rules
    return PotsOutcome(
        cohorts=_cohorts(case, years, last, drawing, terms),
        years=np.arange(len(reserve[::steps])) * steps * case.step,
        reserve=np.quantile(reserve[::steps], QUANTILES, axis=1).T,
        quantiles=QUANTILES,
        level=start,
        filled=float(np.mean(totals["filled"])),
        released=float(np.mean(totals["released"])),
        since=rules.since,
        source=rules.source,
    )


def _recorded(run: StudyRun) -> tuple[np.ndarray, np.ndarray]:
    """Levels of pensions [T, N, C], and the reserve as a share of the assets [T, N]."""
    setup = run.setup
    problem, bound = setup.problem, setup.engines.evaluate.bind(setup.problem)
    source, levels, shares = problem.sources.evaluation, [], []
    paths = source.available(min(PATHS, setup.evaluation.paths))
    for block in source.blocks(paths, max(8, paths // 1024)):
        draws = source.draws(block, problem.simulator)
        # The whole trajectory, whose program the certificate has compiled or will use again.
        rollout = bound.values(run.solution.policy, draws, Exact(), record=TRAJECTORY)
        state = rollout.record["state"]
        levels.append(np.asarray(state.level))
        shares.append(np.asarray(state.reserve) / np.asarray(state.fund.assets))
    return np.concatenate(levels, 1), np.concatenate(shares, 1)


def _cohorts(case: PensionCase, years, last, drawing, terms) -> tuple[CohortPension, ...]:
    """The rows, from levels at the starts of years and the end `years` [Y + 1, N, C], at the end on
    all paths `last` [N', C], and whether pensions are in payment at the ends of years [Y, C]."""
    members = case.members
    assert members is not None
    earned = members.pension.used()
    salary = np.where(members.salary.index >= 0, members.salary.used(), 0.0)
    active = members.status == 0
    change = np.log(np.maximum(years[1:], TINY) / np.maximum(years[:-1], TINY))
    rows = []
    for i, name in enumerate(members.names):
        paid = drawing[: len(change), i]
        moves = change[paid, :, i].ravel() if paid.any() else np.zeros(0)
        falls = moves[moves < -SMALL]
        middle = float(np.median(last[:, i]))
        rows.append(
            CohortPension(
                name,
                pot=float(terms.pots[i]),
                earned=float(earned[i]),
                pension=float(earned[i] * terms.level),
                horizon=tuple((earned[i] * np.quantile(last[:, i], QUANTILES)).tolist()),
                of_salary=middle * float(earned[i] / salary[i]) if active[i] else None,
                volatility=float(change[:, :, i].std()),
                cut=float(falls.size / moves.size) if moves.size else None,
                fall=float(-np.expm1(falls).mean()) if falls.size else None,
            )
        )
    return tuple(rows)


def show(run: PensionRun, result: PotsOutcome) -> Sequence[Block]:
    """The pots of today, the pensions of the cohorts and the reserve."""
    reserve = result.reserve[:, 1]
    facts = [
        ("Pension today divided by the accrued pension", share(result.level), "pots over "
            "values of annuities"),
        ("Solidarity reserve", share(reserve[0]),
         f"median {share(reserve[-1])} one year before the horizon"),
        ("Into the reserve", run.large(result.filled), "mean total, from excess return"),
        ("Out of the reserve", run.large(result.released), "mean total, to restore pensions"),
    ]  # fmt: skip
    source = f"Rules from {result.since}: {result.source}."
    blocks: list[Block] = [Facts(facts), _pensions(run, result)]
    if len(result.reserve) > 1:
        blocks.append(_reserve(result))
    return [*blocks, Text(CAVEAT, True), Text(source, True)]


def _pensions(run: PensionRun, result: PotsOutcome) -> Table:
    head = [("Cohort", ""), ("Pot", ""), ("Earned", run.currency), ("Today", run.currency)]
    head += [(f"{round(100 * q)} %", run.currency) for q in result.quantiles]
    head += [("Of salary", "%"), ("Volatility", "points"), ("Cut", "%"), ("Mean cut", "%")]
    rows = [
        (
            x.name,
            run.large(x.pot),
            *(number(pension, 0) for pension in (x.earned, x.pension, *x.horizon)),
            *(points(share, 1) for share in (x.of_salary, x.volatility, x.cut, x.fall)),
        )
        for x in result.cohorts
    ]
    return Table(head, rows, f"Pension of each member {run.horizon}, by cohort", 1)


def _reserve(result: PotsOutcome) -> Table:
    head = [("Year", ""), *((f"{round(100 * q)} %", "%") for q in result.quantiles)]
    body = [
        (number(year, 0), *(points(value, 1) for value in row))
        for year, row in zip(result.years, result.reserve)
    ]
    return Table(head, body, "The reserve as a share of all assets, at the starts of years", 1)


POTS = Chapter("pots", with_measure("Personal pots"), PotsOutcome, measure, show, key="pots")
