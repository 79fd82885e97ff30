"""Park and loan: gas delivered to a pipeline or hub and taken back, or taken and returned later.

    balance   B after = B + d - w,   -max_loan <= B <= max_park
    earnings = sum over days of discount x ((w - d) S - fees)
    fees     = initial x opened + completion x closed + park fee x B+ + loan fee x B-

d is delivered to the operator and w taken from it on a day, with B+ = max(B, 0), parked, and
B- = max(-B, 0), on loan, both after the day. Volumes that move the balance away from zero are
opened, and those that move it towards zero are closed. A delivery first repays a loan, and the rest
of it is parked:

    initial x opened + completion x closed = (initial + completion) / 2 x (d + w)
                                             + (initial - completion) / 2 x change of |B|

At the end the balance is zero, or the units left are cashed out. Sources of the terms: Natural Gas
Pipeline Company of America, FERC Gas Tariff, Seventh Revised Volume No. 1, Rate Schedule LPS,
section 6.1: an initial fee for each unit tendered for park or taken for loan, a balance fee on the
balance at the end of each day, a completion fee for each unit that is returned. Colorado Interstate
Gas Company, FERC Gas Tariff, First Revised Volume No. 1, sheet 159B, section 2.3(c): a new quantity
is first set off against the existing balance.
"""

import datetime
from collections.abc import Mapping, Sequence

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.quantity import ANY, NOT_NEGATIVE, Quantity
from snapo.case.table import CaseTable, TableContext, doc
from snapo.problem.record import field
from snapo.problem.record.arrays import Array, Bool, NumbersOf
from snapo.problem.record.either import xp

from ...gas_storage.read.tables import PRICE, Currency, DateKey, NominationKey, VolumeUnit
from ..core.contract import (
    ContractLayout,
    EnergyContract,
    EnergyFlow,
    Level,
    LevelMoney,
    StepTerms,
    Terms,
)

GROUP, UNIT = "contract", "{volume_unit}"
LIMIT = Quantity(UNIT, NOT_NEGATIVE, GROUP, move=1.0, by="date", before=0.0)
RATE = Quantity(f"{UNIT}/day", NOT_NEGATIVE, GROUP, move=1.0, by="date", before=0.0)
BALANCE_FEE = Quantity(f"{PRICE}/day", NOT_NEGATIVE, "cost", move=0.001, by="date", before=0.0)
FEE = Quantity(PRICE, NOT_NEGATIVE, "cost", move=0.01)
CASH_OUT = Quantity(PRICE, NOT_NEGATIVE, "cash-out", move=0.1)


class WindowTable(CaseTable):
    """{ first = 2026-07-01, last = 2026-07-31 }: the days on which gas may flow."""

    first: DateKey = doc("first day on which gas may flow")
    last: DateKey = doc("last day on which gas may flow")


class ParkAndLoanTable(CaseTable):
    """`[contract]` of kind "park-and-loan"."""

    volume_unit: VolumeUnit
    currency: Currency
    start: DateKey = doc("first day with a decision")
    end: DateKey = doc("first day without a decision")
    max_park: CaseInput = LIMIT("largest volume parked at the end of a day", 0.0)
    max_loan: CaseInput = LIMIT("largest volume on loan at the end of a day", 0.0)
    max_deliver: CaseInput = RATE("largest volume delivered per day, to park or to repay")
    max_take: CaseInput = RATE("largest volume taken per day, as a loan or from the park")
    deliver_window: dict | None = doc(
        "days on which gas may be delivered",
        None,
        "a table like { first = 2026-07-01, last = 2026-07-31 }",
    )
    take_window: dict | None = doc(
        "days on which gas may be taken",
        None,
        "a table like { first = 2026-12-01, last = 2026-12-31 }",
    )
    balance: CaseInput = Quantity(UNIT, ANY, GROUP, move=1.0)(
        "balance at the start: above zero if gas is parked, below zero if gas is on loan", 0.0
    )
    park_fee: CaseInput = BALANCE_FEE("fee for each unit parked at the end of a day", 0.0)
    loan_fee: CaseInput = BALANCE_FEE("fee for each unit on loan at the end of a day", 0.0)
    initial_fee: CaseInput = FEE("fee for each unit that opens a park or a loan", 0.0)
    completion_fee: CaseInput = FEE("fee for each unit taken back or repaid", 0.0)
    cash_out_park: CaseInput | None = CASH_OUT("price received for a unit parked at the end", None)
    cash_out_loan: CaseInput | None = CASH_OUT("price paid for a unit on loan at the end", None)
    nomination: NominationKey


