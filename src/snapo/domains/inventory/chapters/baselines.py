"""Compares the trained rule on the same paths with classical rules, each with its best numbers."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from snapo.engine import Xla
from snapo.problem.policy import Policy
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Text
from snapo.report.quantity import decimals, finite, number, percent
from snapo.report.rows import Column, WithError, table
from snapo.solver.evaluate import path_totals, value_of_groups
from snapo.solver.statistics import of_shares
from snapo.study.chapter import Chapter, Number
from snapo.study.study import Setup, StudyRun

from ..network.rules import network_rules
from ..network.simulator import NetworkSimulator
from ..policy.rules import item_rules, myopic_of
from ..policy.search import SEARCH_PATHS


@dataclass(frozen=True)
class RuleResult:
    """The result of a rule, minus its cost, and its standard error.

    - `difference`, `difference_error`: the difference from the trained rule and its error, paired
      path by path; None for the trained rule.
    - `numbers`: the numbers of the rule, as a planner writes them.
    """

    rule: str
    value: Number
    standard_error: Number
    difference: float | None = None
    difference_error: float | None = None
    numbers: dict[str, Number] = field(default_factory=dict)


@dataclass(frozen=True)
class RuleResults:
    """All rules, with the trained rule first."""

    rivals: tuple[RuleResult, ...]


def measure(run: StudyRun) -> RuleResults:
    """Values all classical rules of the item or network on the paths of the trained rule."""
    setup = run.setup
    problem, paths = setup.problem, run.solution.paths["evaluate"]
    source, is_network = problem.sources.evaluation, isinstance(problem.simulator, NetworkSimulator)
    trained = value_of_groups(problem.objective, run.solution.totals, source)
    rows = [RuleResult("trained", *of_shares(trained)[:2])]

    def compare(name: str, shares: np.ndarray, trained: np.ndarray, numbers: dict[str, float]):
        result, gap = of_shares(shares), of_shares(shares - trained)
        run.progress(
            f"{name}: {result.value:,.6g}, difference from the trained rule {gap.value:+,.3g}"
        )
        rows.append(RuleResult(name, *result[:2], *gap[:2], numbers))

    for name, rule, numbers in network_rules(setup) if is_network else item_rules(setup):
        totals = path_totals(problem, rule, paths, engine=setup.engines.evaluate)
        compare(name, value_of_groups(problem.objective, totals, source), trained, numbers)
    if not is_network and (rule := myopic_of(setup)) is not None:
        local = _first_paths(setup, run.solution.policy)
        compare("myopic", _first_paths(setup, rule), local, {})
    return RuleResults(tuple(rows))


def _first_paths(setup: Setup, policy: Policy | None) -> np.ndarray:
    """Means over independent groups of the first paths, for a rule that takes long to compute."""
    problem, source = setup.problem, setup.problem.sources.evaluation
    assert policy is not None
    paths = min(SEARCH_PATHS, setup.evaluation.paths)
    totals = path_totals(problem, policy, paths, engine=Xla())
    return value_of_groups(problem.objective, totals, source)


def show(run: RunFiles, result: RuleResults) -> Sequence[Block]:
    """The costs of all rules, and their excess over the cost of the trained rule."""
    rows = result.rivals
    errors = [row.difference_error for row in rows if finite(row.difference_error)]
    digits = min(6, max([2, *(decimals([error], 2) for error in errors)]))
    trained = rows[0].value or 1.0

    def numbers(row: RuleResult) -> str:
        return ", ".join(f"{name} {number(value, 1)}" for name, value in row.numbers.items())

    def excess(row: RuleResult) -> WithError:
        gap = row.difference
        return WithError(None if gap is None else -gap, row.difference_error)

    def share(row: RuleResult) -> str:
        return "" if row.difference is None else percent(row.difference / trained, 2)

    columns = (
        Column("Rule", lambda row: row.rule[:1].upper() + row.rule[1:]),
        Column("Numbers", numbers),
        Column("Cost", lambda row: WithError(-row.value, row.standard_error), run.unit),
        Column("Excess cost", excess, run.unit, sign=True),
        Column("", share),
    )
    text = (
        "The parameters of each rule are the best of a search on other paths; differences are "
        "between values on the same paths."
    )
    costs = table(rows, columns, "Costs of the rules", decimal_places=digits)
    return [replace(costs, texts=2, strong=frozenset([0])), Text(text, caveat=True)]


BASELINES = Chapter(
    "rivals",
    "The trained rule and classical rules on the same paths",
    RuleResults,
    measure,
    show,
    short="Rules",
)
