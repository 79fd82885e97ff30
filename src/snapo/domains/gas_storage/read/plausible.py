"""Numbers outside of any market are refused; those that a slip of units would make are noted."""

import calendar
import datetime
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.plausible import FRACTION, CaseFiles, Plausible, checked_numbers, implausible

from ..contract.inputs import storage_inputs
from ..contract.records import StorageCase

# By group and unit of an input: where it stands in the case, least, most, and the limit in words.
LIMITS = {
    ("price", None): ("market.forward_curve", -1e6, 1e6, "-1,000,000 to 1,000,000"),
    ("interest rate", "1/year"): ("market.interest_rate", -0.5, 1.0, "-0.5 to 1 (-50 to 100 %)"),
    ("volatility", "1/sqrt(year)"): ("model", 0.0, 50.0, "0 to 50 (5,000 % a year)"),
    ("price model", "1/year"): ("model", 0.0, 1e5, "0 to 100,000 (a half-life of 4 minutes)"),
}
# Energy of a volume unit in MWh, and minor units of a currency in major ones.
ENERGY = {"MWh": 1.0, "kWh": 1e-3, "GWh": 1e3, "therm": 0.0293071, "MMBtu": 0.293071, "GJ": 1 / 3.6}
MONEY = {"EUR": 1.0, "USD": 1.0, "GBP": 1.0, "CHF": 1.0, "p": 0.01, "GBp": 0.01, "ct": 0.01}
PRICES = (1.0, 1000.0)  # per MWh, in one of these currencies
APART = 20.0  # a forward price is less than so many times its neighbours
RANGES = (
    Plausible(-0.02, 0.25, FRACTION, group="interest rate"),
    Plausible(0.005, 5.0, "fractions are meant, 0.85 is 85 %", group="volatility"),
    Plausible(1.0, 1000.0, "it is per year, ln 2 over a half-life in years",
              names=("spot_mean_reversion",)),
    Plausible(0.05, 1000.0, "it is per year, ln 2 over a half-life in years",
              names=("mean_reversion", "jump_mean_reversion")),
    Plausible(0.05, 200.0, "it is the number of spikes in a year", names=("jump_intensity",)),
    Plausible(0.01, 0.95, "it is the mean of ln S, 0.5 is a spike of 65 %", names=("jump_size",)),
    Plausible(0.0, 1.5, "it is a share of the spot price, 0.9 is 90 % of it; a value in money is "
              "a CSV inventory,value", names=("end_value",), unit="1"),
    Plausible(0.0, 0.2, "it is a share of the volume, 0.015 is 1.5 %",
              names=("injection_fuel", "withdrawal_fuel")),
    Plausible(0.0, 0.01, "it is a share of the gas in store a day, 0.0001 is 3.6 % a year",
              names=("inventory_loss",)),
)  # fmt: skip


def unit_slips(case: StorageCase, data: Mapping[str, Any]) -> Iterable[str]:
    """Notes on numbers that are likely to be in another unit; `data`: the tables of the case."""
    inputs = [checked_numbers(entry, name) for name, entry in storage_inputs(case).items()]
    ranges = [*RANGES, *_by_price(case), *_by_size(case)]
    return implausible(inputs, ranges, CaseFiles(case.file, data)).values()


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


def check_plausible(case: StorageCase) -> None:
    """Prices, rates, volatilities and speeds lie within what a market has.

    **Raises:** `CaseError` with the key, the number and the limit.
    """
    for name, given in storage_inputs(case).items():
        found = LIMITS.get((given.group, given.unit)) or LIMITS.get((given.group, None))
        if found is None:
            continue
        place, low, high, words = found
        values = given.value.ravel()
        beyond = np.flatnonzero(~((values >= low) & (values <= high)))
        if beyond.size:
            first = int(beyond[0])
            key = f"{place}.{name}" if place == "model" else place
            label = f" {given.names()[first]}" if values.size > 1 else ""
            what = f"no market has this; allowed is {words}"
            raise CaseError(str(case.file), f"{key}{label}", float(values[first]), what)


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
    elif (least := float(np.min(inward) + np.min(outward))) < 0:
        yield (
            "Injecting gas and withdrawing it again pays by itself: the least injection_cost and "
            f"withdrawal_cost sum to {least:g}. Is the sign of the costs right?"
        )
