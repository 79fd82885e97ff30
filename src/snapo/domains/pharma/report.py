"""The report of a run of a pharma case."""

from snapo.report.folder import RunFiles
from snapo.study.domain import Report

from .chapters import batch
from .chapters.attribution import ATTRIBUTION, PROFILES
from .chapters.capability import CAPABILITY
from .chapters.closed_loop import CLOSED_LOOP
from .chapters.design_space import SPACE
from .chapters.estimation import ESTIMATION, validation
from .chapters.headline import MAKING, headline
from .chapters.model import MODEL, stated
from .chapters.optimum import OPTIMUM
from .chapters.ranges import PAIRS, RANGES
from .chapters.sensitivities import MATRIX
from .chapters.verification import verification

SECTIONS = (
    headline, MODEL, verification, MATRIX, ATTRIBUTION, batch.reactor, batch.plane, batch.drying,
    batch.ONE_BATCH, PROFILES, SPACE, RANGES, PAIRS, CAPABILITY, OPTIMUM, ESTIMATION, validation,
    CLOSED_LOOP, MAKING,
)  # fmt: skip
MENU = {
    "Model": MODEL,
    "Sensitivities": MATRIX,
    "Batch": batch.reactor,
    "Design space": SPACE,
    "Recipe": OPTIMUM,
    "Assumptions": MAKING,
}


def about(run: RunFiles) -> list[tuple[str, str]]:
    """The lines under the title."""
    case = stated(run)
    return [
        ("Units", " → ".join(unit.name for unit in case.units)),
        ("Parameters", str(len(case.parameters) or "")),
        ("Quality attributes", str(len(case.attributes) or "")),
        ("Status", run.result.status),
    ]


REPORT = Report("Pharmaceutical process", RunFiles, about, SECTIONS, MENU)
