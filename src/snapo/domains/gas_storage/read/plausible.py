"""Numbers outside of any market: refused, as a value made of them would be garbage."""

from collections.abc import Iterator

import numpy as np

from snapo.case.error import CaseError

from ..contract.inputs import storage_inputs
from ..contract.records import StorageCase

# By group and unit of an input: where it stands in the case, least, most, and the limit in words.
LIMITS = {
    ("price", None): ("market.forward_curve", -1e6, 1e6, "-1,000,000 to 1,000,000"),
    ("interest rate", "1/year"): ("market.interest_rate", -0.5, 1.0, "-0.5 to 1 (-50 to 100 %)"),
    ("volatility", "1/sqrt(year)"): ("model", 0.0, 50.0, "0 to 50 (5,000 % a year)"),
    ("price model", "1/year"): ("model", 0.0, 1e5, "0 to 100,000 (a half-life of 4 minutes)"),
}


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
