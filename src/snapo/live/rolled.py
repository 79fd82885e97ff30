"""The paths of a move, rolled once: what the value adds up, the deltas replay and the fans show."""

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
from snapo.study.chapters.profile import KINDS
from snapo.study.study import Setup

from .counts import Counts

MOST_RECORDED = 2048  # paths of one call of the engine: their course is held at once


class Rolled(NamedTuple):
    """The policy on the first paths of the evaluation, in the order of their numbers.

    - `totals`: {output: [paths]} for the value.
    - `actions`: [T, paths, A] for the deltas; None where they roll their own.
    - `shown`: {kind: leaves [T, paths, …]} of state, action and outputs for the fans.
    """

    totals: dict[str, np.ndarray]
    actions: np.ndarray | None
    shown: dict[str, Any]


def roll(setup: Setup, policy: Policy, counts: Counts) -> Rolled:
    """Every path once, where its totals have the same bits whatever is recorded; else apart.

    All of a path's course is recorded whoever asks: another record would be compiled anew.
    """
    problem, engine = setup.problem, setup.engines.evaluate
    source, bound = problem.sources.evaluation, engine.bind(problem)
    paths, deltas, fans = (source.available(each) for each in counts)

    def rolled(first: int, last: int):
        draws = source.draws(np.arange(first, last), problem.simulator)
        return bound.values(policy, draws, Exact(), record=KINDS)

    if not engine.steady:
        totals = path_totals(problem, policy, counts.value, engine=engine)
        return Rolled(totals, None, rolled(0, fans).record)
    parts, decided, shown = [], [], []
    for first in range(0, paths, MOST_RECORDED):
        found = rolled(first, min(first + MOST_RECORDED, paths))
        parts.append(float64(found.totals))
        if first < deltas:
            decided.append(found.record["action"][:, : deltas - first])
        if first < fans:
            shown.append(jax.tree.map(lambda x, n=fans - first: x[:, :n], found.record))
    totals = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    kept = jax.tree.map(lambda *each: np.concatenate(each, 1) if each[1:] else each[0], *shown)
    return Rolled(totals, np.concatenate(decided, 1), kept)


def numbers_of_a_path(problem: Problem) -> int:
    """How many numbers the course of one path has: states, actions and outputs of all steps."""
    simulator, known = problem.simulator, problem.schedule  # made here, outside of the trace

    def step(noise, first, action):
        schedule = jax.tree.map(jnp.asarray, known)
        state = simulator.initial(schedule.constants, first)
        now = at(schedule.steps, 0)
        return simulator.step(schedule.constants, now, state, action, noise, Exact()), action

    sizes = simulator.noise_size, simulator.initial_noise_size, simulator.action.size
    with jax.enable_x64(True):
        found = jax.eval_shape(step, *(jnp.zeros(size) for size in sizes))
    return simulator.horizon * sum(leaf.size for leaf in jax.tree.leaves(found))


def totals_of(setup: Setup, policy: Policy, paths: int) -> dict[str, np.ndarray]:
    """{output: [paths]} of a policy, by the code that rolls a move."""
    return roll(setup, policy, Counts(paths, 1, 1)).totals
