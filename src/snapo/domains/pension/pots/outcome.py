"""Pensions of the cohorts of a fund of pots at the horizon, their changes, and the reserve."""

from typing import Any

import numpy as np

from snapo.engine import COURSE
from snapo.problem.smooth import Exact
from snapo.study.study import StudyRun

from ..records.case import PensionCase
from ..results.setup import case_of
from .outputs import pensions
from .schedule import known

PATHS = 4096
QUANTILES = (0.05, 0.5, 0.95)
TINY = 1e-9  # of a pension: less is none
SMALL = 1e-6  # of a pension: a fall by less is round-off


def work(run: StudyRun) -> dict[str, Any]:
    """ "pots": a row for each cohort, the reserve by year, and the law.

    Of a cohort: "pension" each member's and year's as earned, with the pots of today, and in
    quantiles at the horizon; "of_salary" the median as a share of today's salary; "volatility" of
    its yearly changes; "cut" the probability that it falls in a year of payment, "fall" by how much
    then in the mean. All nominal, with the trained policy on the first paths of the evaluation.
    """
    case, setup = case_of(run), run.setup
    terms = setup.problem.schedule.constants
    level, share = _recorded(run)
    start, totals = float(terms.level), run.solution.totals
    last = np.stack([np.asarray(totals[name]) for name in pensions(case.members)], -1) * start
    each = round(1 / case.step)
    years = np.concatenate([level[::each], last[None, : level.shape[1]]])
    drawing = np.asarray(setup.problem.schedule.steps.drawing)[each - 1 :: each] > 0
    rules = known(case).rules
    return {
        "pots": {
            "cohorts": _cohorts(case, years, last, drawing, terms),
            "years": (np.arange(len(share[::each])) * each * case.step).tolist(),
            "reserve": np.quantile(share[::each], QUANTILES, axis=1).T,
            "quantiles": QUANTILES,
            "level": start,
            "filled": float(np.mean(totals["filled"])),
            "released": float(np.mean(totals["released"])),
            "since": rules.since,
            "source": rules.source,
        }
    }


def _recorded(run: StudyRun) -> tuple[np.ndarray, np.ndarray]:
    """Levels of pensions [T, N, C], and the reserve as a share of the assets [T, N]."""
    setup = run.setup
    problem, bound = setup.problem, setup.engines.evaluate.bind(setup.problem)
    source, levels, shares = problem.sources.evaluation, [], []
    paths = source.available(min(PATHS, setup.evaluation.paths))
    for block in source.blocks(paths, max(8, paths // 1024)):
        draws = source.draws(block, problem.simulator)
        # All of the course, whose program the certificate has compiled or will use again.
        rolled = bound.values(run.solution.policy, draws, Exact(), record=COURSE)
        state = rolled.record["state"]
        levels.append(np.asarray(state.level))
        shares.append(np.asarray(state.reserve) / np.asarray(state.fund.assets))
    return np.concatenate(levels, 1), np.concatenate(shares, 1)


def _cohorts(case: PensionCase, years, last, drawing, terms) -> list[dict[str, Any]]:
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
            {
                "name": name,
                "pot": float(terms.pots[i]),
                "earned": float(earned[i]),
                "pension": float(earned[i] * terms.level),
                "horizon": (earned[i] * np.quantile(last[:, i], QUANTILES)).tolist(),
                "of_salary": middle * float(earned[i] / salary[i]) if active[i] else None,
                "volatility": float(change[:, :, i].std()),
                "cut": float(falls.size / moves.size) if moves.size else None,
                "fall": float(-np.expm1(falls).mean()) if falls.size else None,
            }
        )
    return rows
