"""Several starts at little cost: all begin, and after every round the better half goes on.

Successive halving (Jamieson and Talwalkar 2016): starts differ in the first weights of their
networks alone and see the same scenarios, so they are told apart by the exact value on the
validation's paths, which all share. The last one goes on as a run of one start would.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from snapo.problem.policy import Network, Policy

from .progress import Progress

ROUND = 0.1  # of the steps of a run, between two halvings: four starts cost .4 of a run more


def others(policy: Policy, count: int, seed: int) -> list[Policy]:
    """`count` untrained policies: the given one, and others with first weights of their own.

    Each weight is drawn anew, as large as those of its layer for the same feature are.

    **Raises:** `ValueError` where the policy has no network: its starts would all be one.
    """
    if count > 1 and not any(_is_network(each) for each in _nodes(policy)):
        raise ValueError(
            f"Training: starts is {count}, and {type(policy).__name__} has no network whose first "
            "weights could be others; allowed is 1."
        )
    rng = [np.random.default_rng((seed, number)) for number in range(count)]
    return [policy, *(_redrawn(policy, each) for each in rng[1:])]


def race(
    begun: list[Progress], steps: int, run: Callable[[Progress, int], Progress]
) -> tuple[Progress, tuple[float, ...]]:
    """The start that is left, and the value of each when it was last compared.

    - `begun`: the starts before their first step.
    - `steps`: of a whole run; `run(progress, until)` trains up to step `until` and validates.
    """
    every = max(1, round(ROUND * steps))
    values = np.full(len(begun), np.nan)
    left = dict(enumerate(begun))
    while len(left) > 1:
        until = every + next(iter(left.values())).step
        left = {number: run(each, until) for number, each in left.items()}
        for number, each in left.items():
            values[number] = each.best_value
        ranked = sorted(left, key=lambda number: -np.nan_to_num(values[number], nan=-np.inf))
        left = {number: left[number] for number in ranked[: (len(left) + 1) // 2]}
    return next(iter(left.values())), tuple(values.tolist())


def words(values: tuple[float, ...], steps: int) -> str:
    """One sentence on a race: who won, and how far apart the starts were."""
    best, worst = int(np.nanargmax(values)), float(np.nanmin(values))
    every = max(1, round(ROUND * steps))
    return (
        f"Of {len(values)} starts, halved every {every} steps, number {best + 1} went on: it had "
        f"{values[best]:,.5g}, the worst of them {worst:,.5g}."
    )


def _redrawn(policy: Policy, rng: np.random.Generator) -> Policy:
    def draw(leaf: Any) -> Any:
        if not _is_network(leaf):
            return leaf
        fresh = [
            (rng.standard_normal(each.shape) * _size(np.asarray(each))).astype(np.float32)
            for each in leaf.weights
        ]
        return eqx.tree_at(lambda tree: tree.weights, leaf, fresh)

    return jax.tree.map(draw, policy, is_leaf=_is_network)


def _size(weights: np.ndarray) -> np.ndarray:
    """[features] how large the weights [units, features] of each feature are."""
    return np.sqrt(np.mean(weights**2, axis=0))


def _nodes(policy: PyTree) -> list[Any]:
    return jax.tree.leaves(policy, is_leaf=_is_network)


def _is_network(node: Any) -> bool:
    return isinstance(node, Network)
