"""How a run of a user's own simulator is told: the sections that every run can have."""

from snapo.report.folder import Folder
from snapo.report.quantity import number
from snapo.report.sections.bound import bound
from snapo.report.sections.limits import limits
from snapo.report.sections.proof import history, making
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.headline import headline
from snapo.study.chapters.profile import PROFILE
from snapo.study.chapters.sensitivities import sensitivities
from snapo.study.domain import Report

SECTIONS = (
    headline, limits, sensitivities, DISTRIBUTION, PROFILE, bound, history, CERTIFICATE, making,
)  # fmt: skip


def about(run: Folder) -> list[tuple[str, str]]:
    """What stands under the title."""
    steps = f"{number(run.get('horizon'), 0)} {run.get('step', 'step')}s"
    objective = str(run.get("objective", ""))
    return [("Simulator", str(run.get("simulator", ""))), ("Horizon", steps),
            ("Objective", objective)]  # fmt: skip


REPORT = Report("A simulator of your own", Folder, about, SECTIONS)
