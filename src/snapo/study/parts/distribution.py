"""The distribution of every output's total over the paths of the evaluation."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from snapo.solver import statistics

from ..study import Part, StudyRun

BINS = 60
QUANTILES = {"p01": 0.01, "p05": 0.05, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p95": 0.95,
             "p99": 0.99}  # fmt: skip
TAIL = 0.05  # the mean of this worst (smallest) share is given as well


def distribution_part(units: Mapping[str, str]) -> Part:
    """A part that gives "distribution", a list with one entry per output.

    `units`: by name of an output.
    """
    return Part("distribution", _work(units), needs=("training",))


def _work(units: Mapping[str, str]) -> Callable[[StudyRun], dict[str, Any]]:
    def work(run: StudyRun) -> dict[str, Any]:
        totals = run.solution.totals
        paths = np.arange(run.solution.paths["evaluate"])
        groups = run.setup.problem.sources.evaluation.groups(paths)
        return {
            "distribution": [
                {"name": name, "unit": units.get(name, ""), **described(np.asarray(total), groups)}
                for name, total in totals.items()
            ]
        }

    return work


def described(total: np.ndarray, groups: np.ndarray | None = None) -> dict[str, Any]:
    """Moments, quantiles and a histogram of totals [paths] that are finite, with standard errors.

    `groups`: the independent group of each path, by default the path itself.
    """
    good = np.isfinite(total)
    groups = np.arange(total.size) if groups is None else groups
    total, groups = total[good], groups[good]
    if not total.size:
        return {"paths": 0}
    # The outermost paths would only stretch the histogram.
    low, high = np.quantile(total, [0.0005, 0.9995])
    edges = np.linspace(low, high, BINS + 1) if high > low else np.array([low - 0.5, low + 0.5])
    counts, _ = np.histogram(np.clip(total, edges[0], edges[-1]), edges)
    tail = np.sort(total)[: max(1, round(TAIL * total.size))]
    return {
        "paths": total.size,
        "mean": total.mean(),
        "standard_deviation": total.std(ddof=1) if total.size > 1 else 0.0,
        "standard_error": statistics.mean(total, groups).standard_error,
        "tail_mean": tail.mean(),
        "tail_error": statistics.tail(total, 1 - TAIL, groups).standard_error,
        "quantiles": dict(zip(QUANTILES, np.quantile(total, list(QUANTILES.values())))),
        "quantile_errors": {
            name: statistics.quantile(total, level, groups).standard_error
            for name, level in QUANTILES.items()
        },
        "edges": edges,
        "counts": counts,
    }
