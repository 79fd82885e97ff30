"""Swing: a volume a day at a strike, within limits of each contract year; take-or-pay.

    earnings = sum over days of discount x q (S - strike),   strike a number, or factor I + add
               - sum over years of discount x shortfall x max(annual minimum - taken, 0)

with least <= q <= most on each day and, over each contract year, at most the annual maximum, and at
least its minimum where that is firm. I is the month-ahead index, see `gas_storage.prices.index`.
Source: A. Jaillet, E. Ronn, S. Tompaidis, "Valuation of
commodity-based swing options", Management Science 50 (2004).
"""

import datetime
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.table import TableContext

from ...gas_storage.prices.index import ONE_FACTOR, indexed
from ...gas_storage.prices.process import Delivery, PriceProcess, use
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


class SwingContract(EnergyContract):
    """The terms of a swing contract.

    - `max_daily`, `min_daily`, `strike`: index [T]; `annual_min`, `annual_max`, `taken`: [].
    - `factor`, `add`, `known`: of a strike that follows an index, index []; `strike` is None then.
    - `shortfall`: money for each unit, index []; None: the minimum is firm, or paid at the strike.
    - `year_ends` [T]: whether a day is the last one of a contract year.
    - `sign`: 1 where the volume is bought at the strike, -1 where it is sold.
    - `at_strike`: whether what is short is paid at the strike of the last day.
    - `rest`: days between two uses of a right; `limited`: whether there are annual limits.
    """

    max_daily: CaseInput
    min_daily: CaseInput
    strike: CaseInput | None
    factor: CaseInput | None
    add: CaseInput | None
    known: CaseInput | None
    annual_min: CaseInput | None
    annual_max: CaseInput | None
    taken: CaseInput
    shortfall: CaseInput | None
    year_ends: Bool[np.ndarray, " T"]
    layout: ContractLayout = eqx.field(static=True)
    sign: float = eqx.field(static=True)
    at_strike: bool = eqx.field(static=True)
    firm: bool = eqx.field(static=True)
    most_rights: int = eqx.field(static=True)

    def terms(self, inputs: dict[str, Any], paid: Array, settled: Array) -> Terms:
        count = len(self.year_ends)
        names = [level.name for level in self.layout.levels]
        strike = use(inputs, self.add if self.strike is None else self.strike)  # pyright: ignore
        index = None
        if self.factor is not None:
            index = (-self.sign * use(inputs, self.factor) * paid)[:, None]
        most, zero = use(inputs, self.max_daily), jnp.zeros(count)
        low, high, owed, short, again, start = [], [], [], [], [], []
        everything = jnp.sum(most) + use(inputs, self.taken)
        if "taken" in names:
            least = zero if self.annual_min is None else use(inputs, self.annual_min) + zero
            ceiling = everything if self.annual_max is None else use(inputs, self.annual_max)
            money = zero
            if self.shortfall is not None:
                money = use(inputs, self.shortfall) * settled
            elif self.at_strike:
                money = strike * settled
            promised = self.most_rights > 0
            firm = self.firm and not promised
            low.append(jnp.where(self.year_ends & firm, least, 0.0))
            high.append(ceiling + zero)
            owed.append(zero if firm else least)
            short.append(money)
            again.append(jnp.asarray(self.year_ends))
            start.append(use(inputs, self.taken))
        if "rights" in names:
            low.append(zero)
            high.append(zero + self.most_rights)
            owed.append(zero)
            short.append(zero)
            again.append(jnp.zeros(count, bool))
            start.append(jnp.zeros(()))

        def by_level(rows: list) -> Array:
            return jnp.stack(rows, axis=1) if rows else jnp.zeros((count, 0))

        steps = StepTerms(
            use(inputs, self.min_daily)[:, None],
            most[:, None],
            (self.sign * paid)[:, None],
            (-self.sign * strike * paid)[:, None],
            by_level(low),
            by_level(high),
            by_level(owed),
            by_level(short),
            jnp.stack(again, axis=1) if again else jnp.zeros((count, 0), bool),
            jnp.zeros((count, len(self.layout.every_move))),
            index,
            self._promises(inputs),
        )
        return Terms(jnp.stack(start) if start else jnp.zeros(0), steps)

    def _promises(self, inputs: dict[str, Any]) -> Promises | None:
        """Of a firm minimum with rights, in one contract year: the rest of it is at most the most
        volume of a day, times the rights left, and times the days that rests leave."""
        if not (self.firm and self.most_rights and self.annual_min is not None):
            return None
        least, most = use(inputs, self.annual_min), use(inputs, self.max_daily)[0]
        count, modes = len(self.year_ends), len(self.layout.modes)
        left = np.arange(count - 1, -1, -1)
        waits = np.append(0, np.arange(modes - 1, 0, -1))
        days = np.maximum(np.ceil((left[:, None] - waits) / modes), 0.0)
        rights = jnp.full((count, modes), least - most * self.most_rights)
        weights = jnp.stack([jnp.array([1.0, 0.0]), jnp.stack([jnp.ones(()), -most])])
        bounds = jnp.stack([least - most * days, rights], axis=1)
        return Promises(jnp.broadcast_to(weights, (count, 2, 2)), bounds)

    def priced(self, where: TableContext, prices: PriceProcess, delivery: Delivery) -> PriceProcess:
        if not self.layout.indexed:
            return prices
        if prices.kind not in ONE_FACTOR:
            allowed = ", ".join(f'"{kind}"' for kind in ONE_FACTOR)
            message = f"with a strike that follows an index allowed is {allowed}"
            raise CaseError(str(where.file), "model.kind", prices.kind, message)
        first, month = delivery.dates[0], delivery.dates[0].replace(day=1)
        if delivery.end.day != 1:
            message = "with a strike that follows an index allowed is the first day of a month"
            raise where.error("end", delivery.end, message)
        if self.known is None and first != month:
            message = f"the index of {first:%Y-%m} was fixed before today: give it as `known`"
            raise where.error("strike.known", None, message)
        if self.known is not None and delivery.valuation < month - datetime.timedelta(1):
            message = f"the index of {first:%Y-%m} is fixed on the last day before that month"
            raise where.error("strike.known", float(self.known.values[0]), message)
        return indexed(prices, delivery, self.known)


def layout_of(unit: str, limited: bool, rest: int | None, indexed: bool = False) -> ContractLayout:
    """Levels, flows and moves; `rest`: days after a right that is used, None without rights."""
    levels = ([Level("taken", unit)] if limited else []) + (
        [Level("rights", "days")] if rest is not None else []
    )
    take = EnergyFlow("take", f"{unit}/day", (1.0,) * limited + (0.0,) * (rest is not None))
    if rest is None:
        return ContractLayout(tuple(levels), (take,), indexed=indexed)
    none, one = (0.0,) * len(levels), (0.0,) * limited + (1.0,)
    modes = ("free", *(f"rest {i}" for i in range(rest, 0, -1)))
    moves = [
        ContractMove("wait", 0, 0, (), none),
        ContractMove("use", 0, min(1, rest), (0,), one),
    ]
    moves += [
        ContractMove("rest", i, (i + 1) % len(modes), (), none) for i in range(1, len(modes))
    ]  # fmt: skip
    return ContractLayout(tuple(levels), (take,), modes, tuple(moves), indexed)
