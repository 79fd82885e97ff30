"""How a run of a controlled plant is told."""

from snapo.report.folder import Folder
from snapo.report.quantity import number
from snapo.report.sections.distribution import distribution
from snapo.report.sections.fans import fans
from snapo.report.sections.headline import headline
from snapo.report.sections.proof import certificate, history, making
from snapo.report.sections.sensitivities import sensitivities
from snapo.study.domain import Report

from .sections.costs import costs
from .sections.plane import plane
from .sections.rivals import rivals

SECTIONS = (
    headline, rivals, costs, plane, fans, sensitivities, distribution, history, certificate, making,
)  # fmt: skip


def about(run: Folder) -> list[tuple[str, str]]:
    """What stands under the title."""
    steps = f"{number(run.get('horizon'), 0)} steps"
    objective = str(run.get("objective", ""))
    return [("Plant", str(run.get("plant_words", ""))), ("Horizon", steps),
            ("Objective", objective)]  # fmt: skip


REPORT = Report("A controlled plant", Folder, about, SECTIONS)
