"""Reads `[pots]`: personal pots with a solidarity reserve, within the law at the date."""

import datetime
from typing import Any

import numpy as np

from snapo.case.csv import FileReference, read_rows
from snapo.case.error import CaseError

from ..read.cells import TableReader, TimeGrid, listed, rising, single
from ..read.tables import PotsTable
from ..records.people import FundMembers
from ..records.plan import Liability, PensionPlan
from ..records.pots import PotRules, Pots
from ..records.said import InputNumber, share
from ..regulation.in_force import in_force

OWN = {"dutch-wtp": "dutch_wtp.toml"}  # rules that come with the package
# Key of the case, key of the law.
LIMITS = {
    "largest": "largest",
    "reserve": "largest",
    "fill_contribution": "from_contributions",
    "fill_return": "from_excess_return",
}
RESERVE = share("the solidarity reserve: its size, its filling or its release", "plan")
PROTECTION = share("the share of a pot that earns as its annuity does; the rest earns cash", "plan")
EXPOSURE = share("the weight of a cohort's pot in the excess return", "plan")


def read_pots(
    section: TableReader,
    table: PotsTable | None,
    day: datetime.date,
    members: FundMembers | None,
    grid: TimeGrid,
) -> Pots | None:
    """The pots of a case under the rules in force on `day`; None without the table.

    **Raises:** `CaseError` where the reserve is filled beyond the law, or cohorts are missing.
    """
    if table is None:
        return None
    if members is None:
        raise section.error("rules", table.rules, "pots are those of the cohorts of [members] file")
    rules = in_force(section, table.rules, OWN, day, _rules)
    largest = rules.largest if table.largest is None else table.largest
    for key, law in LIMITS.items():
        maximum = getattr(rules, law)
        if (result := getattr(table, key)) is not None and result > maximum:
            message = f"the law in force since {rules.since} allows at most {maximum:g}"
            raise section.error(key, result, message)
    if table.reserve > largest:
        raise section.error("reserve", table.reserve, f"the reserve is at most {largest:g}")

    def one(key: str, value: float, name: str = ""):
        return section.input(table, key, single(f"reserve_{name or key}", value, RESERVE))

    rows = read_rows(
        FileReference(section, "allocation", table.allocation), ("age", "protection", "exposure")
    )
    ages = rising(rows, "age", -1.0)
    labels = [f"from {age:g}" for age in ages]
    age = members.age + grid.step * np.arange(grid.steps)[:, None]
    position = np.maximum(np.searchsorted(ages, age + 1e-9, side="right") - 1, 0)

    def by_age(column: str, metadata: InputNumber):
        values = [row.number(column, 0.0, 2.0) for row in rows]
        inputs = listed(f"pot_{column}", values, labels, metadata)
        return metadata.input(inputs.name, inputs.values, labels, position)

    return Pots(
        rules=rules,
        reserve=one("reserve", table.reserve, "today"),
        fill_contribution=one("fill_contribution", table.fill_contribution),
        fill_return=one("fill_return", table.fill_return),
        release=one("release", table.release),
        largest=one("largest", largest),
        protection=by_age("protection", PROTECTION),
        exposure=by_age("exposure", EXPOSURE),
    )


def check_pots(file: str, pots: Pots | None, plan: PensionPlan, liability: Liability) -> None:
    """Rules that do not go with pots are refused."""
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
            raise CaseError(file, key, value, f"a fund of personal pots needs {text}")


def _rules(data: dict[str, Any]) -> PotRules:
    return PotRules(
        since=data["from"].isoformat(),
        source=str(data["source"]),
        largest=float(data["largest"]),
        from_contributions=float(data["from_contributions"]),
        from_excess_return=float(data["from_excess_return"]),
    )
