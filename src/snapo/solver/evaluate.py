"""The value of a policy: path totals on fresh scenarios, and the value with its standard error.

`simulate` returns complete trajectories of a policy: states, decisions and outputs of every step.
"""

import math
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Engine, Rollout, Xla
from snapo.problem.code.version import reading_once
from snapo.problem.meant import takes_problem
from snapo.problem.objective import Objective, Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Scenarios
from snapo.problem.simulator import Simulator
from snapo.problem.smooth import EXACT, Exact, Smooth

from . import statistics
from .adjoint import DROPPED, finite, float64
from .tables import frame

DECIDED = ("action",)  # recorded where decisions are held fixed
MAX_BYTES = 2**28  # of decisions that are kept
NOISE_BYTES = 2**27  # of the noise of one call


class Value(NamedTuple):
    """An estimate, its standard error, and the share explained by control variates.

    - `control`: the share of the variance removed by control variates (0 without any).
    - `dropped`: the number of non-finite paths, which are left out.
    - `refused`: controls with a nonzero mean, which were not used.
    """

    value: float
    standard_error: float
    control: float = 0.0
    dropped: int = 0
    refused: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        """ "2,732 ± 21": two significant digits of half of the 95 % interval."""
        return statistics.with_error(self.value, statistics.half_width(self.standard_error))


@takes_problem
def evaluate(
    problem: Problem,
    policy: Policy,
    *,
    paths: int = 65536,
    smooth: Smooth | Exact = EXACT,
    engine: Engine | None = None,
) -> Value:
    """The objective of a policy on the problem's evaluation scenarios, with its standard error.

    **Arguments:**

    - `paths`: the number of paths. `smooth`: `Smooth(temperature)` for the simulator of training.
    - `engine`: by default XLA in float64.
    """
    totals = path_totals(problem, policy, paths, smooth=smooth, engine=engine)
    controls = problem.simulator.control_variates()
    return estimate(problem.objective, totals, problem.sources.evaluation, controls)


@reading_once()
def path_totals(
    problem: Problem,
    policy: Policy,
    paths: int,
    *,
    smooth: Smooth | Exact = EXACT,
    engine: Engine | None = None,
    source: Scenarios | None = None,
    controls: bool = True,
    before: Totals | None = None,
) -> dict[str, np.ndarray]:
    """{output: [paths]} in the order of the path numbers, computed in chunks of independent
    blocks. The scenarios are all available ones of `source`, by default those of the evaluation.
    `controls`: whether outputs that are only control variates are included. `before`: the totals
    on the first of these paths, which are not computed again.
    """
    bound = (engine or Xla(precision="float64")).bind(problem, controls=controls)
    source = source or problem.sources.evaluation
    paths = source.available(paths)
    totals: dict[str, np.ndarray] = {}
    first = 0
    for name, total in (before or {}).items():
        first = len(total)
        totals[name] = np.concatenate([total, np.full(paths - first, np.nan)])
    for block in chunks(source, paths, problem.simulator):
        block = block[block >= first]
        if block.size:
            draws = source.draws(block, problem.simulator)
            _keep(bound.values(policy, draws, smooth), block, paths, totals)
    return totals


@reading_once()
def totals_and_decisions(
    problem: Problem, policy: Policy, paths: int, first: int, *, engine: Engine
) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """`path_totals` of the exact simulator, and the decisions [T, first, A] on the first of these
    paths; None if they would take too much memory."""
    bound, source = engine.bind(problem), problem.sources.evaluation
    paths = source.available(paths)
    shape = problem.simulator.horizon, source.available(min(first, paths)), problem.action.size
    decisions = None
    if 0 < 8 * math.prod(shape) <= MAX_BYTES:
        # Paths are the last axis in memory, as in the kernel's.
        decisions = np.empty((shape[0], shape[2], shape[1])).swapaxes(1, 2)
    totals: dict[str, np.ndarray] = {}
    for block in chunks(source, paths, problem.simulator):
        local = block < (0 if decisions is None else shape[1])
        record = DECIDED if local.any() else ()
        draws = source.draws(block, problem.simulator)
        rollout = bound.values(policy, draws, Exact(), record=record)
        _keep(rollout, block, paths, totals)
        if decisions is not None and record:
            few = in_a_row(np.flatnonzero(local))
            decisions[:, in_a_row(block[local])] = np.asarray(rollout.record["action"])[:, few]
        del rollout  # or its memory is kept during the next call
    return totals, decisions


