"""The report of a pension run: its first screen, its sections, and the lines under its title."""

import numpy as np

from snapo.case.error import counted
from snapo.problem.objective import CRRA
from snapo.report import evidence
from snapo.report.missing import unless_left_out
from snapo.report.page import Facts, Headline, Missing, Section, Text
from snapo.report.quantity import PLUS_MINUS, finite, long_date, number, plus_minus
from snapo.study.chapters.bound import BOUND, value_bounds
from snapo.study.chapters.certificate import checks as certified
from snapo.study.domain import Report

from .chapters.attribution import ATTRIBUTION, VARIANCE
from .chapters.evidence import CERTIFICATE, CONSISTENCY, assumptions
from .chapters.frontier import FRONTIER
from .chapters.objective import OBJECTIVE, ObjectiveValue
from .chapters.outputs import OUTPUTS
from .chapters.paths import PATHS
from .chapters.policies import POLICIES, leads
from .chapters.pots import POTS
from .chapters.reconciliation import RECONCILIATION
from .chapters.sensitivities import SENSITIVITIES
from .chapters.stress import STRESS
from .chapters.today import LADDERS, LIMITS, TODAY
from .chapters.years import CONTRIBUTIONS, FUNDING, INDEXATION
from .run import PensionRun, share

MEASURES = {
    "P": "real-world scenarios (P)",
    "Q": "risk-neutral scenarios (Q)",
    "supplied": "supplied scenarios",
}
NO_LIMIT = "no turnover limit is set in this case"
Fact = tuple[str, str, str]


def headline(run: PensionRun) -> Section:
    """The value of the policy, and its trades today."""
    value = run.result.value
    if value is None:
        text = "This run trained no policy: training is not among the `[report] parts`."
        if run.left_out("training"):
            return Section("headline", "Result", "", [Text(text), *_facts(run)])
        status = run.result.status or "unknown"
        text = f"There is no value in result.json (status: {status})."
        return Section("headline", "Result", "", [Missing(text)])
    objective = OBJECTIVE.of(run)
    if objective is not None and np.isfinite(objective.equivalent):
        name = "pension" if objective.output == "pension" else "funding ratio"
        label = f"Certainty-equivalent {name} {run.horizon} ({run.measure})"
        displayed = share(objective.equivalent)
        spread = plus_minus(100 * np.nan_to_num(objective.equivalent_error), 2)
        over = " to today's pension" if name == "pension" else ""
        note = f"The certain ratio{over} with the same utility as the policy, at risk aversion"
        note = f"{note} {number(objective.aversion, 1)},"
    else:
        label, displayed = f"Value of the objective ({run.measure})", number(value)
        spread, note = plus_minus(run.result.standard_error, 4), "The objective of the case,"
    action, sentence = _trades(run)
    block = Headline(
        label=label,
        value=displayed,
        error=spread,
        context=_context(run, objective),
        note=f"{note} by the exact simulator on fresh scenarios; {PLUS_MINUS}.",
        action=action,
        sentence=sentence,
        when="Today's decision",
        marks=evidence.check_marks(checks(run)),
    )
    return Section("headline", "Result", "", [block, *_facts(run)])


def _context(run: PensionRun, objective: ObjectiveValue | None) -> str:
    """The lead over other policies, and the most that any policy could reach."""
    texts = [leads(POLICIES.of(run) or ())]
    bound = BOUND.of(run)
    if objective is not None and bound is not None and not bound.says_little:
        utility = finite(bound.upper.high)
        if utility is not None and np.isfinite(objective.equivalent):
            best = CRRA(objective.aversion).certainty_equivalent(utility)
            texts.append(f"Optimum: at most {share(best)} (95 %).")
    return " ".join(filter(None, texts))


def checks(run: PensionRun) -> list[tuple[str, bool]]:
    """(name of a check, whether it held) for every check with a verdict."""
    figures = RECONCILIATION.of(run)
    lines = figures.reconciliation.lines if figures else ()
    tests = [(line.name, line.ok) for line in lines if line.given is not None]
    tests += [(test.name, test.ok) for test in CONSISTENCY.of(run) or ()]
    verdicts = [(name.replace("_", " "), ok) for name, ok in tests if ok is not None]
    return [*verdicts, *certified(run)]


