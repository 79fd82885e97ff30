"""Paths of a policy with their whole course: states, decisions and outputs of every step."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Engine, Xla
from snapo.problem.meant import takes_problem
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import EXACT, Exact, Smooth

from .adjoint import float64
from .show.frame import frame

Series = dict[str, np.ndarray]


class Simulation(NamedTuple):
    """N paths of T steps, in float64; a state of several numbers is "name.0", "name.1", …

    - `totals`: {output: [N]}, as the objective takes them.
    - `states`: {name: [T + 1, N]}, before every step and at the end.
    - `actions`, `outputs`: {name: [T, N]} of every step.
    """

    totals: Series
    states: Series
    actions: Series
    outputs: Series

    def frame(self, backend: str = "pandas") -> Any:
        """A data frame, a row for every path and step: "path", "step", states, actions, outputs.

        **Raises:** `ModuleNotFoundError` where the package of `backend` is missing.
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
    """The course of the first `paths` paths of the problem's evaluation, on which its value is.

        course = snapo.simulate(solution.problem, solution.policy, paths=256)
        course.states["water"].mean(1)

    **Arguments:**

    - `smooth`: `Smooth(temperature)` plays the simulator of training.
    - `engine`: by default XLA in float64.
    """
    source = problem.sources.evaluation
    draws = source.draws(np.arange(source.available(paths)), problem.simulator)
    bound = (engine or Xla("float64")).bind(problem)
    result = bound.values(policy, draws, smooth, record=("state", "action", "outputs"))
    states = _series(result.record["state"], "state")
    endpoints = _series(jax.tree.map(lambda leaf: np.asarray(leaf)[None], result.state), "state")
    states = {
        name: state
        if len(state) > problem.simulator.horizon
        else np.concatenate([state, endpoints[name]])
        for name, state in states.items()
    }
    actions, outputs = (_series(result.record[kind], kind) for kind in ("action", "outputs"))
    return Simulation(float64(result.totals), states, actions, outputs)


def _series(tree: PyTree, kind: str) -> Series:
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
