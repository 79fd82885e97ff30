"""The end of a step on a grid: levels restart, and a bank takes its new balance."""

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from ..core.contract import ContractLayout, StepTerms

NEAR = 1e-6  # of a node's number: a balance this near to a node is on it
positive = partial(np.maximum, 0.0)


class Settling(NamedTuple):
    """The end of one step.

    - `arrive`: the number of the node of the next step for each node after; `lost`: the
      money that settling takes there.
    - `between`: a second such node, and its weight, where balances are between nodes.
    - `made_up`: money for the units made up until the nodes before and after; None without a bank.
    """

    arrive: np.ndarray
    lost: np.ndarray
    between: tuple[np.ndarray, np.ndarray] | None = None
    made_up: tuple[np.ndarray, np.ndarray] | None = None

    def settled(self, value: np.ndarray) -> np.ndarray:
        """[modes, nodes after, …] after settling, from [modes, nodes of the next step, …]."""
        if self.between is None:
            return value[:, self.arrive]
        other, weight = self.between[0], self.between[1][:, None]
        return (1 - weight) * value[:, self.arrive] + weight * value[:, other]

    @property
    def money(self) -> np.ndarray | None:
        """[nodes after] that settling and units made up earn; None where there is none."""
        if self.made_up is not None:
            return self.made_up[1] - self.lost
        return -self.lost if self.lost.any() else None


def settling(
    layout: ContractLayout, terms: StepTerms, t: int, before, after, following
) -> Settling:
    """The end of step t from nodes `after` it to those of the `following` one."""
    arrivals, lost = [], np.zeros(1)
    for i, points in enumerate(after):
        restarts = bool(terms.restarts[t, i])
        arrivals.append(np.zeros(len(points), int) if restarts else np.arange(len(points)))
        missed = np.maximum(terms.owed[t, i] - points, 0.0) if restarts else np.zeros(len(points))
        amount = missed * terms.short[t, i] if restarts else missed
        lost = (lost[:, None] + amount[None, :]).ravel()
    numbers = np.arange(math.prod(map(len, following)))
    shape = [len(x) for x in following]
    if terms.bank is None:
        return Settling(numbers.reshape(shape)[np.ix_(*arrivals)].ravel(), lost)
    bank = terms.bank.at(t)
    used = [np.ravel(bank.made_up(*_mesh(x), positive)) * bank.refund for x in (before, after)]
    made_up = used[0], used[1]
    if not terms.restarts[t, 0]:
        return Settling(numbers.reshape(shape)[np.ix_(*arrivals)].ravel(), lost, None, made_up)
    counted, balance = _mesh(after)
    missed = np.ravel(positive(bank.owed(balance, positive) - counted))
    goal = np.ravel(bank.settled(counted, balance, positive))
    position = np.interp(goal, following[1], np.arange(len(following[1]), dtype=float))
    left = np.floor(position + NEAR).astype(int)
    share = np.where(position - left > NEAR, position - left, 0.0)
    right = np.minimum(left + 1, len(following[1]) - 1)
    between = (right, share) if share.any() else None
    return Settling(left, missed * terms.short[t, 0], between, made_up)


def balances(terms: StepTerms, start: float, low: np.ndarray, high: np.ndarray):
    """[T + 1] the lowest and the highest balance at the start of each step.

    `low`, `high` [T + 1]: of the counted level, at the start and after each step.
    """
    assert terms.bank is not None
    lowest, highest = np.full(len(low), start), np.full(len(low), start)
    for t in range(len(low) - 1):
        lowest[t + 1], highest[t + 1] = lowest[t], highest[t]
        if terms.restarts[t, 0]:
            bank = terms.bank.at(t)
            lowest[t + 1] = bank.settled(high[t + 1], lowest[t], positive)
            highest[t + 1] = bank.settled(low[t + 1], highest[t], positive)
    return lowest, highest


def _mesh(nodes) -> tuple[np.ndarray, np.ndarray]:
    """The counted level and the balance at all nodes of two levels."""
    return nodes[0][:, None], nodes[1][None, :]
