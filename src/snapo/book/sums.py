"""Sums of contracts, with errors from shares: a batch of paths has the same scenarios in all
contracts.

A sum's share of a batch is the sum of the shares of its contracts. Contracts of one market share
their paths; markets are independent, so the squares of their errors add up.
"""

import math
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from snapo.solver import statistics


class Sum(NamedTuple):
    """A sum under a stress, and its change against the base on the same paths.

    The errors are None if the positions of a market are not valued on common paths.
    """

    value: float
    standard_error: float | None
    change: float
    change_error: float | None


@dataclass
class BookTotal:
    """The sum of positions under every stress.

    - `shares`: {market: {stress: [B] the shares of all its positions together}}.
    - `missing`: {stress: positions without a value under it}.
    - `worlds`: {market: the worlds of its positions}.
    """

    base: str
    shares: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    missing: dict[str, int] = field(default_factory=dict)
    worlds: dict[str, set[str]] = field(default_factory=dict)

    def add(self, market: str, shares: Mapping[str, np.ndarray | None], world: str = "") -> None:
        """Adds a position: {stress: its shares [B]}, None if it has no value."""
        self.worlds.setdefault(market, set()).add(world)
        totals = self.shares.setdefault(market, {})
        for stress, x in shares.items():
            if x is None:
                self.missing[stress] = self.missing.get(stress, 0) + 1
            else:
                totals[stress] = _sum(totals[stress], x) if stress in totals else x

    def is_common(self, market: str) -> bool:
        """Whether path p is the same world in all positions of a market."""
        return len(self.worlds.get(market, ())) <= 1

    def at(self, stress: str) -> Sum | None:
        """The sum under a stress; None if a position has no value under it or at the base."""
        if self.missing.get(stress) or self.missing.get(self.base) or not self.shares:
            return None
        values, changes = [], []
        for totals in self.shares.values():
            values.append(statistics.of_shares(totals[stress]))
            changes.append(statistics.of_shares(_sum(totals[stress], -totals[self.base])))
        value, change = (math.fsum(x.value for x in parts) for parts in (values, changes))
        if not all(map(self.is_common, self.shares)):
            return Sum(value, None, change, None)
        errors = [math.hypot(*(x.standard_error for x in parts)) for parts in (values, changes)]
        return Sum(value, errors[0], change, errors[1])

    def mean_change(self, stresses: Sequence[str]) -> tuple[float, float | None]:
        """The mean change over some stresses, and its standard error."""
        means = []
        for totals in self.shares.values():
            parts = [_sum(totals[stress], -totals[self.base]) for stress in stresses]
            means.append(statistics.of_shares(np.mean(parts, 0)))
        error = math.hypot(*(x.standard_error for x in means))
        common = all(map(self.is_common, self.shares))
        return math.fsum(x.value for x in means), error if common else None


def _sum(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The sum of shares. If the numbers of batches differ, both are first averaged over larger
    batches that they can have in common."""
    count = math.gcd(len(x), len(y))
    return x.reshape(count, -1).mean(1) + y.reshape(count, -1).mean(1)


class Risk(NamedTuple):
    """The risk of loss, with the stresses as scenarios of equal weight.

    - `level`: 0.95; `var`: the loss that is not exceeded in this share of the scenarios;
      `shortfall`: the mean loss in the other scenarios; both have the standard errors of Monte
      Carlo.
    """

    level: float
    var: float
    var_error: float | None
    shortfall: float
    shortfall_error: float | None


LEVELS = (0.95, 0.99)


def risks(total: BookTotal, stresses: Sequence[str]) -> list[Risk]:
    """The risk at every level of `LEVELS` that at least one stress exceeds."""
    changes = {stress: total.at(stress) for stress in stresses}
    stored = {stress: x for stress, x in changes.items() if x is not None}
    if len(stored) < len(changes):
        return []
    worst = sorted(stored, key=lambda stress: stored[stress].change)
    rows = []
    for level in LEVELS:
        tail_size = round(len(worst) * (1 - level), 9)
        if tail_size < 1:
            continue
        tail = worst[: int(tail_size)]
        mean, error = total.mean_change(tail)
        at = stored[tail[-1]]
        rows.append(Risk(level, -at.change, at.change_error, -mean, error))
    return rows


@dataclass
class DeltaTotal:
    """The sum of held derivatives of positions, {(market, input, label): [blocks]}."""

    blocks: dict[tuple[str, str, str], np.ndarray] = field(default_factory=dict)

    def without(self, markets: Container[str]) -> "DeltaTotal":
        """The sums of the other markets."""
        return DeltaTotal({key: x for key, x in self.blocks.items() if key[0] not in markets})

    def add(self, key: tuple[str, str, str], blocks: np.ndarray) -> None:
        """Adds the derivatives of a position, [blocks]."""
        self.blocks[key] = _sum(self.blocks[key], blocks) if key in self.blocks else blocks

    def by_month(self) -> "DeltaTotal":
        """The sums of the derivatives whose labels are dates of the same month."""
        months = DeltaTotal()
        for (market, name, label), blocks in self.blocks.items():
            months.add((market, name, label[:7] if _is_date(label) else label), blocks)
        return months

    def estimate(self, key: tuple[str, str, str]) -> tuple[float, float]:
        """The derivative, and its standard error."""
        result = statistics.of_shares(self.blocks[key])
        return result.value, result.standard_error


ExposureKey = tuple[str, str, str, str, str]  # column, label, market, output, unit


@dataclass
class ExposureTotal:
    """The sum of the exposures of positions, {key: {day: [blocks]}}."""

    by_key: dict[ExposureKey, dict[str, np.ndarray]] = field(default_factory=dict)

    def add(self, key: ExposureKey, days: Sequence[str], blocks: np.ndarray) -> None:
        """Adds the exposure of a position, blocks [B, T]."""
        by_day = self.by_key.setdefault(key, {})
        for day, x in zip(days, blocks.T):
            by_day[day] = _sum(by_day[day], x) if day in by_day else x

    def without(self, groups: Container[tuple[str, str, str]]) -> "ExposureTotal":
        """The sums of other groups, which are (column, label, market)."""
        return ExposureTotal({key: x for key, x in self.by_key.items() if key[:3] not in groups})

    def table(self, is_common: Callable[[str], bool]) -> list[dict[str, Any]]:
        """The content in result.json: for each key, rows in the sequence of the days. It has
        errors only if the positions of a market have common paths."""
        rows = []
        for key, by_day in self.by_key.items():
            days = sorted(by_day, key=lambda day: (len(day), day))
            results = [statistics.of_shares(by_day[day]) for day in days]
            names = dict(zip(("by", "label", "market", "output", "unit"), key))
            errors = [x.standard_error for x in results] if is_common(key[2]) else None
            values = [x.value for x in results]
            rows.append({**names, "days": days, "value": values, "standard_error": errors})
        return rows


def _is_date(label: str) -> bool:
    return len(label) >= 10 and label[4:5] == "-" == label[7:8] and label[:4].isdigit()
