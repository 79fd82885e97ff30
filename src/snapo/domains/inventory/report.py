"""How an inventory run is told."""

from snapo.report.folder import Folder
from snapo.report.page import Section
from snapo.report.quantity import number
from snapo.report.sections.proof import history, making
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.profile import BandSeries, profile
from snapo.study.chapters.sensitivities import sensitivities
from snapo.study.domain import Report

from .network.sections import places
from .sections.rivals import lead_time, rivals
from .sections.rule import rule
from .sections.service import service


def decisions(run: Folder) -> Section:
    """The rule of an item; the places of a network."""
    return places(run) if run.get("network") else rule(run)


def counted_periods(run: Folder) -> float:
    """The periods of the run that count: without those of the warm-up."""
    return float(run.get("horizon", 0)) - float(run.get("warm_up", 0))


def of_its_period(run: Folder, series: BandSeries) -> float:
    """The factor that makes an output that of its period: a run has its part of the mean.

    A discounted cost has no part of a mean.
    """
    mean = series.unit.endswith(f"/{run.get('step', 'period')}")
    cost = series.unit.startswith(str(run.get("currency", "\0"))) and not mean
    return 1.0 if series.kind != "outputs" or cost else counted_periods(run)


SECTIONS = (
    service, decisions, rivals, sensitivities, lead_time, DISTRIBUTION,
    profile(factor=of_its_period), history, CERTIFICATE, making,
)  # fmt: skip


def about(run: Folder) -> list[tuple[str, str]]:
    """The lines under the title."""
    step = str(run.get("step", "period"))
    lead = "" if run.get("network") else f"{number(run.get('lead_time'), 0)} {step}s"
    unmet = "lost" if run.get("lost") else "delivered later"
    counted = counted_periods(run)
    horizon = f"{number(counted, 0)} {step}s after {number(run.get('warm_up'), 0)} of warm-up"
    return [("Demand", str(run.get("demand", ""))), ("Without stock", f"demand is {unmet}"),
            ("Lead time", lead), ("Horizon", horizon)]  # fmt: skip


REPORT = Report("Inventory", Folder, about, SECTIONS)