def _trades(run: PensionRun) -> tuple[str, str]:
    """What to do today, and the largest trades in a sentence."""
    today = TODAY.of(run)
    if today is None or not run.assets:
        return "", ""
    classes = sorted(today.trades.classes, key=lambda x: -abs(x.trade))
    moved = sum(abs(x.trade) for x in classes) / 2
    action = f"Trade {share(moved / run.assets)} of the assets"
    largest = [x for x in classes[:4] if x.trade]
    parts = [f"{x.name} {share(x.now, 0)} → {share(x.target, 0)}" for x in largest]
    sentence = f"Largest trades: {'; '.join(parts)}." if parts else ""
    cost, limit = sum(x.cost for x in classes), finite(run.get("turnover_limit"))
    limited = f"the limit is {share(limit)} a year" if limit else NO_LIMIT
    sentence = f"{sentence} Cost: {run.large(cost)}; {limited}.".lstrip()
    if today.trades.swaps:
        complete = run.large(sum(swap.target for swap in today.trades.swaps))
        sentence = f"{sentence} Receiver swaps: a notional of {complete}."
    return action, sentence


def _facts(run: PensionRun) -> list[Facts]:
    """Today's balance and the risk at the horizon; none for a part that was not asked for."""
    by_part = _facts_of_pots(run) if run.personal else _facts_of_rights(run)
    facts = [fact for name, rows in by_part.items() if not run.left_out(name) for fact in rows]
    return [Facts(facts)] if facts else []


def _facts_of_rights(run: PensionRun) -> dict[str, list[Fact]]:
    """{part: its facts}."""
    today, paths = RECONCILIATION.of(run), PATHS.of(run)
    funding, liability = (today.funding, today.liability) if today else (None, None)
    under, short = None, None
    if paths is not None:
        under, short = paths.by_year.underfunded[-1], paths.by_year.shortfall[-1]
    return {
        RECONCILIATION.name: [
            ("Funding ratio today", share(funding), "assets over liability"),
            ("Assets", run.large(run.assets), "market value today"),
            ("Liability", run.large(liability), "on the case's basis"),
        ],
        PATHS.name: [
            ("Underfunded", share(under), f"probability of F < 1 {run.horizon}, {run.measure}"),
            ("CVaR of the shortfall", share(short), "mean of min(F − 1, 0), worst 5 %"),
        ],
    }


def _facts_of_pots(run: PensionRun) -> dict[str, list[Fact]]:
    """{part: its facts}."""
    assets = run.large(run.assets), "market value today, pots and reserve"
    facts: dict[str, list[Fact]] = {RECONCILIATION.name: [("Assets", *assets)]}
    if (outputs := OUTPUTS.of(run)) is not None:
        mean = next((x.value for x in outputs.outputs if x.key == "funding"), None)
        over = f"of today's, {run.horizon}, {run.measure}"
        facts[OUTPUTS.name] = [("Mean pension", share(mean), over)]
    if (pots := POTS.of(run)) is not None:
        worst = max((x.cut for x in pots.cohorts if x.cut is not None), default=None)
        now, last = share(pots.reserve[0, 1]), share(pots.reserve[-1, 1])
        left = f"of the assets; median {last} one year before the horizon"
        facts[POTS.name] = [
            ("Pension today", share(pots.level), "of the accrued pension"),
            (
                "Years with a cut",
                share(worst),
                "of the years of payment, in the cohort with the largest share",
            ),
            ("Solidarity reserve", now, left),
        ]
    return facts


def history(run: PensionRun) -> Section:
    """The objective and the gradient norm over the steps of training."""
    return evidence.training_history(run, "objective")


def about(run: PensionRun) -> list[tuple[str, str]]:
    """The lines under the title."""
    lines = [("Valuation date", long_date(run.get("valuation_date")))]
    if run.years:
        steps = counted(run.get("steps") or 0, "decision")
        lines.append(("Horizon", f"{counted(run.years, 'year')}, {steps}"))
    lines.append(("Scenarios", MEASURES.get(run.measure, run.measure)))
    return [*lines, ("Currency", run.currency)]


TRAINED = unless_left_out(history, "training")
SECTIONS = (
    headline, RECONCILIATION, TODAY, FUNDING, POTS, ATTRIBUTION, VARIANCE, CONTRIBUTIONS,
    INDEXATION, POLICIES, FRONTIER, PATHS, OUTPUTS, SENSITIVITIES, LADDERS, LIMITS, STRESS,
    TRAINED, unless_left_out(value_bounds, "training"), CERTIFICATE,
    assumptions,
)  # fmt: skip
MENU = {
    "Balance": RECONCILIATION,
    "Today": TODAY,
    "Outlook": FUNDING,
    "Policies": POLICIES,
    "Risk": OUTPUTS,
    "Checks": TRAINED,
}
REPORT = Report("Pension fund", PensionRun, about, SECTIONS, MENU)
