"""Several starts at low cost: all begin, and after every round the better half continues.

Successive halving (Jamieson and Talwalkar 2016): starts differ in the initial weights of their
networks only and see the same scenarios, so they are distinguished by the exact value on the
validation paths, common to all; with limits as in `limits.best_first`. The last one continues like
a run with one start.

They run one after another: the paths of one start occupy all cores, so that several at once would
take as long and need more memory; and all of them share the kernels of the first one.

It also trains policies that imitate a rule, as a warm start for `solve`.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.engine import EngineName, choose
from snapo.problem.actions import Box
from snapo.problem.inputs import Frozen
from snapo.problem.meant import takes_problem
from snapo.problem.objective import Mean
from snapo.problem.policy import MLP, Network, Policy, without_memory
from snapo.problem.problem import Problem
from snapo.problem.simulator import Around, Simulator

from ..limits import Contender, best_first
from ..train import Training, initial_progress, train
from .progress import Interrupted, Progress, Round

DISTANCE = "distance"
SHORT = Training(steps=300, paths=128, validation_paths=512)


class Imitating(Around):
    """The rule moves the state; the cost of the policy is the square of its distance from the
    rule."""

    rule: Frozen
    scale: tuple[float, ...] = eqx.field(static=True)

    def __init__(self, simulator: Simulator, rule: Policy, scale: tuple[float, ...]):
        self.inner, self.rule, self.scale = simulator, Frozen(rule), scale

    def step(self, constants, now, state, action, noise, smooth):
        right = self.rule.array(self.inner.observe(constants, now, state), smooth)
        after, _ = self.inner.step(constants, now, state, right, noise, smooth)
        away = (action - jax.lax.stop_gradient(right)) / jnp.asarray(self.scale, action.dtype)
        return after, {DISTANCE: jnp.sum(away**2) / self.inner.horizon}

    def terminal(self, constants, state, smooth):
        return {}

    def totals(self):
        return {}

    def control_variates(self):
        return ()

    def slack(self, constants, now, state, outputs):
        return {}


class Imitation(NamedTuple):
    """A policy that imitates a rule.

    - `distance`: the root mean square difference of its decisions from those of the rule, in units
      of the range of each component, if it has one.
    """

    policy: Policy
    distance: float


@takes_problem(objective=False)
def imitate(
    problem: Problem,
    rule: Policy,
    policy: Policy | None = None,
    *,
    training: Training | None = None,
    engine: EngineName = "auto",
) -> Imitation:
    """Trains a policy to imitate `rule` in the states that the rule visits.

        imitated = snapo.imitate(problem, snapo.BaseStock(12.0))
        solution = snapo.solve(problem, policy=imitated.policy)

    **Arguments:**

    - `rule`: a policy without a memory. `policy`: as in `solve`; it may have a memory.
    - `training`: by default 300 steps with 128 paths.
    """
    without_memory(rule, "imitate")
    training = training or SHORT
    rule = rule.for_problem(problem.interface, jax.random.key(training.seed))
    followed = Imitating(problem.simulator, rule, _ranges(problem))
    # The rule's outputs are gone, and with them limits on them: the next training has those.
    problem = replace(problem, simulator=followed, objective=-Mean(DISTANCE), constraints=())
    policy = (policy or MLP()).for_problem(problem.interface, jax.random.key(training.seed))
    engines = choose(engine, problem, policy)
    progress = train(problem, initial_progress(policy, training, problem), training, engines.train)
    return Imitation(progress.best, float(np.sqrt(max(0.0, -progress.best_value))))


def _ranges(problem: Problem) -> tuple[float, ...]:
    """The range of every component of a decision; 1 if it is not bounded."""
    action = problem.action
    if not isinstance(action, Box):
        return (1.0,) * action.size
    low, high = action.bounds()
    with np.errstate(invalid="ignore"):
        width = high - low
    return tuple(np.where(np.isfinite(width) & (width > 0), width, 1.0).tolist())


ROUND = 0.1  # of the steps of a run, between two halvings: four starts cost .4 of a run more
APART = 1.0  # percent between two starts at the same step, from which more of them should be tried


def others(policy: Policy, count: int, seed: int) -> list[Policy]:
    """`count` untrained policies: the supplied one, and others with different initial weights.

    Each weight of a `Network`, or of a layer of Equinox, is drawn again, with the size of the
    weights of its layer for the same feature; one-dimensional arrays, such as biases, are kept.

    **Raises:** `ValueError` if the policy has no network: all its starts would be equal.
    """
    if count > 1 and not any(_is_network(node) for node in _nodes(policy)):
        raise ValueError(
            f"Training: starts is {count}, and {type(policy).__name__} has no network whose "
            "initial weights could vary; it must be 1."
        )
    rng = [np.random.default_rng((seed, number)) for number in range(count)]
    return [policy, *(_redrawn(policy, item) for item in rng[1:])]


def by_value(progress: Progress) -> Contender:
    """The contender of a start in a problem without limits."""
    return Contender(float(progress.best_value))


def race(
    started: list[Progress],
    steps: int,
    run: Callable[[Progress, int], Progress],
    contender: Callable[[Progress], Contender] = by_value,
) -> tuple[Progress, tuple[Round, ...]]:
    """The start that remains, and the rounds in which the others were dropped.

    - `started`: the starts before their first step.
    - `steps`: the steps of a whole run; `run(progress, until)` trains up to step `until` and
      validates; `contender(progress)` is compared with those of the other starts.
    """
    every = max(1, round(ROUND * steps))
    left, rounds = dict(enumerate(started)), []
    while len(left) > 1:
        until = every + next(iter(left.values())).step
        for number, item in left.items():
            try:
                left[number] = run(item, until)
            except Interrupted as stop:
                done = [*left.values(), stop.result]
                best = done[best_first(list(map(contender, done)))[0]]
                raise Interrupted(best, stop.notes) from None
        values = {number: float(entry.best_value) for number, entry in left.items()}
        order = best_first(list(map(contender, left.values())))
        ranked = [list(left)[position] for position in order]
        rounds.append(Round(until, tuple((number, values[number]) for number in ranked)))
        left = {number: left[number] for number in ranked[: (len(left) + 1) // 2]}
    return next(iter(left.values())), tuple(rounds)


def describe(rounds: tuple[Round, ...]) -> str:
    """The winner of a race, the differences of the starts at equal steps, and remedies."""
    count, winner = len(rounds[0].values), rounds[-1].values[0][0]
    summary, furthest = [], 0.0
    for step, values in rounds:
        mine = dict(values)[winner]
        others = [value - mine for number, value in values if number != winner]
        size = abs(mine)
        if not np.isfinite([size, *others]).all() or not size:
            summary.append(f"at step {step} some starts had no value for a comparison")
            continue
        endpoints = [100 * item / size for item in (min(others), max(others))]
        furthest = max(furthest, *map(abs, endpoints))
        both = list(dict.fromkeys(map(_percent, endpoints)))
        who = "the value of the other was" if len(others) == 1 else "the values of the others were"
        summary.append(f"{who} {' to '.join(both)} at step {step}")
    metadata = "; ".join(summary)
    more = (
        f" The result depends on the initial weights: try more of them (starts={2 * count})."
        if furthest > APART
        else ""
    )
    return (
        f"Of {count} starts, of which the worse half was dropped every {rounds[0].step} steps, "
        f"number {winner + 1} remained: {metadata}.{more}"
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
