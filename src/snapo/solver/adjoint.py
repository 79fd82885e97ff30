"""The one adjoint pass: from weights on path totals back to the policy and to every input.

    inputs → prepare → schedule → rollout → totals → objective
    inputs ← prepare's transpose ← d schedule ← engine.adjoint ← weights

Both training and sensitivities use these functions.

The adjoint uses only the finite paths, so that one bad path does not make a whole run useless.

A path is bad if a total that the objective uses, or the path's adjoint, is non-finite. Bad paths
are omitted and counted. They may be at most the share `DROPPED` of all paths, since the omitted
paths may be the important ones. A path of ruin, whose total is finite, is never left out: its
utility is minus infinity.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Adjoint, BoundEngine, Engine, Xla
from snapo.engine.transpose import pull_back as pull_back
from snapo.problem.meant import takes_problem
from snapo.problem.noise import Draws
from snapo.problem.noise.counter import only
from snapo.problem.objective import Objective, Totals, Weights
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
    """The objective and its exact gradient with respect to the policy and every input.

    They are computed on the first `paths` paths of the problem's evaluation.

    **Arguments:**

    - `smooth`: use `Smooth(temperature)` for derivatives through the policy's reaction, since
      pathwise derivatives ignore the jumps of discrete decisions; or - `decisions`: with "held"
      decisions are recorded first and then replayed; the policy's gradient is then zero.
    - `engine`: by default XLA in float64.

    **Raises:** `ValueError` for other `decisions`.
    """
    if decisions not in ("held", "reacting"):
        message = "it must be 'held' or 'reacting'"
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

    The weights of a linear objective are known beforehand; others need one more forward sweep. If
    the objective has no derivative, as under ruin, the weights are those of training.
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
    """The weights of a linear objective, which do not depend on the totals."""
    return objective.weights({name: np.zeros(paths) for name in objective.outputs})


def float64(totals: dict[str, Any]) -> dict[str, np.ndarray]:
    """Path totals as float64 NumPy, so that sums over paths lose no digits."""
    return {name: np.asarray(total, np.float64) for name, total in totals.items()}


DROPPED = 1e-3  # the largest share of the paths that may be left out


def finite(totals: Totals, names: Iterable[str]) -> np.ndarray:
    """[N] booleans: the paths whose totals of these names are finite."""
    return np.logical_and.reduce([np.isfinite(totals[name]) for name in names])


def adjoint_of_finite_paths(
    bound_engine: BoundEngine, policy, draws: Draws, smooth, objective: Objective, **options
) -> tuple[float, Adjoint, int]:
    """`weighted_adjoint` over the paths that are finite, and the number of those that are not.

    If no path is finite, or all are finite but the objective is NaN, all paths count as non-finite.
    """
    value, result = weighted_adjoint(bound_engine, policy, draws, smooth, objective, **options)
    if not np.isnan(value) and all_finite(result, objective.outputs):
        return value, result, 0
    valid = _good(bound_engine, policy, draws, smooth, objective.outputs, options)
    invalid = int(np.sum(~valid))
    if invalid == 0 or invalid == valid.size:
        return value, result, valid.size
    draws, options = _replaced(valid, draws, options)
    window = {key: options[key] for key in ("window", "start") if key in options}
    totals = float64(bound_engine.values(policy, draws, smooth, **window).totals)
    selected = {name: total[valid] for name, total in totals.items()}
    weights = _spread(objective.climb(selected), valid)
    result = bound_engine.adjoint(policy, draws, smooth, weights, **options)
    return objective.value(selected), result, invalid


def adjoint_of_good_weights(
    bound_engine: BoundEngine, policy, draws: Draws, smooth, weights: Weights, **options
) -> tuple[Adjoint, int]:
    """The adjoint for weights {output: [N] or [K, N]} that are known, and the number of bad paths.

    Bad paths have no weight; the weights of the others are unchanged.
    """
    result = bound_engine.adjoint(policy, draws, smooth, weights, **options)
    if all_finite(result, weights) or not _finite_leaves(weights):
        return result, 0
    valid = _good(bound_engine, policy, draws, smooth, tuple(weights), options)
    if valid.all() or not valid.any():
        return result, valid.size
    draws, options = _replaced(valid, draws, options)
    weights = _spread(
        {name: np.asarray(weight)[..., valid] for name, weight in weights.items()}, valid
    )
    return bound_engine.adjoint(policy, draws, smooth, weights, **options), int(np.sum(~valid))


def _good(bound_engine: BoundEngine, policy, draws, smooth, names, options) -> np.ndarray:
    """The paths with a finite value and a finite adjoint.

    A forward sweep finds most of the other paths. Each path is examined separately only if the
    adjoint of the rest is non-finite as well.
    """
    values = {key: options[key] for key in ("window", "start", "actions") if key in options}
    valid = finite(float64(bound_engine.values(policy, draws, smooth, **values).totals), names)
    if not valid.all() and valid.any():
        rest, values = _replaced(valid, draws, options)
        weights = {name: np.ones(valid.size) for name in names}
        if all_finite(bound_engine.adjoint(policy, rest, smooth, weights, **values), names):
            return valid
    weights = {name: np.ones(1) for name in names}
    for path in np.flatnonzero(valid):
        alone, values = _only(np.array([path]), draws, options)
        valid[path] = all_finite(
            bound_engine.adjoint(policy, alone, smooth, weights, **values), names
        )
    return valid


def _replaced(valid: np.ndarray, draws: Draws, options: dict) -> tuple[Draws, dict]:
    """Bad paths become copies of a good one: zero weight would not silence them (0 x inf)."""
    return _only(np.where(valid, np.arange(valid.size), np.argmax(valid)), draws, options)


def _spread(weights: Mapping[str, np.ndarray], valid: np.ndarray) -> Weights:
    """Weights of the good paths, and zeros for the others."""
    spread = {name: np.zeros((*weight.shape[:-1], valid.size)) for name, weight in weights.items()}
    for name, weight in weights.items():
        spread[name][..., valid] = weight
    return spread


def _only(selected: np.ndarray, draws: Draws, options: dict) -> tuple[Draws, dict]:
    """The noise, the starting states and the recorded actions of chosen paths only."""
    values = dict(options)
    if options.get("start") is not None:
        values["start"] = jax.tree.map(lambda leaf: leaf[selected], options["start"])
    if options.get("actions") is not None:
        values["actions"] = options["actions"][:, selected]
    return only(draws, selected), values


def all_finite(result: Adjoint, names: Iterable[str]) -> bool:
    """Whether an adjoint, and the totals of these names, are finite."""
    totals = [result.totals[name] for name in names]
    return _finite_leaves((result.policy, result.schedule, totals))


def _finite_leaves(tree: PyTree) -> bool:
    return all(bool(np.all(np.isfinite(_distinct(leaf)))) for leaf in jax.tree.leaves(tree))


def _distinct(leaf) -> np.ndarray:
    """An array without copies along axes: zeros of a table that no path moves are one number."""
    array = np.asarray(leaf)
    return array[tuple(slice(None) if step else slice(1) for step in array.strides)]
