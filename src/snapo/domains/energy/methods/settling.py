"""The end of a step on a grid: money of the levels, restarts, the new balance of a bank."""

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from ..core.contract import ContractLayout, StepTerms, level_money

NEAR = 1e-6  # of a node's number: a balance this near to a node is on it
positive = partial(np.maximum, 0.0)


class Settling(NamedTuple):
    """The end of one step.

    - `arrive`: the number of the node of the next step for each node after; `lost`: the
      money that settling takes there.
    - `between`: a second such node, and its weight, where balances are between nodes.
    - `held`: money of the nodes before and after a step, which earns the second less the first:
      that of the levels, and of the units made up so far; None without either.
    """

    arrive: np.ndarray
    lost: np.ndarray
    between: tuple[np.ndarray, np.ndarray] | None = None
    held: tuple[np.ndarray, np.ndarray] | None = None

    def settled(self, value: np.ndarray) -> np.ndarray:
        """[modes, nodes after, …] after settling, from [modes, nodes of the next step, …]."""
        if self.between is None:
            return value[:, self.arrive]
        other, weight = self.between[0], self.between[1][:, None]
        return (1 - weight) * value[:, self.arrive] + weight * value[:, other]

    @property
    def money(self) -> np.ndarray | None:
        """[nodes after] that levels, settling and units made up earn; None where there is none."""
        if self.held is not None:
            return self.held[1] - self.lost
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
    held = _held(terms, t, before, after)
    if terms.bank is None or not terms.restarts[t, 0]:
        return Settling(numbers.reshape(shape)[np.ix_(*arrivals)].ravel(), lost, None, held)
    bank = terms.bank.at(t)
    counted, balance = _mesh(after)
    missed = np.ravel(positive(bank.owed(balance, positive) - counted))
    goal = np.ravel(bank.settled(counted, balance, positive))
    position = np.interp(goal, following[1], np.arange(len(following[1]), dtype=float))
    left = np.floor(position + NEAR).astype(int)
    share = np.where(position - left > NEAR, position - left, 0.0)
    right = np.minimum(left + 1, len(following[1]) - 1)
    between = (right, share) if share.any() else None
    return Settling(left, missed * terms.short[t, 0], between, held)


def _held(terms: StepTerms, t: int, before, after) -> tuple[np.ndarray, np.ndarray] | None:
    """Money of the nodes before and after step t; None where levels have none."""
    result = [np.zeros(1), np.zeros(1)]
    if terms.bank is not None:
        bank = terms.bank.at(t)
        result = [bank.made_up(*_mesh(x), positive) * bank.refund for x in (before, after)]
    if terms.of_levels is not None:
        for k, (rates, nodes) in enumerate(zip(terms.of_levels, (before, after))):
            levels = np.meshgrid(*nodes, indexing="ij", sparse=True)
            result[k] = result[k] + level_money(rates[t], levels, positive)
    if terms.bank is None and terms.of_levels is None:
        return None
    return np.ravel(result[0]), np.ravel(result[1])


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
