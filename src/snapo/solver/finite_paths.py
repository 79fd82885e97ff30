"""The adjoint over the paths that are finite: one bad path must not cost a step of training."""

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Adjoint, Bound
from snapo.problem.noise import Draws
from snapo.problem.objective import Objective

from .adjoint import float64, weighted_adjoint


def adjoint_of_finite_paths(
    bound: Bound, policy, draws: Draws, smooth, objective: Objective, **options
) -> tuple[float, Adjoint, int]:
    """`weighted_adjoint` over the paths that are finite, and the number of those that are not.

    Zero weight would not silence a path that is not finite (0 x inf is NaN), so such a path is
    replaced by a copy of a finite one that counts for nothing.
    """
    value, result = weighted_adjoint(bound, policy, draws, smooth, objective, **options)
    if np.isfinite(value) and _all_finite(result.policy):
        return value, result, 0
    good = _finite_paths(bound, policy, draws, smooth, objective, options)
    bad = int(np.sum(~good))
    if bad == 0 or bad == good.size:
        return value, result, good.size
    source = np.where(good, np.arange(good.size), np.argmax(good))
    draws, options = _only(source, draws, options)
    window = {key: options[key] for key in ("window", "start") if key in options}
    totals = float64(bound.values(policy, draws, smooth, **window).totals)
    kept = {name: total[good] for name, total in totals.items()}
    weights = objective.weights(kept)
    spread = {name: np.zeros(good.size) for name in weights}
    for name, weight in weights.items():
        spread[name][good] = weight
    result = bound.adjoint(policy, draws, smooth, spread, **options)
    return objective.value(kept), result, bad


def _finite_paths(bound: Bound, policy, draws, smooth, objective, options) -> np.ndarray:
    """Which paths have a finite value and a finite adjoint, found by looking at each alone.

    One forward sweep finds most of them; only paths that pass it are examined one by one.
    """
    window = {key: options[key] for key in ("window", "start") if key in options}
    totals = float64(bound.values(policy, draws, smooth, **window).totals)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        good = np.array([_finite_alone(objective, totals, path) for path in range(draws.size)])
    weights = {name: np.ones(1) for name in objective.outputs}
    for path in np.flatnonzero(good):
        alone, given = _only(np.array([path]), draws, options)
        result = bound.adjoint(policy, alone, smooth, weights, **given)
        good[path] &= _all_finite(result.policy)
    return good


def _finite_alone(objective, totals, path: int) -> bool:
    """Whether one path's totals and its share of the objective are finite."""
    alone = {name: total[path : path + 1] for name, total in totals.items()}
    return _all_finite(alone) and bool(np.isfinite(objective.influence(alone)).all())


def _only(chosen: np.ndarray, draws: Draws, options: dict) -> tuple[Draws, dict]:
    """The noise and the starting states of chosen paths alone."""
    axes = draws.axes()
    picked = jax.tree.map(
        lambda leaf, axis: leaf if axis is None else np.take(leaf, chosen, axis),
        draws,
        axes,
        is_leaf=lambda leaf: leaf is None,
    )
    start = options.get("start")
    if start is None:
        return picked, options
    return picked, options | {"start": jax.tree.map(lambda leaf: leaf[chosen], start)}


def _all_finite(tree: PyTree) -> bool:
    return all(bool(np.all(np.isfinite(np.asarray(leaf)))) for leaf in jax.tree.leaves(tree))
