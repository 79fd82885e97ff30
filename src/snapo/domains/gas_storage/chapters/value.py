"""The value of the contract by several methods, and the distribution of its cash flow."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from snapo.problem.problem import Problem
from snapo.report import charts
from snapo.report.drawing import draw
from snapo.report.missing import why_missing
from snapo.report.page import Block, Chart, Facts, Section, Table, Text
from snapo.report.quantity import decimals, finite, number, plus_minus
from snapo.solver.evaluate import Value, evaluate
from snapo.solver.solution import Solution
from snapo.study.chapter import Chapter, Floats, Number, floats
from snapo.study.chapters.bound import BOUND
from snapo.study.chapters.headline import common_paths
from snapo.study.study import Setup, StudyRun

from ..contract.records import StorageCase
from ..contract.simulator import simulator_of
from ..policy.value_table import FittedKnots
from ..references.intrinsic import intrinsic
from ..references.lattice import refined
from ..setup import OUTPUT, case_of, factors, on_independent_paths, policy_of
from .position import working_volume
from .run import StorageRun

PATHS = 16384
QUANTILES = (1, 5, 25, 50, 75, 95, 99)
TITLE = "Value by method"


@dataclass(frozen=True)
class IntrinsicValue:
    """The best plan at today's forward curve: its value, and the net injections [T] by decision
    day."""

    value: Number
    net: Floats


@dataclass(frozen=True)
class Reference:
    """The exact value, and the remaining change of this value on finer grids; both are None without
    an exact value."""

    dynamic_programming: float | None = None
    dynamic_programming_error: float | None = None


def intrinsic_chapter(problem: Problem, case: StorageCase) -> Chapter[IntrinsicValue]:
    """The chapter "intrinsic value" of a contract, which needs no training."""

    def measure(run: StudyRun) -> IntrinsicValue:
        plan = intrinsic(problem.schedule, case.contract.ratchets.interpolation)
        return IntrinsicValue(plan.value, plan.net)

    return replace(INTRINSIC, measure=measure)


def measure_reference(run: StudyRun) -> Reference:
    """The value by dynamic programming, if the price process has a lattice."""
    setup = run.setup
    lattice = factors(setup.problem)
    if lattice is None or not lattice.exact:
        return Reference()
    kind = case_of(setup).contract.ratchets.interpolation
    return Reference(*refined(setup.problem.schedule, lattice, kind))


@dataclass(frozen=True)
class ContractValue:
    """The value of the contract by one method; `note`: the meaning of this value."""

    name: str
    value: Number
    standard_error: float | None = None
    note: str = ""


@dataclass(frozen=True)
class CashFlow:
    """The total discounted cash flow of a path: a histogram, moments and quantiles {"5": …}."""

    edges: Floats = floats()
    counts: Floats = floats()
    mean: Number = np.nan
    standard_deviation: Number = np.nan
    quantiles: dict[str, Number] = field(default_factory=dict)


@dataclass(frozen=True)
class ContractValues:
    """The values from the lowest to the highest (the value ladder), and the distribution of the
    earnings.

    - `break_even_fee`: the fee per unit of working volume, paid today, with which the contract has
      the value 0; NaN without a working volume.
    """

    break_even_fee: Number = np.nan
    value_ladder: tuple[ContractValue, ...] = ()
    cash_flow: CashFlow = field(default_factory=CashFlow)

    @property
    def value_of(self) -> list[ContractValue]:
        """The values that are numbers."""
        return [value for value in self.value_ladder if np.isfinite(value.value)]


def measure(run: StudyRun) -> ContractValues:
    """The value ladder, the break-even fee and the distribution of the cash flow."""
    solution, volume = run.solution, working_volume(case_of(run.setup))
    return ContractValues(
        solution.value / volume if volume > 0 else float("nan"),
        tuple(_ladder(run, solution)),
        _distribution(np.asarray(solution.totals[OUTPUT])),
    )


def _ladder(run: StudyRun, solution: Solution) -> list[ContractValue]:
    """The values: intrinsic, of the starting rule, of the trained policy, the reference, the bound,
    and after fixed costs."""
    engine = run.setup.engines.evaluate
    starting = evaluate(
        on_independent_paths(run.setup), policy_of(solution).value_rule, paths=PATHS, engine=engine
    )
    plan, error = INTRINSIC.of(run), solution.standard_error
    ladder = [
        ContractValue("Intrinsic", plan.value, None, "best plan fixed today, at the forward curve")
        if plan
        else ContractValue("Intrinsic", np.nan),
        _starting_value(run.setup, starting),
        ContractValue("Trained policy", solution.value, error, "exact simulator, on fresh paths"),
    ]
    reference = REFERENCE.of(run)
    if reference is not None and (exact := reference.dynamic_programming) is not None:
        moved = reference.dynamic_programming_error or 0.0
        note = f"lattice in at most two price factors; finer grids move it by {moved:,.2g}"
        ladder.append(ContractValue("Dynamic programming", exact, None, note))
    if (bounds := BOUND.of(run)) is not None:
        note = "perfect foresight with a penalty: no policy earns more"
        if small := bounds.says_little:
            note = f"{note}; {small}"
        above = bounds.upper
        ladder.append(ContractValue("Upper bound", above.value, above.standard_error, note))
    if fees := run.get("fixed_costs"):
        note = "minus their present value"
        ladder.append(ContractValue("After fixed costs", solution.value - fees, error, note))
    return ladder


def _starting_value(setup: Setup, value: Value) -> ContractValue:
    """The value of the starting rule, before any training."""
    table = simulator_of(setup.problem).value_table
    if table is not None and isinstance(table.knots, FittedKnots):
        name, note = "Fitted rule", "fitted value iteration, before training, on other paths"
    else:
        name, note = (
            "One-factor rule",
            "dynamic program in the fastest price factor, on other paths",
        )
    return ContractValue(name, value.value, value.standard_error, note)


def _distribution(cash: np.ndarray) -> CashFlow:
    counts, edges = np.histogram(cash, bins=60)
    quantiles = {str(q): float(np.quantile(cash, q / 100)) for q in QUANTILES}
    return CashFlow(edges, counts, cash.mean(), cash.std(), quantiles)


def show(run: StorageRun, result: ContractValues) -> Sequence[Block]:
    """Every value of the same contract at the same curve, from the lowest to the highest."""
    values = result.value_of
    if not values:
        return [why_missing(run, VALUES.name)]
    digits, bars = decimals([x.value for x in values]), ladder_bars(run, values)
    caption = (
        "Present values of the same contract at the same forward curve. The value of any policy "
        "without foresight is a lower bound on the optimum."
    )
    rows = [
        (x.name, x.note, number(x.value, digits), plus_minus(x.standard_error, digits))
        for x in values
    ]
    strong = frozenset(i for i, bar in enumerate(bars) if bar.strong)
    head = [("", ""), ("Meaning", ""), ("Value", run.currency), ("", "")]
    blocks: list[Block] = [Table(head, rows, texts=2, strong=strong), Text(caption, caveat=True)]
    blocks += common_paths(run)
    if costs := finite(run.get("fixed_costs")):
        blocks.append(Text(f"Fixed costs have a present value of {run.money(costs)}."))
    return blocks


def ladder_bars(run: StorageRun, values: Sequence[ContractValue]) -> list[charts.LadderBar]:
    """The bars of the ladder; the bar with the value of the headline is highlighted."""
    digits, headline = decimals([x.value for x in values]), run.result.value
    strong = next((i for i, x in enumerate(values) if x.value == headline), None)
    return [
        charts.LadderBar(
            x.name, x.value, run.value_text(x.value, x.standard_error, digits), x.standard_error,
            i == strong,
        )
        for i, x in enumerate(values)
    ]  # fmt: skip


def cash_flow(run: StorageRun) -> Section:
    """The distribution of the total discounted cash flow over the paths."""
    title, short = "Distribution of the total cash flow", "Cash flow"
    values = VALUES.of(run)
    cash = CashFlow() if values is None else values.cash_flow
    if not cash.counts.size or len(cash.edges) != len(cash.counts) + 1:
        return Section("cash-flow", title, short, [why_missing(run, VALUES.name)])
    quantiles = {float(q): x for q, x in cash.quantiles.items() if np.isfinite(x)}
    mean = cash.mean if run.get("objective", "mean") != "mean" else run.result.value
    marks = [("mean", mean)] if mean is not None and np.isfinite(mean) else []
    marks += [(f"{q:g} %", x) for q, x in quantiles.items() if q in (5, 95, 1, 99)]
    digits, facts = decimals(cash.edges), []
    if np.isfinite(cash.mean):
        spread = run.money(cash.standard_deviation, digits)
        facts.append(("Standard deviation", spread, "of the earnings of one path"))
    names = {1: "1 % quantile", 5: "5 % quantile", 50: "Median", 95: "95 % quantile"}
    facts += [
        (name, run.money(quantiles[q], digits), "") for q, name in names.items() if q in quantiles
    ]
    alt = "Histogram of the total cash flow per path. " + "; ".join(
        f"{text}: {run.money(x, digits)}" for text, x in marks
    )
    unit = f"Total discounted cash flow, {run.currency}" if run.currency else "Total cash flow"
    svg = draw(
        "cash-flow-bins", alt,
        lambda axes: charts.histogram(axes, cash.edges, cash.counts, marks, unit),
    )  # fmt: skip
    caption = (
        "Earnings of the storage on one path, unhedged; trading the deltas below removes "
        "most of this spread."
    )
    return Section("cash-flow", title, short, [Chart(svg, caption), Facts(facts)])


def _unmeasured(run: StudyRun) -> IntrinsicValue:
    raise ValueError("see `intrinsic_chapter`")


INTRINSIC = Chapter("intrinsic value", "Intrinsic value", IntrinsicValue, _unmeasured,
                    lambda run, plan: [], needs=(), key="intrinsic")  # fmt: skip
REFERENCE = Chapter("dynamic programming", "Dynamic programming", Reference, measure_reference,
                    lambda run, reference: [], needs=())  # fmt: skip
VALUES = Chapter("value ladder", TITLE, ContractValues, measure, show, "Value",
                 needs=("intrinsic value", "training"))  # fmt: skip
