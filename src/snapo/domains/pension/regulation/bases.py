"""Technical provisions, low dependency and buy-out, and the payments of a recovery plan.

Each basis discounts the expected payments at annual rates of the curve plus a margin (gilts plus a
margin). Payments, and so mortality, are those of the case on every basis.
"""

import datetime
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.either import with_numpy

from ..market.curve import log_bond
from ..people.liability import paid_at
from ..people.lpi import limited, log_growth
from ..read.cells import TableReader
from ..read.tables import FundingTable
from ..records.case import PensionCase
from ..records.regulation import Funding
from ..results.figures.reconcile import payments
from .in_force import in_force

OWN = {"uk": "uk_funding.toml"}  # rules that come with the package
PROVISIONS, LOW, BUY_OUT = "Technical provisions", "Low dependency", "Buy-out"


@dataclass(frozen=True)
class Basis:
    """One basis: the `margin` over the curve; the `liability` and the `surplus` (assets minus
    liability), in money; the funding `ratio`; the `duration` in years."""

    name: str
    margin: float
    liability: float
    surplus: float
    ratio: float | None
    duration: float


@dataclass(frozen=True)
class Recovery:
    """Level payments of `payment` a year, in money, at the end of each of `years` years; their
    value is the deficit on technical provisions. `total`: their sum. All are 0 without a
    deficit."""

    deficit: float
    years: float
    payment: float
    total: float


@dataclass(frozen=True)
class Bases:
    """All bases, the recovery plan, whether the scheme is at significant maturity, and the date and
    the source of the rules."""

    bases: tuple[Basis, ...]
    recovery: Recovery
    mature: bool
    since: str
    source: str


def read_funding(
    section: TableReader, table: FundingTable | None, day: datetime.date
) -> Funding | None:
    """The bases of a case under the rules in force on `day`; None without the table."""
    if table is None:
        return None

    def made(data: dict[str, Any]) -> Funding:
        low = (
            float(data["low_dependency"]) if table.low_dependency is None else table.low_dependency
        )
        return Funding(
            since=data["from"].isoformat(),
            source=str(data["source"]),
            margins={PROVISIONS: table.technical_provisions, LOW: low, BUY_OUT: table.buy_out},
            significant_maturity=float(data["significant_maturity"]),
            longest=float(data["recovery_years"]),
            mature=float(data["mature_recovery_years"]),
            recovery_years=table.recovery_years,
        )

    return in_force(section, table.rules, OWN, day, made)


class Due(NamedTuple):
    """Expected payments `flow` [N], with the loading for their expenses, their `discount` factors
    and their times in `years`.

    `deflator`: the price index now divided by the expected index at these times, if the factors
    discount payments in units of the index; their product discounts money. 1 if the factors already
    do.
    """

    flow: np.ndarray
    discount: np.ndarray
    years: np.ndarray
    deflator: np.ndarray | float = 1.0


def due(case: PensionCase, inputs: dict[str, Any]) -> Due:
    """The expected payments, discounted on the basis of the case. They include the expected
    increases of a limited indexation."""
    flow, discount = with_numpy(payments)(case, inputs)
    steps, deflator = paid_at(case, np.arange(len(flow))), 1.0
    if case.liability.future_indexation == "full":
        break_even = case.inflation.break_even
        deflator = np.exp(with_numpy(log_bond)(break_even, inputs, steps * case.step))
    if limited(case):
        grown = np.exp(with_numpy(log_growth)(case, inputs)[steps])
        flow, discount = flow * grown, discount / grown
    return Due(flow, discount, steps * case.step, deflator)


def bases(case: PensionCase, inputs: dict[str, Any]) -> Bases:
    """Every basis side by side. If payments follow prices, margins are over real rates."""
    plain = replace(case, liability=replace(case.liability, basis="risk-free"))
    return side_by_side(case, due(plain, inputs))


def side_by_side(case: PensionCase, paid: Due) -> Bases:
    """The results of `bases`, from expected payments that are discounted on the curve without a
    margin."""
    assert case.funding is not None
    assets = float(case.assets.amount.used())
    funding = case.funding
    rows = tuple(_basis(name, margin, paid, assets) for name, margin in funding.margins.items())
    mature = next(item for item in rows if item.name == LOW).duration
    old = mature <= funding.significant_maturity
    years = funding.recovery_years
    if years is None:
        years = funding.mature if old else funding.longest
    recovery = _recovery(rows[0], paid, years)
    return Bases(rows, recovery, old, funding.since, funding.source)


def discounted(paid: Due, margin: float) -> np.ndarray:
    """Discount factors at annual rates of the curve plus a margin."""
    years = np.where(paid.years > 0, paid.years, 1.0)
    rate = paid.discount ** (-1 / years) - 1 + margin
    return np.where(paid.years > 0, (1 + rate) ** -years, paid.discount)


def _basis(name: str, margin: float, paid: Due, assets: float) -> Basis:
    value = paid.flow * discounted(paid, margin)
    total = float(value.sum())
    duration = float(value @ paid.years) / (total or 1.0)
    return Basis(name, margin, total, assets - total, assets / (total or np.nan), duration)


def _recovery(provisions: Basis, owed: Due, years: float) -> Recovery:
    """The recovery plan: a whole number of payments in money, and a payment in proportion for a
    part of a year."""
    deficit = max(-provisions.surplus, 0.0)
    endpoints = np.append(np.arange(1, int(years) + 1), years)
    paid = np.append(np.ones(int(years)), years - int(years))
    money = discounted(owed, provisions.margin) * owed.deflator
    value = float(paid @ np.interp(endpoints, owed.years, money))
    item = deficit / value
    return Recovery(deficit, years, item, item * float(paid.sum()))
