"""Reads `[pots]`: personal pots with a solidarity reserve, within the law on the valuation date."""

import datetime
from dataclasses import replace
from typing import Any

import numpy as np

from snapo.case.csv import FileReference, read_rows
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.quantity import Range

from ..quantities import SHARE, FundQuantity, input_of
from ..read.cells import TableReader, TimeGrid, rising
from ..read.tables import PotsTable
from ..records.people import FundMembers
from ..records.plan import Liability, PensionPlan
from ..records.pots import PotRules, Pots
from ..regulation.in_force import in_force

OWN = {"dutch-wtp": "dutch_wtp.toml"}  # rules that come with the package
# Key of the case, key of the law.
LIMITS = {
    "largest": "largest",
    "reserve": "largest",
    "fill_contribution": "from_contributions",
    "fill_return": "from_excess_return",
}
BY_COHORT = SHARE.of("plan", range=Range(0.0, 2.0))
PROTECTION = BY_COHORT.in_column(
    "protection",
    "the share of a pot that earns the return of its annuity; the rest earns the return of cash",
)
EXPOSURE = BY_COHORT.in_column("exposure", "the weight of a cohort's pot in the excess return")


def read_pots(
    section: TableReader,
    table: PotsTable | None,
    day: datetime.date,
    members: FundMembers | None,
    grid: TimeGrid,
) -> Pots | None:
    """The pots of a case under the rules in force on `day`; None without the table.

    **Raises:** `CaseError` if the reserve is filled by more than the law allows, or if cohorts are
    missing.
    """
    if table is None:
        return None
    if members is None:
        raise section.error("rules", table.rules, "pots need cohorts, which members.file names")
    rules = in_force(section, table.rules, OWN, day, _rules)
    largest = table.largest
    if largest is None:
        largest = table.reserve.quantity.input("largest", [rules.largest])
    for key, law in LIMITS.items():
        maximum, stated = getattr(rules, law), getattr(table, key)
        if stated is not None and stated.used() > maximum:
            message = f"the law in force since {rules.since} allows at most {maximum:g}"
            raise section.error(key, stated.written, message)
    if table.reserve.used() > largest.used():
        message = f"the reserve must be at most {largest.values[0]:g}, the value of largest"
        raise section.error("reserve", table.reserve.written, message)

    def input(key: str) -> CaseInput:
        return section.input(table, key, input_of(table, key, "reserve"))

    rows = read_rows(
        FileReference(section, "allocation", table.allocation), ("age", "protection", "exposure")
    )
    ages = rising(rows, "age", -1.0)
    labels = [f"from {age:g}" for age in ages]
    age = members.age + grid.step * np.arange(grid.steps)[:, None]
    position = np.maximum(np.searchsorted(ages, age + 1e-9, side="right") - 1, 0)

    def by_age(quantity: FundQuantity) -> CaseInput:
        return quantity.from_rows(f"pot_{quantity.column}", rows, labels, index=position)

    return Pots(
        rules=rules,
        reserve=section.input(table, "reserve", table.reserve),
        fill_contribution=input("fill_contribution"),
        fill_return=input("fill_return"),
        release=input("release"),
        largest=section.input(table, "largest", replace(largest, name="reserve_largest")),
        protection=by_age(PROTECTION),
        exposure=by_age(EXPOSURE),
    )


def check_pots(file: str, pots: Pots | None, plan: PensionPlan, liability: Liability) -> None:
    """Refuses rules that cannot be combined with pots.

    **Raises:** `CaseError` with the key of the rule and the words that are allowed.
    """
    if pots is None:
        return
    request = (
        ("plan.indexation.kind", plan.indexation.kind, ("none",)),
        ("plan.contribution.kind", plan.contribution.kind, ("none", "fixed")),
        ("liability.future_indexation", liability.future_indexation, ("none",)),
        # An annuity at a fixed rate has no return on the market that could be protected.
        ("liability.basis", liability.basis, ("risk-free", "spread")),
        ("plan.open", plan.open, (False,)),
    )
    for key, value, allowed in request:
        if value not in allowed:
            text = " or ".join(str(item).lower() for item in allowed)
            raise CaseError(file, key, value, f"with personal pots it must be {text}")


def _rules(data: dict[str, Any]) -> PotRules:
    return PotRules(
        since=data["from"].isoformat(),
        source=str(data["source"]),
        largest=float(data["largest"]),
        from_contributions=float(data["from_contributions"]),
        from_excess_return=float(data["from_excess_return"]),
    )
