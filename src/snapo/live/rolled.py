"""The paths of a move, rolled once: what the value adds up, the deltas replay and the fans show."""

from itertools import pairwise
from typing import Any, NamedTuple

import jax
import numpy as np

from snapo.problem.policy import Policy
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import float64
from snapo.solver.evaluate import CHUNK, path_totals
from snapo.study.parts.profile import KINDS
from snapo.study.study import Setup

from .counts import Counts


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
    """Every path once, where its totals have the same bits whatever is recorded; else apart."""
    problem, engine = setup.problem, setup.engines.evaluate
    source, bound = problem.sources.evaluation, engine.bind(problem)
    paths, deltas, fans = (source.available(each) for each in counts)

    def rolled(first: int, last: int, record: tuple[str, ...]):
        draws = source.draws(np.arange(first, last), problem.simulator)
        return bound.values(policy, draws, Exact(), record=record)

    if not engine.steady:
        totals = path_totals(problem, policy, counts.value, engine=engine)
        return Rolled(totals, None, rolled(0, fans, KINDS).record)
    edges = sorted({*range(0, paths, CHUNK), fans, deltas, paths})
    found = []
    for first, last in pairwise(edges):
        record = KINDS if last <= fans else ("action",) if last <= deltas else ()
        found.append((last, rolled(first, last, record)))
    parts = [float64(each.totals) for _, each in found]
    totals = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    decided = [each.record["action"] for last, each in found if last <= deltas]
    kept = [each.record for last, each in found if last <= fans]
    shown = jax.tree.map(lambda *each: np.concatenate(each, 1) if each[1:] else each[0], *kept)
    return Rolled(totals, np.concatenate(decided, 1), shown)
