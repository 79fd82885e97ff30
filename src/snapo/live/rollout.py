"""The paths of a move: their number, and their simulation for the value, the deltas and the
fans."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import float64
from snapo.solver.evaluate import path_totals
from snapo.solver.solution import Solution
from snapo.solver.solve import Evaluation
from snapo.study.chapters.profile import KINDS
from snapo.study.study import Setup

FEWEST, MAXIMUM = 1024, 12288  # paths of the value: as many as its error needs
ENOUGH = 0.0012  # standard error over value; at moved inputs it may be slightly larger
DELTA_PATHS, FAN_PATHS = 1024, 1024
MAX_NUMBERS = 40_000_000  # of all paths' courses: of a long and wide one there are fewer paths


class PathCounts(NamedTuple):
    """The numbers of paths for the value, the derivatives and the fans; the first is the
    largest."""

    value: int = MAXIMUM
    deltas: int = DELTA_PATHS
    fans: int = FAN_PATHS

    @classmethod
    def of(cls, paths: int, deltas: int | None = None) -> "PathCounts":
        """This number of paths for the value, and at most this number for other tables."""
        return cls(paths, min(DELTA_PATHS, deltas or paths, paths), min(FAN_PATHS, paths))

    @classmethod
    def enough(cls, solution: Solution, evaluation: Evaluation, numbers: int = 1) -> "PathCounts":
        """The number of paths that the value needs, estimated from the error of the run and not
        above the number in the run. `numbers`: the size of the trajectory of one path; if it is
        large there are fewer paths, so that the page answers quickly.
        """
        share = solution.standard_error / max(abs(solution.value), 1e-300) / ENOUGH
        needed = min(MAXIMUM, max(FEWEST, evaluation.paths * min(share, 1e3) ** 2))
        needed = min(needed, max(FEWEST, 512 * (MAX_NUMBERS // numbers // 512)))
        paths = min(evaluation.paths, 512 * math.ceil(needed / 512))
        return cls.of(paths, evaluation.sensitivity_paths)


MAX_RECORDED = 2048  # paths of one call of the engine: their trajectories are in memory at once


class Simulated(NamedTuple):
    """The results of the policy on the first paths of the evaluation, in their order.

    - `totals`: {output: [paths]} for the value.
    - `actions`: [T, paths, A] for the deltas; None if the calculation of the deltas simulates the
      paths again.
    - `tables`: {kind: leaves [T, paths, …]} of state, action and outputs for the fans.
    """

    totals: dict[str, np.ndarray]
    actions: np.ndarray | None
    tables: dict[str, Any]


def simulate(setup: Setup, policy: Policy, counts: PathCounts) -> Simulated:
    """Simulates every path once if recording does not change the bits of the totals; otherwise
    simulates the totals separately. The complete trajectory is always recorded, since a different
    record would need another compilation.
    """
    problem, engine = setup.problem, setup.engines.evaluate
    source, bound = problem.sources.evaluation, engine.bind(problem)
    paths, deltas, fans = (source.available(count) for count in counts)

    def outcome(first: int, last: int):
        draws = source.draws(np.arange(first, last), problem.simulator)
        return bound.values(policy, draws, Exact(), record=KINDS)

    if not engine.steady:
        totals = path_totals(problem, policy, counts.value, engine=engine)
        return Simulated(totals, None, outcome(0, fans).record)
    parts, decided, displayed = [], [], []
    for first in range(0, paths, MAX_RECORDED):
        result = outcome(first, min(first + MAX_RECORDED, paths))
        parts.append(float64(result.totals))
        if first < deltas:
            decided.append(result.record["action"][:, : deltas - first])
        if first < fans:
            displayed.append(jax.tree.map(lambda x, n=fans - first: x[:, :n], result.record))
    totals = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    selected = jax.tree.map(
        lambda *item: np.concatenate(item, 1) if item[1:] else item[0], *displayed
    )
    return Simulated(totals, np.concatenate(decided, 1), selected)


def numbers_of_a_path(problem: Problem) -> int:
    """The number of entries in the trajectory of one path: states, actions and outputs of all
    steps."""
    simulator, available = problem.simulator, problem.schedule  # made here, outside of the trace

    def step(noise, first, action):
        schedule = jax.tree.map(jnp.asarray, available)
        state = simulator.initial(schedule.constants, first)
        now = at(schedule.steps, 0)
        return simulator.step(schedule.constants, now, state, action, noise, Exact()), action

    sizes = simulator.noise_size, simulator.initial_noise_size, simulator.action.size
    with jax.enable_x64(True):
        result = jax.eval_shape(step, *(jnp.zeros(size) for size in sizes))
    return simulator.horizon * sum(leaf.size for leaf in jax.tree.leaves(result))


def totals_of(setup: Setup, policy: Policy, paths: int) -> dict[str, np.ndarray]:
    """{output: [paths]} of a policy, computed by the code that simulates a move."""
    return simulate(setup, policy, PathCounts(paths, 1, 1)).totals
