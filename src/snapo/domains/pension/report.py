"""The report of a pension run: one HTML file made of nothing but the files of the run folder."""

from pathlib import Path

from snapo.report.page import Page, render
from snapo.report.quantity import long_date, number

from .sections import decisions, evidence, frontier, outcome, reconciliation, risk
from .sections.run import Run

FILE = "report.html"
SECTIONS = (
    reconciliation.headline,
    reconciliation.reconciliation,
    decisions.trades,
    outcome.funding,
    outcome.attribution,
    outcome.spread,
    outcome.money,
    outcome.indexation,
    decisions.rivals,
    frontier.frontier,
    decisions.policy,
    risk.sensitivities,
    risk.ladder,
    decisions.limits,
    reconciliation.stress,
    evidence.history,
    evidence.certificate,
    evidence.assumptions,
)
MEASURES = {
    "P": "real-world scenarios (P)",
    "Q": "risk-neutral scenarios (Q)",
    "supplied": "supplied scenarios",
}


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
    return render(
        Page(
            title=str(run.get("title") or "Pension fund"),
            about=_about(run),
            sections=[section(run) for section in SECTIONS],
            footer=_footer(run),
        )
    )


def _about(run: Run) -> list[tuple[str, str]]:
    found = [("Valuation date", long_date(run.get("valuation_date")))]
    if run.get("years"):
        steps = f"{number(run.get('steps'), 0)} decisions"
        found.append(("Horizon", f"{number(run.get('years'), 0)} years, {steps}"))
    found.append(("Scenarios", MEASURES.get(run.measure, run.measure)))
    found.append(("Currency", run.currency))
    return found


def _footer(run: Run) -> str:
    version = run.get("versions.snapo")
    known = version and version[:1].isdigit()  # else it says that it is not installed
    made = f"Made by snapo {version}" if known else "Made by snapo"
    return f"{made} from the files of one run folder; the page needs and sends nothing."
