"""The end of a step on a grid: the money of the levels, their restarts, and the new balances of a
bank."""

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from ..core.contract import ContractLayout, StepTerms, level_money

NEAR = 1e-6  # of a node's number: a balance this near to a node is on it
ROUND_OFF = 1e-9  # of the largest level
positive = partial(np.maximum, 0.0)


class Settling(NamedTuple):
    """The end of one step.

    - `arrive`: for each node after the step, the number of its node of the next step; `lost`: the
      amount lost at the node.
    - `corners`: the nodes around the new levels and their weights, if balances lie between nodes.
    - `held`: the amounts that the levels and the units made up have earned so far, at the nodes
      before and after the step; the step earns the difference. None if the levels earn nothing.
    - `missed` [modes, nodes after]: the charge for violated joint limits; None without limits.
    """

    arrive: np.ndarray
    lost: np.ndarray
    corners: tuple[tuple[np.ndarray, np.ndarray], ...] | None = None
    held: tuple[np.ndarray, np.ndarray] | None = None
    missed: np.ndarray | None = None

    def settled(self, value: np.ndarray) -> np.ndarray:
        """The values [modes, nodes after, …] before settling, from those [modes, nodes of the next
        step, …] after it."""
        if self.corners is None:
            return value[:, self.arrive]
        parts = [weight[:, None] * value[:, nodes] for nodes, weight in self.corners]
        return sum(parts[1:], parts[0])

    @property
    def money(self) -> np.ndarray | None:
        """[nodes after], or [modes, nodes after] with joint limits: the earnings of the levels, of
        settling and of units made up; None if there are none."""
        lost = self.lost if self.missed is None else self.lost + self.missed
        if self.held is not None:
            return self.held[1] - lost
        return -lost if lost.any() else None


def settling(
    layout: ContractLayout, terms: StepTerms, t: int, before, after, following
) -> Settling:
    """The end of step t: from the nodes `after` its moves to the nodes at the start of the
    `following` step."""
    arrivals, lost = [], np.zeros(1)
    for i, points in enumerate(after):
        restarts = bool(terms.restarts[t, i])
        arrivals.append(np.zeros(len(points), int) if restarts else np.arange(len(points)))
        missed = np.maximum(terms.owed[t, i] - points, 0.0) if restarts else np.zeros(len(points))
        amount = missed * terms.short[t, i] if restarts else missed
        lost = (lost[:, None] + amount[None, :]).ravel()
    numbers = np.arange(math.prod(map(len, following)))
    shape = [len(x) for x in following]
    held, missed = _held(terms, t, before, after), _missed(terms, t, after)
    if terms.bank is None or not terms.restarts[t, 0]:
        arrive = numbers.reshape(shape)[np.ix_(*arrivals)].ravel()
        return Settling(arrive, lost, None, held, missed)
    bank = terms.bank.at(t)
    counted, *balances = np.meshgrid(*after, indexing="ij")
    missed = np.ravel(positive(bank.owed(balances, positive) - counted))
    weight, goals = np.ones(missed.shape), bank.settled(counted, balances, positive)
    corners = [(np.zeros(missed.shape, int), weight)]
    for nodes, goal in zip(following[1:], goals):
        position = np.interp(np.ravel(goal), nodes, np.arange(len(nodes), dtype=float))
        left = np.floor(position + NEAR).astype(int)
        share = np.where(position - left > NEAR, position - left, 0.0)
        sides = [(left, 1 - share)]
        if share.any():
            sides.append((np.minimum(left + 1, len(nodes) - 1), share))
        corners = [(n * len(nodes) + m, x * y) for n, x in corners for m, y in sides]
    several = tuple(corners) if len(corners) > 1 else None
    return Settling(corners[0][0], missed * terms.short[t, 0], several, held)


def _missed(terms: StepTerms, t: int, after) -> np.ndarray | None:
    """[modes, nodes after] the charge for joint limits that are violated after step t."""
    promises = terms.promises
    if promises is None or promises.missed is None:
        return None
    levels = np.stack([np.ravel(x) for x in np.meshgrid(*after, indexing="ij")])
    sums = promises.weights[t] @ levels
    units = positive(promises.minimum[t][:, :, None] - sums[:, None])
    units[units < ROUND_OFF * max(1.0, float(np.abs(levels).max(initial=0.0)))] = 0.0
    return promises.missed[t] * units.sum(axis=0)


def _held(terms: StepTerms, t: int, before, after) -> tuple[np.ndarray, np.ndarray] | None:
    """The money of the levels and units made up at the nodes before and after step t; None if they
    have no money."""
    result = [np.zeros(1), np.zeros(1)]
    if terms.bank is not None:
        bank = terms.bank.at(t)
        meshes = (np.meshgrid(*x, indexing="ij", sparse=True) for x in (before, after))
        result = [bank.made_up(x, balances, positive) * bank.refund for x, *balances in meshes]
    if terms.of_levels is not None:
        for k, (rates, nodes) in enumerate(zip(terms.of_levels, (before, after))):
            levels = np.meshgrid(*nodes, indexing="ij", sparse=True)
            result[k] = result[k] + level_money(rates[t], levels, positive)
    if terms.bank is None and terms.of_levels is None:
        return None
    return np.ravel(result[0]), np.ravel(result[1])


def ranges_of_balances(terms: StepTerms, start: np.ndarray, low: np.ndarray, high: np.ndarray):
    """The smallest and the largest value of each balance at the start of each step, [T + 1].

    `start` [balances]: the balances at the start; `low`, `high` [T + 1]: the range of the counted
    level, at the start and after each step.
    """
    assert terms.bank is not None
    lowest, highest = (np.tile(start, (len(low), 1)) for _ in range(2))
    for t in range(len(low) - 1):
        lowest[t + 1], highest[t + 1] = lowest[t], highest[t]
        if terms.restarts[t, 0]:
            bank = terms.bank.at(t)
            lowest[t + 1] = bank.settled(high[t + 1], lowest[t], positive)
            highest[t + 1] = bank.settled(low[t + 1], highest[t], positive)
    return list(zip(lowest.T, highest.T))
