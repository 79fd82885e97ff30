"""Methods side by side: values one contract on the same paths by every available method.

    snapo solve --ladder

A lower bound never exceeds an upper bound. If two methods are in the wrong order by three standard
errors, one of them is wrong, and the run prints a warning.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from snapo.engine import TRAJECTORY, Rollout
from snapo.problem.noise import Draws
from snapo.problem.scenarios import EVALUATE, Pseudo, stream
from snapo.problem.smooth import Exact
from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Text
from snapo.report.quantity import number
from snapo.report.rows import Bar, Column, WithError, ladder, table
from snapo.solver import statistics
from snapo.solver.adjoint import float64

from ..chapter import Chapter, Number
from ..study import StudyRun

PATHS, CHUNK = 1024, 1024
SHARED = 258  # stream: of the paths that all methods share
BY_DAY, IN_PRODUCTS = "Intrinsic by day", "Intrinsic in products"
ROLLING, LEAST_SQUARES = "Rolling intrinsic", "Least-squares Monte Carlo"
POLICY, LATTICE, UPPER, FORESIGHT = "Trained policy", "Lattice", "Upper bound", "Perfect foresight"
NAMES = (
    BY_DAY, IN_PRODUCTS, ROLLING, LEAST_SQUARES, POLICY, LATTICE, UPPER, FORESIGHT,
)  # fmt: skip
# (at most, at least): the first is no larger than the second.
ORDERED = (
    (IN_PRODUCTS, BY_DAY), (IN_PRODUCTS, ROLLING), (BY_DAY, LEAST_SQUARES), (BY_DAY, POLICY),
    (BY_DAY, LATTICE), (ROLLING, LATTICE), (ROLLING, UPPER), (LEAST_SQUARES, LATTICE),
    (LEAST_SQUARES, UPPER), (POLICY, LATTICE), (POLICY, UPPER), (LATTICE, UPPER),
    (UPPER, FORESIGHT),
)  # fmt: skip
ERRORS = 3.0  # by which a wrong order is one
ROUNDING = 1e-5  # of the largest value: of methods without sampling


@dataclass(frozen=True)
class MethodRow:
    """The value by one method.

    - `standard_error`: the standard error of sampling, or the change of the value at the last
      refinement of a grid; None for an exact value.
    - `seconds`: the time of the method. `share`: the position between the intrinsic value by day
      (0) and the value of the lattice or, without a lattice, of the policy (1).
    - `difference`: the difference from the trained policy, on the same paths.
    """

    method: str
    value: Number = np.nan
    standard_error: float | None = None
    seconds: Number = np.nan
    share: float | None = None
    difference: float | None = None
    difference_error: float | None = None
    note: str = ""


@dataclass(frozen=True)
class MissingMethod:
    """A method that has no value for this contract, with the reason."""

    method: str
    reason: str


@dataclass(frozen=True)
class MethodLadder:
    """All methods on `paths` common paths; `warnings`: pairs in the wrong order."""

    methods: tuple[MethodRow, ...] = ()
    missing: tuple[MissingMethod, ...] = ()
    warnings: tuple[str, ...] = ()
    paths: int = 0


class Estimated(NamedTuple):
    """A value of all paths, and its error."""

    value: float
    error: float | None = None


class ValuationMethod(NamedTuple):
    """A method: its name, its meaning, and a function that returns values by path [N] or one value.
    The function raises `ValueError` with the reason if there is no value.
    """

    name: str
    note: str
    compute: Callable[[], np.ndarray | Estimated]


@dataclass(frozen=True, eq=False)
class CommonPaths:
    """Paths of the trained policy: (draws, rollout) by block; `earned` [N]: the earnings of the
    paths, in their order."""

    rollouts: Sequence[tuple[Draws, Rollout]]
    earned: np.ndarray
    groups: np.ndarray

    def joined(self, of: Callable[[Draws, Rollout], np.ndarray]) -> np.ndarray:
        """Applies a function to every block and joins the results, [..., N]."""
        return np.concatenate([of(*rollout) for rollout in self.rollouts], axis=-1)


def common_paths(run: StudyRun, paths: int = PATHS) -> CommonPaths:
    """Fresh paths, if they can be drawn, with the trajectory of the policy."""
    setup, policy = run.setup, run.solution.policy
    problem = setup.problem
    if policy is None:
        raise ValueError("the run has no policy")
    source = problem.sources.evaluation
    if problem.is_random and isinstance(problem.sources.training, Pseudo):
        source = Pseudo(setup.training.seed, stream=stream(EVALUATE, SHARED))
    paths, engine = source.available(paths), setup.engines.evaluate.bind(problem)
    blocks = list(source.blocks(paths, max(1, -(-paths // CHUNK))))
    rollouts = []
    for block in blocks:
        draws = source.draws(block, problem.simulator)
        rollouts.append((draws, engine.values(policy, draws, Exact(), record=TRAJECTORY)))
    earned = [problem.objective.influence(float64(rollout.totals)) for _, rollout in rollouts]
    return CommonPaths(rollouts, np.concatenate(earned), source.groups(np.concatenate(blocks)))


def side_by_side(
    run: StudyRun, paths: CommonPaths, methods: Sequence[ValuationMethod]
) -> MethodLadder:
    """Values the contract by all methods, one after another; writes ladder.csv."""
    values, seconds, missing = {}, {}, []
    for method in methods:
        began = time.perf_counter()
        try:
            values[method.name] = method.compute()
        except ValueError as reason:
            missing.append(MissingMethod(method.name, str(reason)))
            continue
        seconds[method.name] = time.perf_counter() - began
        value, error = _estimated(values[method.name], paths.groups)
        run.progress(f"{method.name}: {statistics.with_error(value, error or 0.0)}")
    listed = sorted(methods, key=lambda method: NAMES.index(method.name))
    rows = tuple(
        _row(method, values, seconds[method.name], paths.groups)
        for method in listed
        if method.name in values
    )
    run.write_records("ladder.csv", MethodRow, rows)
    warnings = tuple(_wrong_order(values, paths.groups))
    for warning in warnings:
        run.progress(f"warning: {warning}")
    return MethodLadder(rows, tuple(missing), warnings, len(paths.earned))


ByMethod = dict[str, np.ndarray | Estimated]


def _estimated(value: np.ndarray | Estimated, groups: np.ndarray) -> Estimated:
    if isinstance(value, Estimated):
        return value
    sampled = statistics.mean(value, groups)
    return Estimated(sampled.value, sampled.standard_error)


def _difference(one: Any, other: Any, groups: np.ndarray) -> Estimated:
    """One value minus the other, path by path if both have paths."""
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return _estimated(one - other, groups)
    (a, error_a), (b, error_b) = (_estimated(x, groups) for x in (one, other))
    return Estimated(a - b, float(np.hypot(error_a or 0.0, error_b or 0.0)))


def _row(
    method: ValuationMethod, values: ByMethod, seconds: float, groups: np.ndarray
) -> MethodRow:
    value, error = _estimated(values[method.name], groups)
    share = difference = of_difference = None
    top = values.get(LATTICE, values.get(POLICY))
    if BY_DAY in values and top is not None:
        low, high = (_estimated(x, groups).value for x in (values[BY_DAY], top))
        share = (value - low) / (high - low) if high > low else None
    if POLICY in values and method.name != POLICY:
        difference, of_difference = _difference(values[method.name], values[POLICY], groups)
    about = seconds, share, difference, of_difference, method.note
    return MethodRow(method.name, value, error, *about)


def _wrong_order(values: ByMethod, groups: np.ndarray):
    size = max((abs(_estimated(value, groups).value) for value in values.values()), default=0.0)
    for low, high in ORDERED:
        if low in values and high in values:
            excess = _difference(values[low], values[high], groups)
            if excess.value > ERRORS * (excess.error or 0.0) + ROUNDING * size:
                more = statistics.with_error(excess.value, excess.error or 0.0)
                yield f"{low} is above {high.lower()} by {more}, although it should be below"


def show(run: RunFiles, result: MethodLadder) -> Sequence[Block]:
    """Shows a ladder chart, a table, and the order of the methods."""
    rows = result.methods
    if not rows:
        return [why_missing(run, METHODS.name)]
    bars = [Bar(x.method, x.value, x.standard_error, strong=x.method == POLICY) for x in rows]
    columns = [
        Column("Method", "method"),
        Column("Meaning", "note"),
        Column("Value", lambda row: WithError(row.value, row.standard_error), run.unit, digits=6),
        Column("Share of extrinsic value", _percent, "%", decimal_places=1),
        Column(
            "Minus the policy",
            lambda row: WithError(row.difference, row.difference_error),
            run.unit,
            sign=True,
        ),
        Column("Time", "seconds", "s", digits=3),
    ]
    caption = (
        f"The same contract by every method, on {number(result.paths, 0)} common paths; whiskers "
        "are 95 % intervals."
    )
    blocks: list[Block] = [ladder("methods-ladder", bars, caption), table(rows, columns)]
    right = "All methods are in the right order: no lower bound is above an upper bound."
    blocks += [Text(f"Warning: {x}.") for x in result.warnings] or [Text(right)]
    return blocks + [Text(f"{x.method}: no value, because {x.reason}.") for x in result.missing]


def _percent(row: MethodRow) -> float | None:
    return None if row.share is None else 100 * row.share


def _unmeasured(run: StudyRun) -> MethodLadder:
    raise ValueError("this kind of case has no other methods")


METHODS = Chapter(
    "methods", "Methods side by side", MethodLadder, _unmeasured, show, short="By method",
    key="methods", optional=True,
)  # fmt: skip
