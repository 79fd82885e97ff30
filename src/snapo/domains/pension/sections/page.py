"""The report of a pension run: its sections, and the lines under its title."""

from snapo.report.quantity import long_date, number
from snapo.report.sections.bound import bound
from snapo.study.domain import Report

from . import decisions, evidence, frontier, ladder, outcome, outputs, reconciliation, risk
from .pots import of_rights, pots
from .run import PensionRun

SECTIONS = (
    reconciliation.headline,
    reconciliation.reconciliation,
    decisions.trades,
    of_rights(outcome.funding),
    pots,
    of_rights(outcome.attribution),
    of_rights(outcome.variance),
    outcome.money,
    outcome.indexation,
    decisions.rivals,
    of_rights(frontier.frontier),
    decisions.policy,
    outputs.outputs,
    risk.sensitivities,
    ladder.ladder,
    decisions.limits,
    reconciliation.stress,
    evidence.history,
    bound,
    evidence.certificate,
    evidence.assumptions,
)
MEASURES = {
    "P": "real-world scenarios (P)",
    "Q": "risk-neutral scenarios (Q)",
    "supplied": "supplied scenarios",
}


def about(run: PensionRun) -> list[tuple[str, str]]:
    """The lines under the title."""
    found = [("Valuation date", long_date(run.get("valuation_date")))]
    if run.get("years"):
        steps = f"{number(run.get('steps'), 0)} decisions"
        found.append(("Horizon", f"{number(run.get('years'), 0)} years, {steps}"))
    found.append(("Scenarios", MEASURES.get(run.measure, run.measure)))
    found.append(("Currency", run.currency))
    return found


REPORT = Report("Pension fund", PensionRun, about, SECTIONS)
