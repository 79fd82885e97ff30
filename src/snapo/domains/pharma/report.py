"""The report of a pharma run: one HTML file made of nothing but the files of the run folder."""

from pathlib import Path

from snapo.report.page import Page, render

from .sections import (
    assumptions,
    batch,
    headline,
    learning,
    model,
    optimum,
    sensitivity,
    space,
    verification,
)
from .sections.run import Run

FILE = "report.html"
SECTIONS = (
    headline.headline,
    model.model,
    verification.verification,
    sensitivity.sensitivity,
    sensitivity.attribution,
    batch.reactor,
    batch.plane,
    batch.drying,
    batch.profiles,
    space.design_space,
    space.ranges,
    space.capability,
    optimum.optimum,
    learning.estimation,
    learning.closed_loop,
    assumptions.assumptions,
)


def write_report(folder: Path) -> Path:
    """Writes `report.html` into the run folder and returns its path.

    It reads result.json, details.json and history.csv; where a file or a key is missing, the
    section says so in a sentence. The same files give the same page, byte for byte.
    """
    run = Run.read(Path(folder))
    file = Path(folder) / FILE
    file.write_text(page(run), encoding="utf-8")
    return file


def page(run: Run) -> str:
    """The report as HTML."""
    title = str(run.get("title") or "Pharmaceutical process")
    about = [
        (name, value)
        for name, value in (
            ("Units", " → ".join(each["name"] for each in run.get("units", []))),
            ("Parameters", str(len(run.parameters) or "")),
            ("Quality attributes", str(len(run.attributes) or "")),
            ("Status", str(run.result.get("status") or "")),
        )
        if value
    ]
    version = run.get("versions.snapo")
    known = version and version[:1].isdigit()  # else it says that it is not installed
    made = f"Made by snapo {version}" if known else "Made by snapo"
    footer = f"{made} from the files of one run folder; the page needs and sends nothing."
    return render(Page(title, about, [section(run) for section in SECTIONS], footer))
