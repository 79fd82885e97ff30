"""The report of a run: one HTML file made of nothing but the files of its folder."""

from pathlib import Path

from snapo.report.page import Page, render
from snapo.report.sections.seeds import seeds
from snapo.solver.tables import write_text

from .domain import Domain
from .run_folder import REPORT


def write_report(domain: Domain, folder: Path) -> Path:
    """Writes `report.html` into a run folder and returns its path.

    Where a file or a key is missing, the section says so in a sentence. The same files give the
    same page, byte for byte.
    """
    summary = domain.report()
    run = summary.folder.read(folder)
    sections = [section(run) for section in summary.sections]
    if run.get("by_seed"):
        sections.insert(1, seeds(run))
    page = Page(
        title=str(run.get("title") or summary.title),
        about=[(name, value) for name, value in summary.about(run) if value],
        sections=sections,
        footer=_footer(run.get("versions.snapo")),
    )
    write_text(folder / REPORT, render(page))
    return folder / REPORT


def _footer(version: str | None) -> str:
    available = version and version[:1].isdigit()  # else it says that it is not installed
    made = f"Made by snapo {version}" if available else "Made by snapo"
    return f"{made} from the files of one run folder; the page needs and sends nothing."
