"""Notes on numbers that a slip of units would make, as far as they depend on other numbers."""

import calendar
import datetime
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from snapo.case.plausible import CaseFiles, Plausible, implausible

from ..contract.inputs import numbers_of
from ..contract.records import StorageCase

# Energy of a volume unit in MWh, and minor units of a currency in major ones.
ENERGY = {"MWh": 1.0, "kWh": 1e-3, "GWh": 1e3, "therm": 0.0293071, "MMBtu": 0.293071, "GJ": 1 / 3.6}
MONEY = {"EUR": 1.0, "USD": 1.0, "GBP": 1.0, "CHF": 1.0, "p": 0.01, "GBp": 0.01, "ct": 0.01}
PRICES = (1.0, 1000.0)  # per MWh, in one of these currencies
APART = 20.0  # a forward price is less than so many times its neighbours


def unit_slips(case: StorageCase, data: Mapping[str, Any]) -> Iterable[str]:
    """Notes on numbers that are likely to be in another unit; `data`: the tables of the case."""
    ranges = [*_by_price(case), *_by_size(case)]
    return implausible(numbers_of(case), ranges, CaseFiles(case.file, data)).values()


def _by_price(case: StorageCase) -> Iterator[Plausible]:
    """The range of prices, and those of costs per unit of volume."""
    unit = ENERGY.get(case.volume_unit, math.nan) / MONEY.get(case.currency, math.nan)
    low, high = (0.0, math.inf) if math.isnan(unit) else (PRICES[0] * unit, PRICES[1] * unit)
    name = f"{case.currency}/{case.volume_unit}"
    hint = f"the curve is in {name}"
    yield Plausible(low, high, hint, names=("forward_curve",), ratio=APART, by_size=True)
    highest = float(np.max(np.abs(case.market.forward_curve.values), initial=0.0))
    if highest > 0:
        paid = f"a cost is in {name}, and the dearest gas costs {highest:.6g}"
        names = ("injection_cost", "withdrawal_cost")
        yield Plausible(0.0, 3 * highest, paid, names=names, by_size=True)
        paid = f"it is in {name} a day, and the dearest gas costs {highest:.6g}"
        yield Plausible(0.0, highest / 20, paid, names=("inventory_cost",), by_size=True)


def _by_size(case: StorageCase) -> Iterator[Plausible]:
    """The range of rates, by the volume of the store: from 10,000 days to a tenth of a day."""
    size = float(np.max(case.contract.max_inventory.values, initial=0.0))
    if size > 0:
        hint = f"a rate is in {case.volume_unit} a day, and the store has up to {size:.6g}"
        names = ("ratchet_injection", "ratchet_withdrawal", "min_injection", "min_withdrawal")
        yield Plausible(size / 1e4, 10 * size, hint, names=names)


def end_too_early(start: datetime.date, end: datetime.date) -> str:
    """The note where `end` is the last day of a period of whole months; "" where it is not."""
    last = calendar.monthrange(end.year, end.month)[1]
    if start.day != 1 or end.day != last or (end - start).days <= 31:
        return ""
    after = end + datetime.timedelta(1)
    return (
        f"contract.end: {end} is the first day without a decision, and that is the last day of "
        f"its month: a contract that includes it has end = {after}."
    )


def free_money(case: StorageCase) -> Iterator[str]:
    """Remarks where the contract pays for moving gas, whatever the price: often a wrong sign."""
    contract = case.contract
    inward, outward = contract.injection_cost.used(), contract.withdrawal_cost.used()
    if not len(case.days):
        return
    price = case.market.forward_curve.used()[: len(case.days)]
    paid = price * (1 + contract.injection_fuel.used()) + inward < 0
    if np.any(paid & (price > 0)):
        t = int(np.argmax(paid & (price > 0)))
        yield (
            f"On {case.days[t]} an injection is paid: injection_cost is {inward[t]:g}, and gas "
            f"costs {price[t]:g}. Is the sign of the cost right?"
        )
    elif (minimum := float(np.min(inward) + np.min(outward))) < 0:
        yield (
            "Injecting gas and withdrawing it again pays by itself: the least injection_cost and "
            f"withdrawal_cost sum to {minimum:g}. Is the sign of the costs right?"
        )
