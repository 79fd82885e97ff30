"""The report of a pension run: its sections, and the lines under its title."""

from snapo.report.quantity import long_date, number
from snapo.report.sections.bound import bound
from snapo.report.sections.lacking import unless_left_out
from snapo.study.domain import Report

from . import decisions, evidence, frontier, ladder, outcome, outputs, reconciliation, risk
from .pots import of_rights, pots
from .run import PensionRun

SECTIONS = (
    reconciliation.headline,
    unless_left_out(reconciliation.reconciliation, "reconciliation"),
    unless_left_out(decisions.trades, "today"),
    unless_left_out(of_rights(outcome.funding), "paths"),
    unless_left_out(pots, "pots"),
    unless_left_out(of_rights(outcome.attribution), "attribution"),
    unless_left_out(of_rights(outcome.variance), "variance by source"),
    unless_left_out(outcome.money, "paths"),
    unless_left_out(outcome.indexation, "paths"),
    unless_left_out(decisions.rivals, "classical policies"),
    unless_left_out(of_rights(frontier.frontier), "frontier"),
    unless_left_out(decisions.policy, "paths"),
    unless_left_out(outputs.outputs, "outputs"),
    unless_left_out(risk.sensitivities, "sensitivities"),
    unless_left_out(ladder.ladder, "today"),
    unless_left_out(decisions.limits, "paths"),
    unless_left_out(reconciliation.stress, "stress"),
    unless_left_out(evidence.history, "training"),
    unless_left_out(bound, "training"),
    evidence.CERTIFICATE,
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
