"""Profit and loss of a contract with its hedge, on simulated paths.

After the flow of each day t a hedge holds the volume h(d) sold forward on each later day d, equal
on all days of a product, until the next day:

    money = contract - sum over t, d of D(d) h_t(d) [F_{t+1}(d) - F_t(d)] - sum of b D(d) |trade|

A trade is the change of h from the day before, and b is half the spread of its product. Delivery is
settled at the spot price, without a spread.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from snapo.lanes.machine.threads import cores

from . import MIN_VARIANCE, DailyHedge
from .exposures import Days, FittedExposures, StorePaths, sensitivities
from .held import HeldProduct, HeldProducts, Overnight

SEPARATE = 1e-9  # of the squared risk of a product, added: products that move together share


class HedgeGain(NamedTuple):
    """The result of one family of products on paths [N]: the gain after costs, the cost of the
    spread, and the volume traded."""

    gain: np.ndarray
    cost: np.ndarray
    traded: np.ndarray

    def joined(self, other: "HedgeGain") -> "HedgeGain":
        return HedgeGain(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


HedgeGains = dict[str, HedgeGain]  # by family


class HeldVolume(NamedTuple):
    """A product, with the volume per day [N] of it that is sold."""

    row: HeldProduct
    volume: np.ndarray


def static(paths: StorePaths, rows: HeldProducts, volumes: np.ndarray, first: int) -> HedgeGains:
    """The gains of a static hedge: volumes per day [T + 1] that are sold today, for the days after
    step `first`, equal on all days of a product.

    The volume of a product is the mean of `volumes` over its days, weighted with today's discounted
    prices.
    """
    account = HedgeAccount(paths.discount, paths.count)
    weights = paths.discount * paths.moving(paths.forward)
    change = paths.paid(0, paths.curves.spots - paths.forward[:, None])
    positions = []
    for row in rows:
        days = slice(max(row.block.first, first + 1), row.block.after)
        mean = np.average(volumes[days], weights=weights[days])
        volume = _in_lots(np.full(paths.count, mean), row.block.lot)
        account.gain[row.family] -= volume * change[days].sum(axis=0)
        positions.append(HeldVolume(row, volume))
    account.trade([], positions, first)
    return account.gains


@dataclass(frozen=True, eq=False)
class DailyHedges:
    """Daily hedges in traded products."""

    overnight: Overnight
    hedges: Sequence[DailyHedge]

    def simulated(self, fit: StorePaths, paths: StorePaths) -> list[HedgeGains]:
        """The gains of each hedge on `paths`, with exposures that are fitted on the other paths
        `fit`."""
        first = self.overnight.first
        rows = {t: self.held(t) for t in range(first, fit.horizon)}
        exposures = FittedExposures.of(fit, {t: different(row) for t, row in rows.items()})

        def gains(part: StorePaths) -> list[HedgeGains]:
            return self._gains(exposures, rows, part)

        with ThreadPoolExecutor(cores()) as pool:
            parts = list(pool.map(gains, paths.blocks))
        return [_joined(of) for of in zip(*parts, strict=True)]

    def held(self, t: int) -> list[HeldProducts]:
        """The products that each hedge holds from step t on."""
        return [self.overnight.of(hedge, t) for hedge in self.hedges]

    def positions(
        self,
        exposures: FittedExposures,
        t: int,
        part: StorePaths,
        rows: Sequence[HeldProducts],
        moving: np.ndarray,
    ) -> list[list[HeldVolume]]:
        """The volumes that each hedge sells in its products `rows` after the flow of step t.

        `moving` [T - t, N]: the part of the discounted prices of the later dates that noise moves.
        """
        volumes, factors = exposures.at(t, part, moving)
        volume_of = dict(zip(exposures.products[t], volumes, strict=True))

        def sold(hedge: DailyHedge, held_rows: HeldProducts) -> Sequence[np.ndarray]:
            if hedge.rule == MIN_VARIANCE:
                return _minimum_variance(part, t, held_rows, moving, factors)
            return [volume_of[_days(row)] for row in held_rows]

        return [
            [
                HeldVolume(row, _in_lots(volume, row.block.lot))
                for row, volume in zip(held_rows, sold(hedge, held_rows), strict=True)
            ]
            for hedge, held_rows in zip(self.hedges, rows, strict=True)
        ]

    def _gains(
        self,
        exposures: FittedExposures,
        rows: Mapping[int, Sequence[HeldProducts]],
        part: StorePaths,
    ) -> list[HedgeGains]:
        accounts = [HedgeAccount(part.discount, part.count) for _ in self.hedges]
        before: list[list[HeldVolume]] = [[] for _ in self.hedges]
        ahead = part.ahead(self.overnight.first)
        for t, step in rows.items():
            next_curve = part.curves(t + 1)
            moving = part.paid(t + 1, part.moving(ahead))
            now = self.positions(exposures, t, part, step, moving)
            change = OvernightChange(part.discount, next_curve - ahead, t)
            for account, old, new in zip(accounts, before, now, strict=True):
                account.trade(old, new, t)
                account.hold(new, change)
            before, ahead = now, next_curve[1:]
        return [account.gains for account in accounts]


def _minimum_variance(
    part: StorePaths, t: int, rows: HeldProducts, moving: np.ndarray, exposure: np.ndarray
) -> Sequence[np.ndarray]:
    """The volumes [products, N] that minimise the variance of the next day.

    Products whose prices move together share the volume.
    """
    if not rows:
        return []
    by_factor, shock = sensitivities(part.factors, t), part.factors.shock[t + 1]
    changes = np.array([
        by_factor[row.block.first - t - 1 : row.block.after - t - 1].T
        @ moving[row.block.first - t - 1 : row.block.after - t - 1]
        for row in rows
    ])  # fmt: skip
    risks = np.einsum("pfn,fg->npg", changes, shock)
    target = np.einsum("fn,fg->ng", exposure, shock)
    sizes = np.sqrt(np.maximum(np.sum(risks**2, axis=2), 1e-300))
    unit = risks / sizes[:, :, None]
    square = unit @ np.swapaxes(unit, 1, 2) + SEPARATE * np.eye(len(rows))
    return (np.linalg.solve(square, unit @ target[:, :, None])[:, :, 0] / sizes).T


class OvernightChange:
    """The `change` [T - t, N] of the prices of the dates after step t, discounted.

    Its sum over the days of a product is computed once for all hedges that hold the product.
    """

    def __init__(self, discount: np.ndarray, change: np.ndarray, t: int):
        self._next, self._money = t + 1, discount[t + 1 :, None] * change
        self._sums: dict[Days, np.ndarray] = {}

    def over(self, days: Days) -> np.ndarray:
        """[N] the sum over these days; days that are already delivered do not count."""
        if days not in self._sums:
            first, after = (max(day - self._next, 0) for day in days)
            self._sums[days] = self._money[first:after].sum(axis=0)
        return self._sums[days]


class HedgeAccount:
    """The sums of a hedge by family, on `count` paths; `discount` [T + 1]: the discount factors of
    payments by date."""

    def __init__(self, discount: np.ndarray, count: int):
        self.discount, self.count = discount, count
        self.gain: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(count))
        self.cost: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(count))
        self.traded: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(count))

    def hold(self, positions: Sequence[HeldVolume], change: OvernightChange) -> None:
        """Adds the gain of positions from a change of the prices."""
        for row, volume in positions:
            self.gain[row.family] -= volume * change.over(_days(row))

    def trade(self, before: Sequence[HeldVolume], now: Sequence[HeldVolume], t: int) -> None:
        """Trades the differences between two sets of positions for days after step t, at the spread
        of the product that is held afterwards."""
        marks = {x for row, _ in (*before, *now) for x in (row.block.first, row.block.after)}
        marks = sorted({max(x, t + 1) for x in marks})
        nothing = np.zeros(self.count)
        for first, after in pairwise(marks):
            old, new = (_on(positions, first) for positions in (before, now))
            row = new or old
            if row is None:
                continue
            (_, block, family), _ = row
            volume = np.abs((new.volume if new else nothing) - (old.volume if old else nothing))
            self.traded[family] += (after - first) * volume
            self.cost[family] += block.spread * self.discount[first:after].sum() * volume

    @property
    def gains(self) -> HedgeGains:
        return {
            family: HedgeGain(gain - self.cost[family], self.cost[family], self.traded[family])
            for family, gain in self.gain.items()
        }


def _on(positions: Sequence[HeldVolume], day: int) -> HeldVolume | None:
    return next((x for x in positions if x.row.block.first <= day < x.row.block.after), None)


def _in_lots(volume: np.ndarray, lot: float) -> np.ndarray:
    """The nearest multiples of a lot; the volume itself if the lot is 0."""
    return np.round(volume / lot) * lot if lot > 0 else volume


def _days(row: HeldProduct) -> Days:
    return row.block.first, row.block.after


def different(rows: Sequence[HeldProducts]) -> list[Days]:
    """The days of all products, without duplicates."""
    return list(dict.fromkeys(_days(row) for held_rows in rows for row in held_rows))


def _joined(parts: Sequence[HedgeGains]) -> HedgeGains:
    gains = dict(parts[0])
    for part in parts[1:]:
        gains = {family: gain.joined(part[family]) for family, gain in gains.items()}
    return gains
