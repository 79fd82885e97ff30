"""Trainings of one case with several seeds, compared on common paths that nothing else has seen."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.problem import Problem
from snapo.problem.scenarios import EVALUATE, Pseudo, Scenarios, Sobol, stream
from snapo.solver import statistics
from snapo.solver.checkpoint import CheckpointError
from snapo.solver.evaluate import estimate, path_totals, value_of_groups
from snapo.solver.solution import Solution

from ..study import Setup, Study

STREAM = 0x5EED  # of the evaluation's scenarios: those on which seeds are compared


class Trained(NamedTuple):
    """One seed: its study, and what result.json says of its training."""

    seed: int
    study: Study
    folder: Any
    result: Mapping[str, Any]


class SeedRow(NamedTuple):
    """One seed in the table.

    - `value`, `standard_error`: on the paths that all seeds share; None where training failed.
    - `below_best`, `below_best_error`: the difference to the best, paired path by path.
    - `within`: whether all limits of the problem are met, or nearly, on the run's own paths.
    """

    seed: int
    value: float | None
    standard_error: float | None
    below_best: float | None
    below_best_error: float | None
    within: bool
    status: str
    convergence: str
    seconds: float
    run: str


class SeedComparison(NamedTuple):
    """All seeds side by side.

    - `best`: the seed with the highest value, of those within their limits where some are.
    - `mean`, `worst`, `highest`, `deviation`: of the values; `standard_error`: the Monte Carlo
      error of their mean, which all of them share.
    - `fresh`: whether the paths serve for nothing else; `paths`: how many there are.
    """

    rows: tuple[SeedRow, ...]
    best: int
    mean: float
    worst: float
    highest: float
    deviation: float
    standard_error: float
    fresh: bool
    paths: int

    def table(self) -> dict[str, Any]:
        """As plain data."""
        return self._asdict() | {"rows": [row._asdict() for row in self.rows]}


def compared(trained: Sequence[Trained]) -> SeedComparison:
    """The policies of all seeds on common paths: of the first one's problem."""
    setup = _setup(trained[0].study)
    problem, fresh = _measured_on_others(setup)
    results = [_shares(problem, setup, item) for item in trained]
    means = [np.mean(entry) if entry is not None else np.nan for entry in results]
    values = np.array(means, np.float64)
    within = [_within(value.result) for value in trained]
    best = _best(values, within)
    rows = tuple(
        _row(each, shares, results[best], ok) for each, shares, ok in zip(trained, results, within)
    )
    available = [result for result in results if result is not None and np.isfinite(result).all()]
    selected = values[np.isfinite(values)]
    error = statistics.of_shares(np.mean(available, axis=0)).standard_error if available else np.nan
    endpoints = (np.mean, np.min, np.max)
    mean, worst, highest = (
        float(endpoint(selected)) if selected.size else np.nan for endpoint in endpoints
    )
    return SeedComparison(
        rows,
        trained[best].seed,
        mean,
        worst,
        highest,
        float(selected.std(ddof=1)) if selected.size > 1 else np.nan,
        float(error),
        fresh,
        problem.sources.evaluation.available(setup.evaluation.paths),
    )


def _setup(study: Study) -> Setup:
    assert study.setup is not None
    return study.setup()


def _measured_on_others(setup: Setup) -> tuple[Problem, bool]:
    """The problem on scenarios of its own for the comparison, where they can be drawn."""
    problem, sources = setup.problem, setup.problem.sources
    others: Scenarios = sources.evaluation
    fresh = isinstance(others, Pseudo | Sobol)
    if fresh:
        others = Pseudo(setup.training.seed, stream=stream(EVALUATE, STREAM))
    problem = replace(problem, sources=replace(sources, evaluation=others))
    return problem.prepared(setup.problem.schedule), fresh


def _shares(problem: Problem, setup: Setup, item: Trained) -> np.ndarray | None:
    """What independent groups of paths are worth to a seed's policy; None where it has none."""
    try:
        policy = Solution.load(item.folder, like=_setup(item.study).policy).policy
    except CheckpointError:
        return None
    paths, engine = setup.evaluation.paths, setup.engines.evaluate
    totals = path_totals(problem, policy, paths, engine=engine)  # pyright: ignore
    source, controls = problem.sources.evaluation, problem.simulator.control_variates()
    value = estimate(problem.objective, totals, source, controls).value
    shares = value_of_groups(problem.objective, totals, source, controls)
    return shares if np.isfinite(value) else np.full_like(shares, np.nan)


def _within(result: Mapping[str, Any]) -> bool:
    return all(item.get("met") != "not met" for item in result.get("limits") or ())


def _best(values: np.ndarray, within: Sequence[bool]) -> int:
    """The number of the best: a policy that breaks a limit is worth more than one that may not."""
    allowed = np.array(within) if any(within) else np.full(len(values), True)
    ranked = np.where(allowed & np.isfinite(values), values, -np.inf)
    return int(np.argmax(ranked))


def _row(
    item: Trained, shares: np.ndarray | None, best: np.ndarray | None, within: bool
) -> SeedRow:
    available = None if shares is None else statistics.of_shares(shares)
    behind = None if shares is None or best is None else statistics.of_shares(best - shares)
    result = item.result
    return SeedRow(
        item.seed,
        available and available.value,
        available and available.standard_error,
        behind and behind.value,
        behind and behind.standard_error,
        within,
        str(result.get("status", "")),
        str(result.get("convergence", "")),
        float((result.get("seconds") or {}).get("total", 0.0)),
        f"seeds/{item.seed}",
    )


def describe(result: Mapping[str, Any]) -> str:
    """What choosing the best of several does to the value that is reported."""
    from snapo.report.quantity import decimals, finite, number

    rows, best = result["rows"], result["best"]
    sizes = [finite(result[name]) for name in ("deviation", "standard_error")]
    digits = max(0, decimals([size for size in sizes if size] or [result["mean"]], 2))
    endpoints = [number(result[name], digits) for name in ("worst", "highest", "mean")]
    text = (
        f"Best of {len(rows)} seeds: {best}. On {result['paths']:,} common paths their values lie "
        f"between {endpoints[0]} and {endpoints[1]}, with the mean {endpoints[2]}"
    )
    if sizes[0] is not None and sizes[1] is not None:
        text += (
            f" and the standard deviation {number(sizes[0], digits)} between seeds, beside a "
            f"Monte Carlo error of {number(sizes[1], digits)} that all share"
        )
    if result["standard_error"] == 0:  # nothing is random
        return f"{text}."
    if result["fresh"]:
        return f"{text}. The value of this run is on other paths, which that choice has not seen."
    return (
        f"{text}. There are no other paths than those of the value, so that it is that of the best "
        "of several on the same paths, and a little high."
    )
