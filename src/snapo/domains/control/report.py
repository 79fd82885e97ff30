"""The report of a controlled plant."""

from snapo.report.evidence import history, making
from snapo.report.folder import RunFiles
from snapo.report.quantity import number
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.headline import headline
from snapo.study.chapters.profile import PROFILE
from snapo.study.chapters.sensitivities import sensitivities
from snapo.study.domain import Report

from .chapters.baselines import BASELINES, objective_text
from .chapters.costs import costs
from .chapters.plane import PLANE

SECTIONS = (
    headline, BASELINES, costs, PLANE, PROFILE, sensitivities, DISTRIBUTION, history, CERTIFICATE,
    making,
)  # fmt: skip
MENU = {
    "Rules": BASELINES,
    "Costs": costs,
    "Over time": PLANE,
    "Sensitivities": sensitivities,
    "Totals": DISTRIBUTION,
    "Checks": history,
}


def about(run: RunFiles) -> list[tuple[str, str]]:
    """The lines below the title of the report."""
    steps = f"{number(run.get('horizon'), 0)} steps"
    return [("Plant", str(run.get("plant_words", ""))), ("Horizon", steps),
            ("Objective", objective_text(run))]  # fmt: skip


REPORT = Report("A controlled plant", RunFiles, about, SECTIONS, MENU)
