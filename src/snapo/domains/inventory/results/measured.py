"""Figures of the trained rule on the paths of the value, each with its standard error."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from snapo.solver import statistics
from snapo.study.study import StudyRun


def said(found: statistics.Sampled) -> dict[str, float]:
    """As rows of tables hold it."""
    return {"value": found.value, "standard_error": found.standard_error}


class Measured:
    """The totals of a run, and the independent groups of their paths."""

    def __init__(self, totals: Mapping[str, Any], groups: np.ndarray):
        self.totals, self.groups = totals, groups

    @classmethod
    def of(cls, run: StudyRun) -> "Measured":
        """Those of a run."""
        source = run.setup.problem.sources.evaluation
        groups = source.groups(np.arange(run.solution.paths["evaluate"]))
        return cls(run.solution.totals, groups)

    def mean(self, values: ArrayLike) -> dict[str, float]:
        return said(statistics.mean(np.asarray(values, np.float64), self.groups))

    def total(self, name: str) -> dict[str, float]:
        """The mean of an output."""
        return self.mean(self.totals[name])

    def ratio(self, top: str, bottom: str) -> dict[str, float]:
        """One output's mean over another's."""
        return said(statistics.ratio(self.totals[top], self.totals[bottom], self.groups))

    def service(self) -> dict[str, dict[str, float]]:
        """Fill rate (demand met from stock at once), of one item cycle service (replenishment
        cycles without unmet demand), periods without unmet demand, stock at the end of a period,
        demand of a period."""
        cycles = {}
        if "cycles" in self.totals:
            cycles["cycle_service"] = self.ratio("cycles_met", "cycles")
        return {
            "fill_rate": self.ratio("sold", "demand"),
            **cycles,
            "period_service": self.mean(1 - np.asarray(self.totals["short"], np.float64)),
            "stock": self.total("stock"),
            "demand": self.total("demand"),
        }
