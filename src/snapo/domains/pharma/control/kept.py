"""The attributes under a policy and their limits, as the live page shows them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from snapo.problem.chain import Chain
from snapo.study.study import Measured, Shown

from ..flowsheet.case import PharmaCase
from ..quality.limits import Limits
from ..results.moved import limits
from .stages import Stage

COLUMNS = (
    ("attribute", ""), ("limits", ""), ("mean of batches", ""), ("standard deviation", ""),
    ("within limits", "%"), ("± standard error", "%"),
)  # fmt: skip


def case_of(simulator: Any) -> PharmaCase:
    """The case of a loop's simulator."""
    stage = simulator.stages[0] if isinstance(simulator, Chain) else simulator
    assert isinstance(stage, Stage)
    return stage.case


def kept_limits(found: Measured) -> Sequence[Shown]:
    """Every attribute with its limits, and how often batches keep them under the policy."""
    case = case_of(found.setup.problem.simulator)
    names = [f"attribute.{each.name}" for each in case.attributes]
    values = np.stack([np.asarray(found.totals[name], np.float64) for name in names], -1)
    holds = Limits.of(case).hold(values)
    rows = []
    for i, each in enumerate(case.attributes):
        share, error = found.mean(holds[:, i])
        mean, spread = values[:, i].mean(), values[:, i].std(ddof=1)
        bounds = limits(each.low, each.high, each.unit)
        rows.append((each.name, bounds, mean, spread, 100 * share, 100 * error))
    share, error = found.mean(found.totals["success"])
    words = f"{100 * share:.4g} % ± {100 * error:.2g} % of batches keep all limits"
    return [Shown("Attributes and their limits", COLUMNS, rows, words)]
