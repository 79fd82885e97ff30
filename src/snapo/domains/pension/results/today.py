"""The balance sheet today and after the policy's first decision: trades, key rates, collateral."""

from dataclasses import replace
from typing import Any

import numpy as np

from snapo.problem.inputs import plain
from snapo.study.study import StudyRun

from ..fund.swap_limits import limit_unit, notionals
from ..records.case import PensionCase
from . import balance
from .figures.reconcile import figures
from .setup import case_of


def work(run: StudyRun) -> dict[str, Any]:
    """ "trades", "ladder" now and "ladder_after" them, the same of inflation, "collateral"."""
    case, inputs = case_of(run), plain(run.setup.problem.inputs)
    weights, places = (np.array(run.get(f"first_decision.{k}")) for k in ("weights", "overlay"))
    values, found = limit_unit(case), figures(case, inputs)
    wanted = notionals(case, places, values)
    now = np.zeros(0) if case.overlay is None else case.overlay.notional.used()
    after = _rebalanced(case, weights)
    return {
        "trades": balance.trades(case, weights, places, values),
        "ladder": balance.ladder(case, inputs, found, now),
        "ladder_after": balance.ladder(after, inputs, found, wanted),
        "inflation_ladder": balance.inflation_ladder(case, inputs, found, now),
        "inflation_ladder_after": balance.inflation_ladder(after, inputs, found, wanted),
        "collateral": {
            "now": balance.headroom(case, case.assets.weight.used(), now),
            "after": balance.headroom(case, weights, wanted),
        },
    }


def _rebalanced(case: PensionCase, weights: np.ndarray) -> PensionCase:
    given = replace(case.assets.weight, values=np.asarray(weights, np.float64))
    return replace(case, assets=replace(case.assets, weight=given))
