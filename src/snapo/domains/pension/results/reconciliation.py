"""The model's own figures beside those of the actuary, before any simulation."""

from typing import Any

import numpy as np

from snapo.problem.inputs import plain
from snapo.study.study import StudyRun

from ..records.case import PensionCase
from ..records.inputs import pension_inputs
from .check import reconciled
from .reconcile import BASIS_POINT, Figures, figures
from .setup import case_of


def work(run: StudyRun) -> dict[str, Any]:
    """ "reconciliation" with lines, figures and yearly payments; "liability", "funding" today."""
    case = case_of(run)
    found, each = figures(case, plain(pension_inputs(case))), round(1 / case.step)
    flow = np.asarray(found.cash_flow)
    whole = len(flow) // each * each
    table = {
        "lines": [line._asdict() for line in reconciled(case)],
        "liability": found.liability,
        "duration": found.duration,
        "convexity": found.convexity,
        "inflation01": found.inflation01,
        "key_rate_durations": _key_rate_durations(case, found),
        "cash_flow": flow[:whole].reshape(-1, each).sum(1),
    }
    funding = float(case.assets.amount.used()) / found.liability if found.liability else None
    return {"reconciliation": table, "liability": found.liability, "funding": funding}


def _key_rate_durations(case: PensionCase, found: Figures) -> dict[str, Any]:
    """Years at each node of the curve: minus d ln L / d quote; they add up to the duration."""
    if not found.liability:
        return {}
    years = -found.key_rate / BASIS_POINT / found.liability
    return {"label": list(case.curve.rate.labels), "years": years}
