"""What an item and a network say alike: of themselves before any work, and of their result."""

from typing import Any

from snapo.case.error import CaseError
from snapo.study.domain import Options
from snapo.study.study import StudyRun
from snapo.study.training import trained

from .item.records import InventoryCase
from .network.records import NetworkCase


def without_references(options: Options) -> None:
    """**Raises:** `CaseError` where references are asked for."""
    if options.reference:
        what = "an inventory has no references to compute; its rivals are in every run"
        raise CaseError("--reference", "", None, what)


def about(case: InventoryCase | NetworkCase, units: dict[str, str]) -> dict[str, Any]:
    """Title, units, periods, and the objective in words."""
    per = f" of a {case.period}" if case.discount == 1 else ", discounted"
    unit = case.value_unit if case.objective.keeps_unit else ""
    return {
        "title": case.title,
        "unit": unit,
        "value_unit": unit,
        "units": units,
        "currency": case.currency,
        "item_unit": case.unit,
        "step": case.period,
        "horizon": case.horizon,
        "warm_up": case.warm_up,
        "objective": f"{case.objective.kind} of the result{per}: all costs with a minus",
        "objective_output": "result",
        "notes": list(case.notes),
    }


def result(run: StudyRun) -> dict[str, Any]:
    """The headline: the value of the trained rule, and those of its rivals."""
    rivals = [row for row in run.get("rivals") or [] if row["rule"] != "trained"]
    # A difference that is no number stands as None in the files of a run.
    known = [row for row in rivals if row["difference"] is not None]
    leads = [(row["rule"], -row["difference"], row["difference_error"]) for row in known]
    return trained(run, {row["rule"]: row["value"] for row in rivals}, leads)
