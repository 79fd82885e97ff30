"""The study of a pension fund: the parts of a run, each with its tables."""

import re
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from snapo.case.error import counted
from snapo.report.quantity import measured
from snapo.solver.provenance import versions
from snapo.study import training
from snapo.study.domain import Options
from snapo.study.study import Part, Setup, Study, StudyRun
from snapo.study.training import TRAINING, trained

from ..bounds.relaxation import FundRelaxation, conjugate
from ..chapters import live
from ..chapters.attribution import ATTRIBUTION, VARIANCE
from ..chapters.evidence import CERTIFICATE, CONSISTENCY
from ..chapters.frontier import FRONTIER
from ..chapters.objective import OBJECTIVE, headline_name
from ..chapters.outputs import OUTPUTS
from ..chapters.paths import PATHS
from ..chapters.policies import LEARNED, POLICIES, leads
from ..chapters.pots import POTS
from ..chapters.reconciliation import RECONCILIATION
from ..chapters.sensitivities import SENSITIVITIES
from ..chapters.stress import STRESS
from ..chapters.today import TODAY
from ..records.case import OF_RIGHTS, PensionCase
from ..run import share
from .figures.lines import examine
from .setup import case_of, make_setup, objective_of, setup_at

PARTS = (
    RECONCILIATION.part,
    STRESS.part,
    TRAINING,
    *(
        chapter.part
        for chapter in (
            OBJECTIVE, PATHS, TODAY, SENSITIVITIES, OUTPUTS, CERTIFICATE, ATTRIBUTION, VARIANCE,
            CONSISTENCY, POLICIES, FRONTIER,
        )
    ),
)  # fmt: skip
MEASURES = {"P": "real-world (P)", "Q": "risk-neutral (Q)"}


def pension_study(case: PensionCase, options: Options) -> Study:
    """The study of a case: everything that a run of it does.

    **Raises:** `CaseError`, before anything is written, if a figure differs too much from the
    actuary's.
    """
    notes = (options.about or {}).get("notes")  # of a run that passed, and goes on
    if notes is None:
        notes = [*case.notes, *examine(case).remarks]
    engine = options.engine

    @cache
    def setup() -> Setup:
        return make_setup(case, engine)

    def at_case(before: Setup, other: PensionCase) -> Setup:
        return setup_at(before, other, engine)

    def relaxation() -> FundRelaxation:
        return FundRelaxation(setup().problem, setup().policy)

    every, selected = parts(case), requested(case)
    available = about(case) | {"notes": list(notes)} | training.summary(every, selected)
    if TRAINING not in selected:  # which records them
        available |= {"seed": case.training.seed, "versions": versions()}
    checks, bounded = ("reconcile",), _unbounded(case) or relaxation
    today = None if case.pots is not None else live.today
    return Study(
        "pension", available, selected, result, setup, bounded, at_case, checks,
        today=today, live_tables=live.outcome, headline=live.headline,
    )  # fmt: skip


def parts(case: PensionCase) -> tuple[Part, ...]:
    """The parts of a run: those of promised rights, or of personal pots."""
    if case.pots is None:
        return PARTS
    return (*(part for part in PARTS if part.name not in OF_RIGHTS), POTS.part)


def requested(case: PensionCase) -> list[Part]:
    """The parts that the case requests and those that they need. With training, the description of
    the policy's value is added, with which every report begins."""
    every = parts(case)
    selected = training.with_needs(every, case.parts)
    if case.parts and TRAINING in selected:
        selected = training.with_needs(every, (*case.parts, OBJECTIVE.name))
    return selected


def about(case: PensionCase) -> dict[str, Any]:
    """The case as the report names it; money in its currency, shares as fractions."""
    return {
        "title": case.title,
        "currency": case.currency,
        "valuation_date": case.valuation_date,
        "measure": "supplied" if case.scenarios is not None else case.measure,
        "years": case.steps * case.step,
        "step": case.step,
        "steps": case.steps,
        "model": _model(case),
        "kinds": {class_.kind: class_.description for class_ in case.assets.classes},
        "held": list(case.held),
        "personal": case.pots is not None,
        "assets": float(case.assets.amount.used()),
        "turnover_limit": case.assets.turnover,
        "names": {
            f"weights.{i}": f"{class_.name}, share of the assets"
            for i, class_ in enumerate(case.assets.classes)
        }
        | {
            "theta": "indexation so far",
            "fresh": "rights accrued, divided by those of the baseline",
        },
        "headline": headline_name(objective_of(case)),
        "units": {"funding": "assets over liability"}
        | dict.fromkeys(("contribution", "benefit", "expenses", "cost"), case.currency),
    }


def result(run: StudyRun) -> Mapping[str, Any]:
    """The headline: the trained policy's value, and those of the classical policies."""
    others = [policy for policy in POLICIES.of(run) or () if policy.key != LEARNED]
    advantages = [(policy.name, policy.difference, policy.difference_error) for policy in others]
    references = {policy.key: policy.value for policy in others}
    if not (entries := trained(run, references, advantages)):
        return entries
    case = case_of(run)
    notes = [in_classes(note, case) for note in entries.get("notes", ())]
    return entries | {"notes": notes, "description": list(_description(run, case))}


def _description(run: StudyRun, case: PensionCase) -> Iterator[str]:
    """The value and the leads in the terms of a fund."""
    objective = OBJECTIVE.of(run)
    if objective is not None and objective.output is not None:
        name = (
            "pension, as a share of today's," if objective.output == "pension" else "funding ratio"
        )
        value, half = measured(100 * objective.equivalent, 100 * objective.equivalent_error, 2)
        years = counted(case.steps * case.step, "year")
        yield f"certain {name} after {years}: {value} % {half} (95 %)"
    if compared := leads(POLICIES.of(run) or ()):
        yield compared


STILL = re.compile(r"(\d+)(?: of \d+)?(?: never changes)? \(([-+.\deE]+), at its limit\)")


def in_classes(note: str, case: PensionCase) -> str:
    """A note on weights that never leave a bound, with the names of their classes and without
    advice."""
    rows, classes = STILL.findall(note), case.assets.classes
    if "never change" not in note or not rows or any(int(k) > len(classes) for k, _ in rows):
        return note
    texts = []
    for number, value in rows:
        i = int(number) - 1
        low, high = float(case.assets.low[i]), float(case.assets.high[i])
        name, bound = ("lower", low) if float(value) < (low + high) / 2 else ("upper", high)
        texts.append(f"{classes[i].name} stays at its {name} bound of {share(bound, 0)}.")
    return " ".join(texts)


def _unbounded(case: PensionCase) -> str:
    """The reason why the value of a fund is not bounded from above; empty if it is."""
    if case.pots is not None:
        return "there is no upper bound for a fund of personal pots"
    if case.scenarios is not None:
        return "ready-made scenarios have no prices of risk, which a bound needs"
    try:
        conjugate(objective_of(case))
    except ValueError as reason:
        return str(reason)
    return ""


def _model(case: PensionCase) -> str:
    if case.scenarios is not None:
        return "Supplied scenarios: returns, inflation, wages and zero rates from a file."
    mean = f"means are {case.assets.mean_kind} means of {case.assets.return_kind} returns"
    text = f"{case.rates.description}, fitted to the curve; {MEASURES[case.measure]} scenarios"
    return (
        f"{text}; {mean}." if case.measure == "P" else f"{text}; every class earns cash on average."
    )
