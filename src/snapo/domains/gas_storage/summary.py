"""The text that `snapo check` prints for a storage case, computed in NumPy; nothing is compiled."""

from snapo.study.kind import inputs_line

from .contract.records import StorageCase, numbers_by_name
from .contract.terms import known_schedule, value_without_decisions
from .references.intrinsic import intrinsic


def lines(case: StorageCase) -> list[str]:
    """The case in a few lines; nothing is trained."""
    if not case.days:
        value = value_without_decisions(case)
        return [f"{case.title}: no decision day is left; the value is {value:,.2f}"]
    plan = intrinsic(known_schedule(case), case.contract.ratchets.interpolation)
    return [
        f"{case.title}: {len(case.days)} decision day{'s' * (len(case.days) > 1)}, "
        f"{case.days[0]} to {case.days[-1]}",
        inputs_line([entry.values.size for entry in numbers_by_name(case).values()]),
        f"intrinsic value {plan.value:,.2f} {case.currency}",
        "the contract can be met",
    ]
