"""The study of an item or a network: the parts of a run, and the headline of its result."""

from typing import Any

from snapo.case.error import CaseError
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.profile import profile
from snapo.study.chapters.sensitivities import MOVES
from snapo.study.domain import Options
from snapo.study.study import Part, Study, StudyRun
from snapo.study.training import TRAINING, trained

from .chapters.about import about
from .chapters.baselines import BASELINES
from .chapters.lead_time import LEAD_TIME
from .chapters.levels import LEVELS, today
from .chapters.places import PLACES, network_tables, service_and_places
from .chapters.service import SERVICE, live_tables
from .network.records import NetworkCase
from .setup import AnyCase, make_setup, setup_at


def study(case: AnyCase, options: Options) -> Study:
    """The parts of a run: training, service and costs, the rule of an item, classical rules, moves,
    lead time, outputs."""
    if options.reference:
        allowed = (
            "an inventory has no exact values to compute; every run compares the rule with "
            "classical rules"
        )
        raise CaseError("--reference", "", None, allowed)
    is_network, setup = isinstance(case, NetworkCase), make_setup(case, options.engine)
    if is_network:
        own_parts = [Part(PLACES.name, service_and_places, PLACES.needs)]
    else:
        own_parts = [SERVICE.part, LEVELS.part]
    parts = [
        TRAINING,
        *own_parts,
        BASELINES.part,
        MOVES.part,
        *([LEAD_TIME.part] if case.other_leads else []),
        DISTRIBUTION.part,
        profile(without=("likelihood",) if is_network else ("likelihood", "missed")).part,
        CERTIFICATE.part,
    ]
    return Study(
        "inventory",
        about(case),
        tuple(parts),
        _result,
        lambda: setup,
        setup_at=setup_at,
        today=None if is_network else today,
        inputs=lambda other: other.inputs(),
        live_tables=network_tables if is_network else live_tables,
    )


def _result(run: StudyRun) -> dict[str, Any]:
    """The headline: the values of the trained rule and of the classical rules."""
    results = BASELINES.of(run)
    rules = results.rivals[1:] if results else ()
    # A non-finite difference is None in the files of a run.
    lead_time = [
        (x.rule, -x.difference, x.difference_error) for x in rules if x.difference is not None
    ]
    return trained(run, {rule.rule: rule.value for rule in rules}, lead_time)
