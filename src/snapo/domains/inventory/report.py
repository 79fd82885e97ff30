"""The report of an inventory run."""

from snapo.case.error import counted
from snapo.report.evidence import history, making
from snapo.report.folder import RunFiles
from snapo.report.page import Section
from snapo.report.quantity import number
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.profile import BandSeries, profile
from snapo.study.chapters.sensitivities import sensitivities
from snapo.study.domain import Report

from .chapters.about import CaseSummary
from .chapters.baselines import BASELINES
from .chapters.lead_time import lead_time
from .chapters.levels import LEVELS
from .chapters.places import PLACES
from .chapters.service import headline


def decisions(run: RunFiles) -> Section:
    """The section on decisions: the rule of an item, or the places of a network."""
    return PLACES(run) if CaseSummary.of(run).network else LEVELS(run)


def of_its_period(run: RunFiles, series: BandSeries) -> float:
    """The factor that converts an output of a run to one per period; a discounted cost has no such
    factor.
    """
    case = CaseSummary.of(run)
    mean = series.unit.endswith(f"/{case.step}")
    cost = bool(case.currency) and series.unit.startswith(case.currency) and not mean
    return 1.0 if series.kind != "outputs" or cost else float(case.counted)


SECTIONS = (
    headline, decisions, BASELINES, sensitivities, lead_time, DISTRIBUTION,
    profile(factor=of_its_period), history, CERTIFICATE, making,
)  # fmt: skip
MENU = {
    "Decisions": decisions,
    "Rules": BASELINES,
    "Sensitivities": sensitivities,
    "Totals": DISTRIBUTION,
    "Checks": history,
}


def about(run: RunFiles) -> list[tuple[str, str]]:
    """The lines below the title of the report."""
    case = CaseSummary.of(run)
    lead = "" if case.network else counted(case.lead_time or 0, case.step)
    unmet = "lost" if case.lost else "delivered later"
    horizon = f"{counted(case.counted, case.step)} after {number(case.warm_up, 0)} of warm-up"
    return [("Demand", case.demand), ("Unmet demand", unmet),
            ("Lead time", lead), ("Horizon", horizon)]  # fmt: skip


REPORT = Report("Inventory", RunFiles, about, SECTIONS, MENU)
