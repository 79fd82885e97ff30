"""How a run of a user's own simulator is told: the sections that every run can have."""

from snapo.report.folder import Folder
from snapo.report.quantity import number
from snapo.report.sections.bound import bound
from snapo.report.sections.distribution import distribution
from snapo.report.sections.fans import fans
from snapo.report.sections.headline import headline
from snapo.report.sections.limits import limits
from snapo.report.sections.proof import certificate, history, making
from snapo.report.sections.sensitivities import sensitivities
from snapo.study.domain import Report

SECTIONS = (
    headline, limits, sensitivities, distribution, fans, bound, history, certificate, making,
)  # fmt: skip


def about(run: Folder) -> list[tuple[str, str]]:
    """What stands under the title."""
    steps = f"{number(run.get('horizon'), 0)} {run.get('step', 'step')}s"
    objective = str(run.get("objective", ""))
    return [("Simulator", str(run.get("simulator", ""))), ("Horizon", steps),
            ("Objective", objective)]  # fmt: skip


REPORT = Report("A simulator of your own", Folder, about, SECTIONS)
