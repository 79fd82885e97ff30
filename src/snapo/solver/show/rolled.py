"""Figures that need the problem beside the solution: fans over time, and the policy as a curve or
a map over the state."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.engine import Xla
from snapo.problem.code.version import followed, of_rollout
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact

from ..simulate import simulate

PATHS, POINTS, CELLS = 1024, 121, 61


def simulated_series(problem: Problem, policy: Policy, paths: int = PATHS) -> dict[str, np.ndarray]:
    """{name: [T or T + 1, paths]} of every number of state, action and outputs."""
    trajectory = simulate(problem, policy, paths=paths)
    return {**trajectory.states, **trajectory.actions, **trajectory.outputs}


def series_named(series: dict[str, np.ndarray], name: str, subject: str) -> np.ndarray:
    """One of the series. **Raises:** `KeyError` for a name that is none."""
    if name not in series:
        raise KeyError(f"plot.{subject}: nothing is called {name!r}; there are {sorted(series)}.")
    return series[name]


def decisions(
    problem: Problem, policy: Policy, names: tuple[str, ...], ranges: list[np.ndarray], step: int
) -> np.ndarray:
    """[points …, actions] exact decisions at a step, where one or two numbers of the state move and
    all others stay at their means."""
    source = problem.sources.evaluation
    draws = source.draws(np.arange(source.available(PATHS)), problem.simulator)
    record = Xla("float64").bind(problem).values(policy, draws, Exact(), record=("state",)).record
    middle = jax.tree.map(
        lambda x: jnp.asarray(np.asarray(x, np.float64)[step].mean(0), jnp.float32), record["state"]
    )
    schedule = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), problem.schedule)
    now = at(schedule.steps, step)

    def decide(*values: Any) -> Any:
        state = middle
        for name, value in zip(names, values):
            state = _put(state, name, value)
        observed = problem.simulator.observe(schedule.constants, now, state)
        return policy(observed, Exact())

    call = decide
    for axis in reversed(range(len(names))):
        call = jax.vmap(call, tuple(0 if i == axis else None for i in range(len(names))))
    grid = [jnp.asarray(item, jnp.float32) for item in ranges]
    version = of_rollout(problem.simulator, policy, schedule)
    return np.asarray(followed(jax.jit(call), version)(*grid), np.float64)


def _put(state: Any, name: str, value: Any) -> Any:
    """The state with one number replaced: "stock", "stock.0", or "state" of a plain array."""
    flat, tree = jax.tree_util.tree_flatten_with_path(state)
    leaves = []
    for path, leaf in flat:
        local = ".".join(str(getattr(part, "key", getattr(part, "idx", part))) for part in path)
        local = local or "state"
        if name == local and leaf.size == 1:
            leaf = jnp.reshape(value, leaf.shape)
        elif name.startswith(f"{local}.") and name[len(local) + 1 :].isdigit():
            leaf = leaf.ravel().at[int(name[len(local) + 1 :])].set(value).reshape(leaf.shape)
        leaves.append(leaf)
    return jax.tree.unflatten(tree, leaves)
