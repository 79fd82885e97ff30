"""How a run of a pharma case is told."""

from snapo.study.domain import Report

from .sections import (
    assumptions,
    batch,
    headline,
    learning,
    model,
    optimum,
    sensitivity,
    space,
    together,
    units,
    validation,
    verification,
)
from .sections.run import Run

SECTIONS = (
    headline.headline,
    model.model,
    verification.verification,
    sensitivity.sensitivity,
    sensitivity.attribution,
    batch.reactor,
    batch.plane,
    batch.drying,
    units.units,
    batch.profiles,
    space.design_space,
    space.ranges,
    together.together,
    space.capability,
    optimum.optimum,
    learning.estimation,
    validation.validation,
    learning.closed_loop,
    assumptions.assumptions,
)


def about(run: Run) -> list[tuple[str, str]]:
    """What stands under the title."""
    return [
        ("Units", " → ".join(each["name"] for each in run.get("units", []))),
        ("Parameters", str(len(run.parameters) or "")),
        ("Quality attributes", str(len(run.attributes) or "")),
        ("Status", str(run.result.get("status") or "")),
    ]


REPORT = Report("Pharmaceutical process", Run, about, SECTIONS)
