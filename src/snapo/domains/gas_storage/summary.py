"""What `snapo check` prints of a storage case, in NumPy: nothing is compiled."""

import numpy as np

from .contract.records import StorageCase, numbers_by_name
from .contract.terms import discount, known_schedule
from .references.intrinsic import intrinsic


def value_without_decisions(case: StorageCase) -> float:
    """The value, before fixed costs, of a case with no decision days.

    Zero after the end date; else that of the inventory on the end date, discounted from it: its
    level is met (or the case would have been refused), and its price is the forward price.
    """
    if case.days:
        raise ValueError(f"{case.file}: {len(case.days)} decision days are left.")
    if case.expired:
        return 0.0
    inventory = float(case.contract.inventory.used())
    factor = float(discount(case.market, np.array(case.end_day)))
    price = float(case.market.forward_curve.used()[-1]) if case.has_end_price else 0.0
    return factor * case.contract.at_end.value_known(inventory, price)


def lines(case: StorageCase) -> list[str]:
    """The case in a few lines: nothing is trained."""
    if not case.days:
        value = value_without_decisions(case)
        return [f"{case.title}: no decision day is left; the value is {value:,.2f}"]
    plan = intrinsic(known_schedule(case), case.contract.ratchets.interpolation)
    inputs = numbers_by_name(case).values()
    numbers = sum(entry.values.size for entry in inputs)
    return [
        f"{case.title}: {len(case.days)} decision days, {case.days[0]} to {case.days[-1]}",
        f"{len(inputs)} inputs with {numbers} numbers, each with a sensitivity",
        f"intrinsic value {plan.value:,.2f} {case.currency}",
        "the contract can be met",
    ]
