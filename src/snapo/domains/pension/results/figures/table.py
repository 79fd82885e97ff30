"""The model's own figures beside those of the actuary, before any simulation."""

from typing import Any

import numpy as np

from snapo.problem.inputs import plain
from snapo.study.study import StudyRun

from ...records.case import PensionCase
from ...records.inputs import pension_inputs
from ...regulation.bases import bases
from ...regulation.stand import stand
from ..setup import case_of
from .in_words import in_words
from .lines import examine
from .reconcile import BASIS_POINT, Figures


def work(run: StudyRun) -> dict[str, Any]:
    """ "reconciliation" with lines, figures, remarks, the plan in words and yearly payments;
    "liability", "funding" today."""
    case = case_of(run)
    examined, each = examine(case), round(1 / case.step)
    found, seen = examined.figures, examined.human
    flow = np.asarray(found.cash_flow)
    whole = len(flow) // each * each
    table = {
        "lines": [line._asdict() for line in examined.lines],
        "remarks": examined.remarks,
        "in_words": in_words(case),
        "liability": found.liability,
        "duration": found.duration,
        "convexity": found.convexity,
        "inflation01": found.inflation01,
        "asset_duration": seen.asset_duration,
        "hedge_ratio": seen.hedge_ratio,
        "inflation_hedge_ratio": seen.inflation_hedge_ratio,
        "rate_volatility": seen.rate_volatility,
        "returns": seen.returns,
        "key_rate_durations": _key_rate_durations(case, found),
        "cash_flow": flow[:whole].reshape(-1, each).sum(1),
    }
    if case.regulation is not None:
        asked = stand(case, plain(pension_inputs(case)))
        rules = case.regulation.rules
        told = asked._asdict() | {"losses": asked.losses._asdict()}
        table["regulation"] = told | {"since": rules.since, "source": rules.source}
    if case.funding is not None:
        sides = bases(case, plain(pension_inputs(case)))
        table["funding"] = {
            "bases": [each._asdict() for each in sides.bases],
            "recovery": sides.recovery._asdict(),
            "mature": sides.mature,
            "since": case.funding.since,
            "source": case.funding.source,
        }
    return {"reconciliation": table, "liability": found.liability, "funding": seen.funding}


def _key_rate_durations(case: PensionCase, found: Figures) -> dict[str, Any]:
    """Years at each node of the curve: minus d ln L / d quote; they add up to the duration."""
    if not found.liability:
        return {}
    years = -found.key_rate / BASIS_POINT / found.liability
    return {"label": list(case.curve.rate.labels), "years": years}
