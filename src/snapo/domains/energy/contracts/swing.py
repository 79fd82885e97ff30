"""Swing: a daily volume at a strike, within limits of each contract year, with take-or-pay.

    earnings = sum over days of discount x q (S - strike),   strike a number, or factor I + add
               - sum over years of discount x shortfall x max(annual minimum - taken, 0)

with minimum <= q <= maximum on each day and, in each contract year, at most the annual maximum, and
at least the annual minimum if it is firm. I is the month-ahead index, see
`gas_storage.prices.index`. Source: P. Jaillet, E. Ronn, S. Tompaidis, "Valuation of commodity-based
swing options", Management Science 50 (2004).
"""

import datetime
from collections.abc import Mapping

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.table import TableContext
from snapo.problem.record import field
from snapo.problem.record.arrays import Array, Bool, NumbersOf
from snapo.problem.record.either import backwards, xp

from ...gas_storage.prices.index import ONE_FACTOR, indexed
from ...gas_storage.prices.process import Delivery, PriceProcess
from ..core.bank import Bank
from ..core.contract import (
    ContractLayout,
    ContractMove,
    EnergyContract,
    EnergyFlow,
    Level,
    Promises,
    StepTerms,
    Terms,
)

FREE = "free"  # the mode in which a right may be used
BANKS = "bank", "older bank"  # units of last year, and of the year before


class SwingContract(EnergyContract):
    """The terms of a swing contract.

    - `max_daily`, `min_daily`, `strike`: index [T]; `annual_min`, `annual_max`, `taken`: [].
    - `factor`, `add`, `fixing`: the numbers of an indexed strike, index []; `strike` is then None.
    - `shortfall`: the price of each unit short of the minimum, index []; None if the minimum is
      firm, or if the shortfall is paid at the strike.
    - `year_ends` [T]: whether a day is the last one of a contract year.
    - `make_up_price`, `made_up`: the price of a unit made up, and the units of last year that may
      be made up; `older`: the units of the year before that, None if units are lost after one year.
      `carry_max`, `carried`: the maximum that is carried forward, and the amount by which the
      minimum of this year is lower. All are None without their clause.
    - `sign`: 1 if the volume is bought at the strike, -1 if it is sold.
    - `at_strike`: whether the shortfall is paid at the strike of the last day.
    - `firm`: whether the minimum is met on every path; `most_rights`: the number of rights, 0
      without rights.
    """

    max_daily: CaseInput
    min_daily: CaseInput
    strike: CaseInput | None
    factor: CaseInput | None
    add: CaseInput | None
    fixing: CaseInput | None
    annual_min: CaseInput | None
    annual_max: CaseInput | None
    taken: CaseInput
    shortfall: CaseInput | None
    make_up_price: CaseInput | None
    made_up: CaseInput | None
    older: CaseInput | None
    carry_max: CaseInput | None
    carried: CaseInput | None
    year_ends: Bool[np.ndarray, " T"]
    layout: ContractLayout = field(static=True)
    sign: float = field(static=True)
    at_strike: bool = field(static=True)
    firm: bool = field(static=True)
    most_rights: int = field(static=True)

    def terms(self, at: NumbersOf, paid: Array, settled: Array) -> Terms:
        count = len(self.year_ends)
        names = [level.name for level in self.layout.levels]
        strike = at(self.add if self.strike is None else self.strike)  # pyright: ignore
        index = None
        if self.factor is not None:
            index = (-self.sign * at(self.factor) * paid)[:, None]
        most, zero = at(self.max_daily), xp.zeros(count)
        low, high, owed, short, again, start = [], [], [], [], [], []
        everything = xp.sum(most) + at(self.taken)
        if "taken" in names:
            least = zero if self.annual_min is None else at(self.annual_min) + zero
            ceiling = everything if self.annual_max is None else at(self.annual_max)
            money = zero
            if self.shortfall is not None:
                money = at(self.shortfall) * settled
            elif self.at_strike:
                money = strike * settled
            firm = self.firm and not (self.most_rights or self.layout.banks)
            low.append(xp.where(self.year_ends & firm, least, 0.0))
            high.append(ceiling + zero)
            owed.append(zero if firm else least)
            short.append(money)
            again.append(xp.asarray(self.year_ends))
            start.append(at(self.taken))
        if "rights" in names:
            low.append(zero)
            high.append(zero + self.most_rights)
            owed.append(zero)
            short.append(zero)
            again.append(xp.zeros(count, bool))
            start.append(xp.zeros(()))
        bank = None
        if self.layout.banks:
            bank = self._bank(at, strike, paid)
            newest = _number(at, self.made_up) - _number(at, self.carried)
            for age, units in enumerate((newest, _number(at, self.older))[: self.layout.banks]):
                low.append(zero if age else -bank.limit)
                high.append(bank.share * bank.minimum)
                owed.append(zero)
                short.append(zero)
                again.append(xp.zeros(count, bool))
                start.append(units)

        def by_level(rows: list) -> Array:
            return xp.stack(rows, axis=1) if rows else xp.zeros((count, 0))

        steps = StepTerms(
            at(self.min_daily)[:, None],
            most[:, None],
            (self.sign * paid)[:, None],
            (-self.sign * strike * paid)[:, None],
            by_level(low),
            by_level(high),
            by_level(owed),
            by_level(short),
            xp.stack(again, axis=1) if again else xp.zeros((count, 0), bool),
            xp.zeros((count, len(self.layout.every_move))),
            index,
            self._promises(at),
            bank,
        )
        return Terms(xp.stack(start) if start else xp.zeros(0), steps)

    def _promises(self, at: NumbersOf) -> Promises | None:
        """The promises of a firm minimum with rights, in one contract year. The part of the minimum
        not yet taken is at most the largest daily volume times the number of rights left, and at
        most that volume times the number of days that are left between rests."""
        if not self.firm or self.annual_min is None:
            return None
        if self.layout.banks:
            return self._carried(at)
        if not self.most_rights:
            return None
        minimum, daily = at(self.annual_min), at(self.max_daily)[0]
        count, modes = len(self.year_ends), len(self.layout.modes)
        left = np.arange(count - 1, -1, -1)
        waits = np.append(0, np.arange(modes - 1, 0, -1))
        days = np.maximum(np.ceil((left[:, None] - waits) / modes), 0.0)
        rights = xp.full((count, modes), minimum - daily * self.most_rights)
        weights = xp.stack([xp.array([1.0, 0.0]), xp.stack([xp.ones(()), -daily])])
        bounds = xp.stack([minimum - daily * days, rights], axis=1)
        return Promises(xp.broadcast_to(weights, (count, 2, 2)), bounds)

    def _carried(self, at: NumbersOf) -> Promises:
        """The promises of a firm minimum from which the units carried forward are subtracted. The
        part of it not yet taken is at most the volume of the days that are left in the year."""
        daily = at(self.max_daily)
        following = xp.append(daily[1:], 0.0)

        def back(left, row):
            return xp.where(row[0], 0.0, left + row[1])

        rows = xp.asarray(self.year_ends), following
        left = backwards(back, xp.zeros(()), rows, len(daily))
        minimum = at(self.annual_min) - left  # pyright: ignore[reportArgumentType]
        weights = xp.broadcast_to(xp.array([1.0, -1.0]), (len(daily), 1, 2))
        return Promises(weights, minimum[:, None, None])

    def _bank(self, at: NumbersOf, strike: Array, paid: Array) -> Bank:
        """Units short may be made up, units in excess are carried forward."""
        zero, price = xp.zeros(len(self.year_ends)), self.make_up_price
        return Bank(
            zero + _number(at, self.annual_min),
            zero + (price is not None),
            zero + _number(at, self.carry_max),
            zero if price is None else (strike - at(price)) * paid,
        )

    def keys_at(self, levels: Mapping[str, float], mode: str, index: float | None) -> dict:
        keys = {"taken": levels["taken"]} if "taken" in levels else {}
        if "rights" in levels:
            if mode != FREE:
                raise ValueError(f'no contract can begin in the mode "{mode}"')
            keys["rights.most"] = self.most_rights - round(levels["rights"])
        if self.made_up is not None:
            keys["make_up.units"] = max(levels[BANKS[0]], 0.0)
        if self.older is not None:
            keys["make_up.older_units"] = max(levels[BANKS[1]], 0.0)
        if self.carried is not None:
            keys["carry_forward.units"] = max(-levels[BANKS[0]], 0.0)
        if index is not None:
            keys["strike.fixing"] = index
        return keys

    def priced(self, where: TableContext, prices: PriceProcess, delivery: Delivery) -> PriceProcess:
        if not self.layout.indexed:
            return prices
        if prices.calendar:
            message = (
                "with an indexed strike, flows are fixed on the day of the flow; leave out this key"
            )
            raise where.error("nomination", None, message)
        if prices.kind not in ONE_FACTOR:
            allowed = ", ".join(f'"{kind}"' for kind in ONE_FACTOR)
            message = f"with an indexed strike it must be {allowed}"
            raise CaseError(str(where.file), "model.kind", prices.kind, message)
        first, month = delivery.dates[0], delivery.dates[0].replace(day=1)
        if delivery.end.day != 1:
            message = "with an indexed strike it must be the first day of a month"
            raise where.error("end", delivery.end, message)
        if self.fixing is None and first != month:
            message = f"the index of {first:%Y-%m} was fixed before today: specify it as `fixing`"
            raise where.error("strike.fixing", None, message)
        if self.fixing is not None and delivery.valuation < month - datetime.timedelta(1):
            message = f"the index of {first:%Y-%m} is not fixed yet: leave out this key"
            raise where.error("strike.fixing", float(self.fixing.values[0]), message)
        return indexed(prices, delivery, self.fixing)