def _keep(rollout: Rollout, block: np.ndarray, paths: int, totals: dict[str, np.ndarray]) -> None:
    """Writes the totals of some paths into those of all."""
    for name, total in float64(rollout.totals).items():
        totals.setdefault(name, np.full(paths, np.nan))[block] = total


def in_a_row(numbers: np.ndarray) -> slice | np.ndarray:
    """Consecutive numbers as a slice, which copies nothing."""
    first, count = int(numbers[0]), len(numbers)
    follow = np.array_equal(numbers, np.arange(first, first + count))
    return slice(first, first + count) if follow else numbers


def chunks(source: Scenarios, paths: int, simulator: Simulator) -> list[np.ndarray]:
    """The path numbers of each call of an engine; fewer if paths are long and take more memory."""
    numbers = simulator.horizon * simulator.noise_size + simulator.initial_noise_size
    most = max(FEWEST, min(CHUNK, NOISE_BYTES // (8 * max(numbers, 1))))
    return source.blocks(paths, -(-paths // most))


def estimate(
    objective: Objective, totals: Totals, scenarios: Scenarios, controls: tuple[str, ...] = ()
) -> Value:
    """The objective on these totals, with the controls of known mean zero regressed out.

    Errors come from independent groups of paths (antithetic pairs, Sobol scrambles). Paths that
    are non-finite are left out and counted; more than a thousandth of them make the value NaN.
    """
    _, false, result = _controlled(objective, totals, scenarios, controls)
    plain = statistics.of_shares(shares_of(objective, totals, scenarios))
    used, explained = len(controls) - len(false), 0.0
    if used and plain.standard_error > 0:
        explained = 1 - (result.standard_error / plain.standard_error) ** 2
    dropped = int(np.sum(~finite(totals, objective.outputs)))
    return Value(result.value, result.standard_error, explained, dropped, false)


def value_of_groups(
    objective: Objective, totals: Totals, scenarios: Scenarios, controls: tuple[str, ...] = ()
) -> np.ndarray:
    """[groups]: the share of each independent group of paths in the objective, which is their mean.

    The coefficients of the control variates come from a regression on the groups' shares.
    """
    return _controlled(objective, totals, scenarios, controls)[0]


def finite_totals(objective: Objective, totals: Totals) -> dict[str, np.ndarray]:
    """The totals of the finite paths; none if too many are non-finite."""
    valid = finite(totals, objective.outputs)
    few = np.sum(~valid) <= DROPPED * valid.size
    return {name: np.asarray(total)[valid if few else []] for name, total in totals.items()}


def value_of(objective: Objective, totals: Totals) -> float:
    """The objective over the paths that are finite; NaN if too many are not."""
    left = finite_totals(objective, totals)
    return objective.value(left) if len(left[objective.outputs[0]]) else np.nan


def ruined(objective: Objective, totals: Totals) -> int:
    """The number of paths whose totals are finite, and whose value is minus infinity."""
    left = finite_totals(objective, totals)
    if not len(left[objective.outputs[0]]):
        return 0
    with np.errstate(invalid="ignore"):
        return int(np.sum(objective.influence(left) == -np.inf))


def _controlled(objective: Objective, totals: Totals, scenarios: Scenarios, controls):
    plain = shares_of(objective, totals, scenarios)
    taken = [of_groups(objective, totals, scenarios, totals[name]) for name in controls]
    left, false, result = statistics.controlled(plain, taken)
    return left, tuple(controls[i] for i in false), result


def shares_of(objective: Objective, totals: Totals, scenarios: Scenarios) -> np.ndarray:
    """[groups]: the share of each independent group of paths in the objective."""
    left = finite_totals(objective, totals)
    if not len(left[objective.outputs[0]]):
        return np.full(2, np.nan)
    influence = np.zeros(len(totals[objective.outputs[0]]))
    influence[finite(totals, objective.outputs)] = objective.influence(left)
    return of_groups(objective, totals, scenarios, influence)


def of_groups(objective: Objective, totals: Totals, scenarios: Scenarios, values) -> np.ndarray:
    """Shares of the groups in the mean over the paths that are finite."""
    valid = finite(totals, objective.outputs)
    groups = scenarios.groups(np.arange(valid.size))
    return statistics.ratio_shares(np.where(valid, values, 0.0), valid, groups)


CHUNK, FEWEST = 8192, 512  # paths in one call of an engine; of long ones at least


Series = dict[str, np.ndarray]


class Simulation(NamedTuple):
    """N paths of T steps, in float64; a state of several numbers is "name.0", "name.1", …

    - `totals`: {output: [N]}, as the objective takes them.
    - `states`: {name: [T + 1, N]}, before every step and at the end.
    - `actions`, `outputs`: {name: [T, N]}, at every step.
    """

    totals: Series
    states: Series
    actions: Series
    outputs: Series

    def frame(self, backend: str = "pandas") -> Any:
        """A data frame, a row for every path and step: "path", "step", states, actions, outputs.

        **Raises:** `ModuleNotFoundError` if the package of `backend` is missing.
        """
        steps, paths = next(iter((self.outputs or self.actions).values())).shape
        columns: dict[str, Any] = {
            "path": np.repeat(np.arange(paths), steps),
            "step": np.tile(np.arange(steps), paths),
        }
        for series in (self.states, self.actions, self.outputs):
            for name, values in series.items():
                # An output may have the name of a state.
                free = name if name not in columns else f"{name} (output)"
                columns[free] = values[:steps].T.ravel()
        return frame(columns, backend)


@takes_problem(objective=False)
def simulate(
    problem: Problem,
    policy: Policy,
    *,
    paths: int = 1024,
    smooth: Smooth | Exact = EXACT,
    engine: Engine | None = None,
) -> Simulation:
    """The trajectories of the first `paths` paths of the problem's evaluation, which
    also give its value.

        paths = snapo.simulate(solution.problem, solution.policy, paths=256)
        paths.states["water"].mean(1)

    **Arguments:**

    - `smooth`: `Smooth(temperature)` for the simulator of training.
    - `engine`: by default XLA in float64.
    """
    source = problem.sources.evaluation
    draws = source.draws(np.arange(source.available(paths)), problem.simulator)
    bound = (engine or Xla("float64")).bind(problem)
    result = bound.values(policy, draws, smooth, record=("state", "action", "outputs"))
    states = named_series(result.record["state"], "state")
    endpoints = named_series(
        jax.tree.map(lambda leaf: np.asarray(leaf)[None], result.state), "state"
    )
    states = {
        name: state
        if len(state) > problem.simulator.horizon
        else np.concatenate([state, endpoints[name]])
        for name, state in states.items()
    }
    actions, outputs = (named_series(result.record[kind], kind) for kind in ("action", "outputs"))
    return Simulation(float64(result.totals), states, actions, outputs)


def named_series(tree: PyTree, kind: str) -> Series:
    """{name: [T, N]} of every number of a tree of arrays [T, N, …]."""
    series: Series = {}
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        name = ".".join(str(getattr(part, "key", getattr(part, "idx", part))) for part in path)
        values = np.asarray(leaf, np.float64)
        values = values.reshape(*values.shape[:2], -1)
        for i in range(values.shape[2]):
            full = f"{name or kind}.{i}" if values.shape[2] > 1 else name or kind
            series[full] = values[:, :, i]
    return series
