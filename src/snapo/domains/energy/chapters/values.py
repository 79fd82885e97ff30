"""The value by several methods, from the lowest to the highest."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from snapo.report.folder import RunFiles
from snapo.report.page import Block, Text
from snapo.report.rows import Column, WithError, table
from snapo.solver.derivatives.rebuilt import fewer
from snapo.solver.evaluate import evaluate
from snapo.study.chapter import Chapter, Number
from snapo.study.chapters.bound import BOUND
from snapo.study.chapters.headline import common_paths
from snapo.study.study import StudyRun

from ..core.policy import UnitValuePolicy
from .reference import INTRINSIC, REFERENCE, around

PATHS = 16384


@dataclass(frozen=True)
class MethodValue:
    """The value by one method, its error if it has one, and its meaning."""

    name: str
    value: Number
    standard_error: float | None = None
    note: str = ""


@dataclass(frozen=True)
class MethodValues:
    """The values by all methods."""

    value_ladder: tuple[MethodValue, ...] = ()


def measure(run: StudyRun) -> MethodValues:
    """The values: intrinsic, of the fitted rule, of the trained policy, by the lattice, and the
    bound."""
    solution, setup, rows = run.solution, run.setup, []
    if (plan := INTRINSIC.of(run)) is not None:
        note = "all decisions fixed today, at forward prices"
        rows.append(MethodValue("Intrinsic", plan.intrinsic, None, note))
    policy = solution.policy
    if isinstance(policy, UnitValuePolicy):
        paths = fewer(PATHS, setup.problem.simulator.horizon)
        rule = evaluate(
            setup.problem, policy.value_rule, paths=paths, engine=setup.engines.evaluate
        )
        note = "least squares, before training, on other paths"
        rows.append(MethodValue("Fitted rule", rule.value, rule.standard_error, note))
    note = "exact simulator, on fresh paths"
    rows.append(MethodValue("Trained policy", solution.value, solution.standard_error, note))
    reference = REFERENCE.of(run)
    if reference is not None and reference.dynamic_programming is not None:
        moved = reference.dynamic_programming_error or 0.0
        note = f"lattice; finer grids move it by {moved:,.2g}"
        rows.append(MethodValue("Dynamic programming", reference.dynamic_programming, None, note))
    if reference is not None and (values := around(setup.problem)) is not None:
        notes = (
            "lattice without intraday trades: a lower bound",
            "lattice without schedules: an upper bound",
        )
        names = "Auctions only", "Without auctions"
        rows += [MethodValue(*x[:2], None, x[2]) for x in zip(names, values, notes)]
    if (bounds := BOUND.of(run)) is not None:
        above, note = bounds.upper, "perfect foresight with a penalty: no policy earns more"
        rows.append(MethodValue("Upper bound", above.value, above.standard_error, note))
    return MethodValues(tuple(rows))


def show(run: RunFiles, result: MethodValues) -> Sequence[Block]:
    """A table of the values, from the lowest to the highest."""
    columns = [
        Column("Method", lambda row: row.name),
        Column("Meaning", lambda row: row.note),
        Column("Value", lambda row: WithError(row.value, row.standard_error), run.unit),
    ]
    caption = "Present values. The value of a policy is a lower bound on the optimum."
    rows = result.value_ladder
    strong = frozenset(i for i, row in enumerate(rows) if row.name == "Trained policy")
    values = replace(table(rows, columns), texts=2, strong=strong)
    return [values, Text(caption, caveat=True), *common_paths(run)]


VALUES = Chapter("value ladder", "Value by method", MethodValues, measure, show, "Methods",
                 needs=("training",))  # fmt: skip
