"""Sums of contracts, with errors from shares: the same batch of paths is the same world in each.

A sum's share of a batch is the sum of its contracts' shares times their quantities. Contracts of one
market share their paths; markets are independent, so that their errors add in squares.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from snapo.solver import statistics


class Sum(NamedTuple):
    """A sum under a stress, and its change against the base on the same paths."""

    value: float
    standard_error: float
    change: float
    change_error: float


class Holding(NamedTuple):
    """A contract of the book: its market, its quantity, and {stress: shares [B]} with the base."""

    market: str
    quantity: float
    shares: Mapping[str, np.ndarray]


def total(holdings: Iterable[Holding], stress: str, base: str) -> Sum | None:
    """The sum of the holdings under a stress; None where one has no value there."""
    by_market: dict[str, list[Holding]] = {}
    for holding in holdings:
        by_market.setdefault(holding.market, []).append(holding)
    values, changes = [], []
    for members in by_market.values():
        stressed, unstressed = (_shares(members, name) for name in (stress, base))
        if stressed is None or unstressed is None:
            return None
        values.append(statistics.of_shares(stressed))
        changes.append(statistics.of_shares(stressed - unstressed))
    value, change = (sum(x.value for x in parts) for parts in (values, changes))
    errors = [float(np.hypot.reduce([x.standard_error for x in p])) for p in (values, changes)]
    return Sum(float(value), errors[0], float(change), errors[1])


def _shares(members: Sequence[Holding], stress: str) -> np.ndarray | None:
    """[B] the shares of a market's contracts together; of the coarsest batches of all."""
    shares = [member.shares.get(stress) for member in members]
    if any(x is None or not np.isfinite(x).all() for x in shares):
        return None
    count = min(len(x) for x in shares if x is not None)
    parts = [
        x.reshape(count, -1).mean(1) * m.quantity for x, m in zip(shares, members) if x is not None
    ]
    return np.sum(parts, 0)
