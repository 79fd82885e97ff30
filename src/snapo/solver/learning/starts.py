"""Several starts at little cost: all begin, and after every round the better half goes on.

Successive halving (Jamieson and Talwalkar 2016): starts differ in the first weights of their
networks alone and see the same scenarios, so they are told apart by the exact value on the
validation's paths, which all share. The last one goes on as a run of one start would.

They run one after another: the paths of one start are work for all cores already, so that several
at once would take as long, in more memory; and all of them share the kernels of the first one.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from snapo.problem.policy import Network, Policy

from .progress import Progress, Round

ROUND = 0.1  # of the steps of a run, between two halvings: four starts cost .4 of a run more
APART = 1.0  # percent between two starts at the same step, from which more of them are worth a try


def others(policy: Policy, count: int, seed: int) -> list[Policy]:
    """`count` untrained policies: the given one, and others with first weights of their own.

    Each weight of a `Network`, or of a layer of Equinox, is drawn anew, as large as those of its
    layer for the same feature are; numbers of one axis, such as biases, stay.

    **Raises:** `ValueError` where the policy has no network: its starts would all be one.
    """
    if count > 1 and not any(_is_network(node) for node in _nodes(policy)):
        raise ValueError(
            f"Training: starts is {count}, and {type(policy).__name__} has no network whose first "
            "weights could be others; allowed is 1."
        )
    rng = [np.random.default_rng((seed, number)) for number in range(count)]
    return [policy, *(_redrawn(policy, item) for item in rng[1:])]


def race(
    started: list[Progress], steps: int, run: Callable[[Progress, int], Progress]
) -> tuple[Progress, tuple[Round, ...]]:
    """The start that is left, and the rounds in which the others fell out.

    - `started`: the starts before their first step.
    - `steps`: of a whole run; `run(progress, until)` trains up to step `until` and validates.
    """
    every = max(1, round(ROUND * steps))
    left, rounds = dict(enumerate(started)), []
    while len(left) > 1:
        until = every + next(iter(left.values())).step
        left = {number: run(item, until) for number, item in left.items()}
        values = {number: float(entry.best_value) for number, entry in left.items()}
        ranked = sorted(left, key=lambda number: -np.nan_to_num(values[number], nan=-np.inf))
        rounds.append(Round(until, tuple((number, values[number]) for number in ranked)))
        left = {number: left[number] for number in ranked[: (len(left) + 1) // 2]}
    return next(iter(left.values())), tuple(rounds)


def describe(rounds: tuple[Round, ...]) -> str:
    """Who won a race, how far apart the starts were at equal steps, and what to try."""
    count, winner = len(rounds[0].values), rounds[-1].values[0][0]
    summary, furthest = [], 0.0
    for step, values in rounds:
        mine = dict(values)[winner]
        others = [value - mine for number, value in values if number != winner]
        size = abs(mine)
        if not np.isfinite([size, *others]).all() or not size:
            summary.append(f"at step {step} not all of them had a value to compare with")
            continue
        endpoints = [100 * item / size for item in (min(others), max(others))]
        furthest = max(furthest, *map(abs, endpoints))
        both = list(dict.fromkeys(map(_percent, endpoints)))
        who = "the other was" if len(others) == 1 else "the others were"
        summary.append(f"{who} {' to '.join(both)} at step {step}")
    metadata = "; ".join(summary)
    more = (
        f" Where a policy starts matters here: try more of them (starts={2 * count})."
        if furthest > APART
        else ""
    )
    return (
        f"Of {count} starts, halved every {rounds[0].step} steps, number {winner + 1} went on: "
        f"{metadata}.{more}"
    )


def _percent(share: float) -> str:
    """ "4.1 % lower"."""
    return f"{abs(share):.2g} % {'lower' if share < 0 else 'higher'}"


def _redrawn(policy: Policy, rng: np.random.Generator) -> Policy:
    def draw(leaf: Any) -> Any:
        return jax.tree.map(weight, leaf) if _is_network(leaf) else leaf

    def weight(leaf: Any) -> Any:
        if not eqx.is_inexact_array(leaf) or leaf.ndim < 2:
            return leaf
        return (rng.standard_normal(leaf.shape) * _size(np.asarray(leaf))).astype(leaf.dtype)

    return jax.tree.map(draw, policy, is_leaf=_is_network)


def _size(weights: np.ndarray) -> np.ndarray:
    """[features] how large the weights [units, features] of each feature are."""
    return np.sqrt(np.mean(weights**2, axis=0))


def _nodes(policy: PyTree) -> list[Any]:
    return jax.tree.leaves(policy, is_leaf=_is_network)


def _is_network(node: Any) -> bool:
    return isinstance(node, Network) or type(node).__module__.startswith("equinox.nn")
