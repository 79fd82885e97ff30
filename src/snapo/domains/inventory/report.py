"""How an inventory run is told."""

from typing import Any

from snapo.report.folder import Folder
from snapo.report.page import Section
from snapo.report.quantity import number
from snapo.report.sections.distribution import distribution
from snapo.report.sections.fans import fans
from snapo.report.sections.proof import certificate, history, making
from snapo.report.sections.sensitivities import sensitivities
from snapo.study.domain import Report

from .network.sections import places
from .sections.rivals import lead_time, rivals
from .sections.rule import rule
from .sections.service import service


def decisions(run: Folder) -> Section:
    """The rule of an item; the places of a network."""
    return places(run) if run.get("network") else rule(run)


def course(run: Folder) -> Section:
    """Bands over time, every output as that of its period: a run holds its part of the mean."""
    counted = float(run.get("horizon", 0)) - float(run.get("warm_up", 0))
    parts = f"/{run.get('step', 'period')}"  # a discounted cost has no part of a mean

    def factor(each: dict[str, Any]) -> float:
        unit = str(each.get("unit") or "")
        cost = unit.startswith(str(run.get("currency", "\0"))) and not unit.endswith(parts)
        return 1.0 if each["kind"] != "outputs" or cost else counted

    return fans(run, factor)


SECTIONS = (
    service, decisions, rivals, sensitivities, lead_time, distribution, course, history,
    certificate, making,
)  # fmt: skip


def about(run: Folder) -> list[tuple[str, str]]:
    """The lines under the title."""
    step = str(run.get("step", "period"))
    lead = "" if run.get("network") else f"{number(run.get('lead_time'), 0)} {step}s"
    unmet = "lost" if run.get("lost") else "delivered later"
    counted = float(run.get("horizon", 0)) - float(run.get("warm_up", 0))
    horizon = f"{number(counted, 0)} {step}s after {number(run.get('warm_up'), 0)} of warm-up"
    return [("Demand", str(run.get("demand", ""))), ("Without stock", f"demand is {unmet}"),
            ("Lead time", lead), ("Horizon", horizon)]  # fmt: skip


REPORT = Report("Inventory", Folder, about, SECTIONS)
