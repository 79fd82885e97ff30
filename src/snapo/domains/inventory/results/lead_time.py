"""A period of lead time less, and one more: each trained anew, on the same paths."""

from dataclasses import replace
from typing import Any

from snapo.solver import statistics
from snapo.solver.evaluate import worth_of_groups
from snapo.solver.solve import solve
from snapo.study.study import Part, Setup, StudyRun

from ..item.records import InventoryCase
from ..read.tables import LONGEST_LEAD
from ..setup import case_of, make_setup

PATHS = 16384  # at most, of either value
STEPS = 200  # at most, of either training


def work(run: StudyRun) -> dict[str, Any]:
    """ "lead_time_change": one row per other lead time, the change of the result and its error."""
    setup, case = run.setup, case_of(run.setup)
    rows = []
    for lead in (case.item.lead - 1, case.item.lead + 1):
        if not 0 <= lead <= LONGEST_LEAD:
            continue
        change = _change(run, setup, with_lead(case, lead))
        rows.append({"lead": lead, "change": change.value, "standard_error": change.standard_error})
        run.tell(f"lead time {lead}: {change.value:+,.4g} to that of {case.item.lead}")
    return {"lead_time_change": rows}


LEAD_TIME = Part("lead time", work, needs=("training",))


def with_lead(case: InventoryCase, lead: int) -> InventoryCase:
    """The case with another lead time and its usual start; the horizon stays."""
    return replace(case, item=replace(case.item, lead=lead, coming=None))


def _change(run: StudyRun, setup: Setup, case: InventoryCase) -> statistics.Sampled:
    other = make_setup(case, setup.engines.name)  # pyright: ignore[reportArgumentType]
    paths = min(PATHS, setup.evaluation.paths)
    evaluation = replace(
        setup.evaluation, paths=paths, sensitivity_paths=0, smooth_paths=0, judge_paths=0
    )
    training = replace(setup.training, steps=min(STEPS, setup.training.steps))
    solved = solve(
        other.problem,
        policy=other.policy,
        training=training,
        evaluation=evaluation,
        engine=other.engines,
    )
    objective, source = setup.problem.objective, setup.problem.sources.evaluation
    found = worth_of_groups(objective, solved.totals, source)
    totals = {
        name: total[: len(solved.totals[name])] for name, total in run.solution.totals.items()
    }
    return statistics.of_shares(found - worth_of_groups(objective, totals, source))
