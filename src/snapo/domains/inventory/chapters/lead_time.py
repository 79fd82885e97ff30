"""The effect of a lead time one period shorter or longer: the rule is trained again and valued on
the same paths."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from snapo.case.error import counted
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Missing, Section, Text
from snapo.report.quantity import decimals
from snapo.report.rows import Column, WithError, table
from snapo.solver import statistics
from snapo.solver.evaluate import value_of_groups
from snapo.solver.learning.progress import INTERRUPTED
from snapo.solver.solve import solve
from snapo.study.chapter import Chapter, Number
from snapo.study.study import Setup, StudyRun

from ..network.simulator import NetworkSimulator
from ..read.tables import LONGEST_LEAD
from ..setup import AnyCase, case_of, make_setup, network_of
from .about import CaseSummary

PATHS = 16384  # at most, of either value
STEPS = 200  # at most, of either training


@dataclass(frozen=True)
class OtherLeadTime:
    """The change of the result with another lead time, and its standard error.

    - `place`: the place in a network, empty for an item.
    """

    place: str
    lead: int
    change: Number
    standard_error: Number


@dataclass(frozen=True)
class OtherLeadTimes:
    """The results with other lead times; in a network, the lead time of one place at a time is
    changed."""

    lead_time_change: tuple[OtherLeadTime, ...]


def measure(run: StudyRun) -> OtherLeadTimes:
    """Measures one period less and one period more, as far as the case allows them."""
    rows = []
    for site, lead, other, case in _other_cases(run.setup):
        if 0 <= other <= LONGEST_LEAD:
            change = _change(run, make_setup(case, run.setup.engines.name))
            rows.append(OtherLeadTime(site, other, change.value, change.standard_error))
            where = f" of {site}" if site else ""
            run.progress(f"lead time {other}{where}: {change.value:+,.4g} compared with {lead}")
    return OtherLeadTimes(tuple(rows))


def _other_cases(setup: Setup) -> Iterator[tuple[str, int, int, AnyCase]]:
    """(place, its lead time, the other lead time, the case with the other lead time); the horizon
    is unchanged."""
    if isinstance(setup.problem.simulator, NetworkSimulator):
        case = network_of(setup)
        for i, site in enumerate(case.network.sites):
            for other in (site.lead_time - 1, site.lead_time + 1):
                sites = list(case.network.sites)
                sites[i] = replace(site, lead_time=other)
                network = replace(case.network, sites=tuple(sites))
                yield site.name, site.lead_time, other, replace(case, network=network)
    else:
        case = case_of(setup)
        for other in (case.item.lead_time - 1, case.item.lead_time + 1):
            item = replace(case.item, lead_time=other, coming=None)  # with its usual start
            yield "", case.item.lead_time, other, replace(case, item=item)


def _change(run: StudyRun, other: Setup) -> statistics.Sampled:
    setup = run.setup
    paths = min(PATHS, setup.evaluation.paths)
    evaluation = replace(
        setup.evaluation, paths=paths, sensitivity_paths=0, smooth_paths=0, judge_paths=0
    )
    training = replace(setup.training, steps=min(STEPS, setup.training.steps))
    solution = solve(
        other.problem,
        policy=other.policy,
        training=training,
        evaluation=evaluation,
        engine=other.engines,
    )
    if solution.status == INTERRUPTED:
        raise KeyboardInterrupt
    objective, source = setup.problem.objective, setup.problem.sources.evaluation
    values = value_of_groups(objective, solution.totals, source)
    totals = {
        name: total[: len(solution.totals[name])] for name, total in run.solution.totals.items()
    }
    return statistics.of_shares(values - value_of_groups(objective, totals, source))


def lead_time(run: RunFiles) -> Section:
    """The section; a run without other lead times has a text on how to request them."""
    section = LEAD_TIME(run)
    if CaseSummary.of(run).other_leads:
        return section
    text = "This run trains no other lead times: set `lead_time = true` in [report]."
    return replace(section, blocks=[Missing(text)])


def show(run: RunFiles, result: OtherLeadTimes) -> Sequence[Block]:
    """Shows the change in cost if the lead time is one period longer or shorter."""
    step, rows = CaseSummary.of(run).step, result.lead_time_change
    columns = [
        Column("Lead time", lambda row: counted(row.lead, step)),
        Column("Change in cost", lambda row: WithError(-row.change, row.standard_error), run.unit,
               sign=True),
    ]  # fmt: skip
    if any(row.place for row in rows):
        columns.insert(0, Column("Place", "place"))
    digits = max(decimals([row.standard_error for row in rows], 2), 2)
    text = "The rule is trained again for each lead time; results are compared on the same paths."
    changes = table(rows, columns, "Other lead times", decimal_places=digits)
    return [changes, Text(text, caveat=True)]


LEAD_TIME = Chapter(
    "lead time", "A lead time one period longer or shorter", OtherLeadTimes, measure, show,
    short="Lead time",
)  # fmt: skip