def _number(at: NumbersOf, number: CaseInput | None) -> Array:
    return xp.zeros(()) if number is None else at(number)


def layout_of(
    unit: str, limited: bool, rest: int | None, indexed: bool = False, banks: int = 0
) -> ContractLayout:
    """Levels, flows and moves; `rest`: days of rest after the use of a right, None without rights.

    `banks`: the number of balances between years. With them there are annual limits, but no rights.
    """
    if banks:
        take = EnergyFlow("take", f"{unit}/day", (1.0, *(0.0,) * banks))
        levels = tuple(Level(name, unit) for name in ("taken", *BANKS[:banks]))
        return ContractLayout(levels, (take,), indexed=indexed, banks=banks)
    levels = ([Level("taken", unit)] if limited else []) + (
        [Level("rights", "days")] if rest is not None else []
    )
    take = EnergyFlow("take", f"{unit}/day", (1.0,) * limited + (0.0,) * (rest is not None))
    if rest is None:
        return ContractLayout(tuple(levels), (take,), indexed=indexed)
    none, one = (0.0,) * len(levels), (0.0,) * limited + (1.0,)
    modes = (FREE, *(f"rest {i}" for i in range(rest, 0, -1)))
    moves = [
        ContractMove("wait", 0, 0, (), none),
        ContractMove("use", 0, min(1, rest), (0,), one),
    ]
    moves += [
        ContractMove("rest", i, (i + 1) % len(modes), (), none) for i in range(1, len(modes))
    ]  # fmt: skip
    return ContractLayout(tuple(levels), (take,), modes, tuple(moves), indexed)
