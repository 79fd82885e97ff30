"""The one adjoint pass: from weights on path totals back to the policy and to every input.

    inputs → prepare → schedule → rollout → totals → objective
    inputs ← prepare's transpose ← d schedule ← engine.adjoint ← weights

Training and sensitivities both read what this file gives.
"""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Adjoint, BoundEngine, Engine, Xla
from snapo.engine.transpose import pull_back as pull_back
from snapo.problem.meant import takes_problem
from snapo.problem.noise import Draws
from snapo.problem.objective import Objective, Weights
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import EXACT, Exact, Smooth


class Gradient(NamedTuple):
    """Derivatives of one value: `policy` shaped like the policy, `inputs` {name: array}."""

    policy: PyTree
    inputs: dict[str, np.ndarray]


@takes_problem
def value_and_gradient(
    problem: Problem,
    policy: Policy,
    *,
    paths: int = 4096,
    smooth: Smooth | Exact = EXACT,
    engine: Engine | None = None,
    decisions: Literal["held", "reacting"] = "reacting",
) -> tuple[float, Gradient]:
    """The objective and its exact gradient for the policy and every input.

    On the first `paths` paths of the problem's evaluation.

    **Arguments:**

    - `smooth`: through a hard decision the pathwise derivative is blind, so use
      `Smooth(temperature)` for derivatives through the policy's reaction, or
    - `decisions="held"`: they are recorded first and then replayed; the policy's gradient is zero.
    - `engine`: by default XLA in float64.

    **Raises:** `ValueError` for other `decisions`.
    """
    if decisions not in ("held", "reacting"):
        message = "allowed is 'held' or 'reacting'"
        raise ValueError(f"value_and_gradient: decisions is {decisions!r}; {message}.")
    held = decisions == "held"
    bound = (engine or Xla(precision="float64")).bind(problem)
    source = problem.sources.evaluation
    draws = source.draws(np.arange(source.available(paths)), problem.simulator)
    value, result = weighted_adjoint(bound, policy, draws, smooth, problem.objective, held=held)
    moved = pull_back(problem.simulator, problem.inputs, [result.schedule])
    gradient = {name: array[0] for name, array in moved.items()}
    nothing = jax.tree.map(np.zeros_like, eqx.filter(policy, eqx.is_inexact_array))
    return value, Gradient(nothing if held else result.policy, gradient)


def weighted_adjoint(
    bound_engine: BoundEngine,
    policy: Policy,
    draws: Draws,
    smooth,
    objective: Objective,
    *,
    held: bool = False,
    **options,
) -> tuple[float, Adjoint]:
    """The objective on these paths, and the adjoint of its weights.

    A linear objective knows its weights beforehand; any other costs one more forward sweep. Where
    the objective has no derivative, as under ruin, the weights are those that lead away from it.
    """
    actions = None
    if held or not objective.linear:
        record = ("action",) if held else ()
        window = {key: options[key] for key in ("window", "start") if key in options}
        first = bound_engine.values(policy, draws, smooth, record=record, **window)
        actions = first.record.get("action")
        weights = objective.climb(float64(first.totals))
    else:
        weights = flat_weights(objective, draws.size)
    decider = None if held else policy
    result = bound_engine.adjoint(decider, draws, smooth, weights, actions=actions, **options)
    return objective.value(float64(result.totals)), result


def flat_weights(objective: Objective, paths: int) -> Weights:
    """The weights of a linear objective, which any totals give."""
    return objective.weights({name: np.zeros(paths) for name in objective.outputs})


def float64(totals: dict[str, Any]) -> dict[str, np.ndarray]:
    """Path totals as float64 NumPy, so that sums over paths lose nothing."""
    return {name: np.asarray(total, np.float64) for name, total in totals.items()}