class ParkAndLoanContract(EnergyContract):
    """The terms of a park and loan; see `ParkAndLoanTable`.

    - `limits`: largest park and largest loan; `rates`: largest delivery and withdrawal; `fees`: the
      fees of a unit parked and of one on loan, by day; each index [T].
    - `turn`: initial and completion fee; `cash_out`: the prices, at the end, of a unit parked and
      of a unit on loan, None if no such balance may be left; index [].
    - `open` [T, 2]: whether gas may be delivered on a day, and whether it may be taken.
    """

    limits: tuple[CaseInput, CaseInput]
    rates: tuple[CaseInput, CaseInput]
    fees: tuple[CaseInput, CaseInput]
    turn: tuple[CaseInput, CaseInput]
    balance: CaseInput
    cash_out: tuple[CaseInput | None, CaseInput | None]
    open: Bool[np.ndarray, "T 2"]
    layout: ContractLayout = field(static=True)

    def terms(self, at: NumbersOf, paid: Array, settled: Array) -> Terms:
        count = len(self.open)
        last = np.arange(count) == count - 1
        none = xp.zeros((count, 1))
        park, loan = (at(x) for x in self.limits)
        initial, completion = (at(x) for x in self.turn)
        fees = [at(x) * paid for x in self.fees]
        turn = (initial - completion) / 2 * paid
        rates, left = [-turn - fees[1], -turn - fees[0]], self.cash_out
        low, high = -loan, park
        if left[1] is None:
            low = xp.where(last, 0.0, low)
        else:
            rates[0] = xp.where(last, rates[0] - at(left[1]) * settled[-1], rates[0])
        if left[0] is None:
            high = xp.where(last, 0.0, high)
        else:
            rates[1] = xp.where(last, rates[1] + at(left[0]) * settled[-1], rates[1])
        unit = -(initial + completion) / 2 * paid
        steps = StepTerms(
            xp.zeros((count, 2)),
            xp.stack([at(x) for x in self.rates], axis=1) * self.open,
            xp.stack([-paid, paid], axis=1),
            xp.stack([unit, unit], axis=1),
            low[:, None],
            high[:, None],
            none,
            none,
            none.astype(bool),
            none,
            of_levels=LevelMoney(
                xp.stack([-turn, -turn], axis=1)[:, None], xp.stack(rates, axis=1)[:, None]
            ),
        )
        return Terms(at(self.balance)[None], steps)

    def keys_at(self, levels: Mapping[str, float], mode: str, index: float | None) -> dict:
        return {"balance": levels["balance"]}


def read_park_and_loan(
    where: TableContext, table: ParkAndLoanTable, days: Sequence[datetime.date]
) -> ParkAndLoanContract:
    """The contract on its decision days."""
    limits, rates, fees = (
        tuple(x.on(days, where.notes) for x in pair)
        for pair in (
            (table.max_park, table.max_loan),
            (table.max_deliver, table.max_take),
            (table.park_fee, table.loan_fee),
        )
    )
    park, loan = (float(x.used().max()) for x in limits)
    if park <= 0 and loan <= 0:
        raise where.error("max_park", park, "max_park or max_loan must be more than 0")
    balance = float(table.balance.values[0])
    if not -loan <= balance <= park:
        message = f"it must be from -max_loan to max_park, {-loan:g} to {park:g}"
        raise where.error("balance", balance, message)
    left = [None if x is None else float(x.values[0]) for x in (table.cash_out_park,
                                                                 table.cash_out_loan)]  # fmt: skip
    if left[0] is not None and left[1] is not None and left[0] > left[1]:
        message = f"it must be at most cash_out_loan, {left[1]:g}"
        raise where.error("cash_out_park", left[0], message)
    flows = [
        EnergyFlow(name, f"{table.volume_unit}/day", (effect,))
        for name, effect in (("deliver", 1.0), ("take", -1.0))
    ]
    opened = [
        _within(where, key, window, days)
        for key, window in (
            ("deliver_window", table.deliver_window),
            ("take_window", table.take_window),
        )
    ]
    return ParkAndLoanContract(  # pyright: ignore[reportCallIssue]
        limits,
        rates,
        fees,
        (table.initial_fee, table.completion_fee),
        table.balance,
        (table.cash_out_park, table.cash_out_loan),
        np.stack(opened, axis=1),
        layout=ContractLayout(  # pyright: ignore[reportCallIssue]
            (Level("balance", table.volume_unit),), tuple(flows)
        ),
    )


def _within(where: TableContext, key: str, raw: dict | None, days: Sequence[datetime.date]):
    """[T] whether a day is in the window of a key; all days are if the case has no such key."""
    if raw is None:
        return np.ones(len(days), bool)
    window = where.nested(WindowTable, raw, key)
    if window.last < window.first:
        raise where.error(f"{key}.last", window.last, f"it must be {window.first} or later")
    inside = np.array([window.first <= day <= window.last for day in days], bool)
    if not inside.any():
        message = f"it must be a decision day of the contract, {days[0]} to {days[-1]}"
        raise where.error(f"{key}.first", window.first, message)
    return inside
