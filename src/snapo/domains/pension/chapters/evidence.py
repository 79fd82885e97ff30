"""Evidence for the numbers: market consistency, certificate, training, assumptions, versions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.case.error import counted
from snapo.problem.inputs import plain
from snapo.problem.scenarios import EVALUATE, Pseudo, Scenarios, stream
from snapo.report import evidence
from snapo.report.missing import not_asked
from snapo.report.page import Block, Facts, Mark, Section, Table, Text
from snapo.report.quantity import decimals, finite, measured, number
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals
from snapo.study.chapter import Chapter, Number
from snapo.study.chapters.certificate import Certificate, bump_table, certificate, limit_table
from snapo.study.study import StudyRun
from snapo.study.training import TRAINING

from ..fund.simulator import PensionSimulator
from ..market.curve import log_bond
from ..market.state import log_factor
from ..people.cash_flows import reserved
from ..people.liability import nodes
from ..read.cells import empty
from ..records.case import PensionCase, PensionModel
from ..results.figures.lines import examine
from ..results.setup import case_of
from ..run import PensionRun, name_of

PATHS = 16384
ROUND_OFF = 1e-12  # of a value that does not vary over paths
SIGNIFICANT = 0.997  # that all tests together hold, where all is consistent
TENORS = (1, 10, 30)  # years: bonds that are priced at the horizon


class BondsPriced(PensionSimulator):
    """The fund with further outputs: discounted values of bonds at the horizon, such as "bond 10".

    Values are per unit of the forward price. The bonds are index-linked if the liability follows
    prices.
    """

    def terminal(self, constants, state, smooth):
        market = state.market
        value = log_factor(constants.market, constants.last_shape, market) + market.log_discount
        if _real(self.model):
            value = value + market.log_price
        years = np.rint(nodes(self.model.step) * self.model.step * 1e6) / 1e6
        bonds = {f"bond {u}": jnp.exp(value[np.flatnonzero(years == u)[0]]) for u in TENORS}
        return super().terminal(constants, state, smooth) | bonds


Expected = tuple[str, np.ndarray, float]  # a name, values [paths], their expectation


@dataclass(frozen=True)
class MarketTest:
    """A discounted value by simulation, its expectation, and whether they agree."""

    name: str = ""
    own: Number = np.nan
    expected: Number = np.nan
    standard_error: Number = np.nan
    ok: bool | None = None


def measure(run: StudyRun) -> tuple[MarketTest, ...]:
    """Discounted values and their expectations, with the trained policy.

    The scenarios are risk-neutral ("Q"), whatever the measure of the case. The cost of hedging
    currencies is left out, since no market participant receives it; other costs count when they are
    paid. There are no tests if scenarios are supplied. Appraised values, and liabilities on a basis
    with a spread, are not tested, since they are not market prices.
    """
    case, setup = case_of(run), run.setup
    if case.scenarios is not None:
        return ()
    free = replace(case.currencies, hedge_cost=empty("hedge_cost", (len(case.currencies.names),)))
    simulator = BondsPriced.of(replace(case, measure="Q", currencies=free))
    source = Pseudo(setup.training.seed, stream=stream(EVALUATE, 3))
    problem, policy = replace(setup.problem, simulator=simulator), run.solution.policy
    assert policy is not None
    engine = setup.engines.evaluate
    totals = path_totals(problem, policy, PATHS, engine=engine, source=source)
    tests = _tests(case, plain(problem.inputs), totals, examine(case).figures.liability)
    return tuple(_tested(test, source, len(tests)) for test in tests)


def _tests(case: PensionCase, inputs: dict[str, Any], totals, liability: float) -> list[Expected]:
    years = case.steps * case.step
    tests = [
        ("Discount factor at the horizon", totals["discount"], _price(case, inputs, years, False))
    ]
    if case.liability.basis != "fixed":
        kind = "Index-linked bond" if _real(case) else "Bond"
        now = _price(case, inputs, years, _real(case))
        for u in TENORS:
            then = _price(case, inputs, years + u, _real(case))
            values = totals[f"bond {u}"] * then / now
            name = (
                f"Fit of the curve: {kind.lower()} of {counted(u, 'year')} bought after "
                f"{counted(years, 'year')}"
            )
            tests.append((name, values, then))
    if not case.assets.smoothed:
        paid = totals["pv_benefit"] + totals["pv_expenses"] + totals["pv_cost"]
        left = totals["pv_assets"] + paid - totals["pv_contribution"]
        assets = float(case.assets.amount.used())
        tests.append(("Assets at the horizon and net payments", left, assets))
    plain_basis = case.liability.basis == "risk-free" and not _real(case)
    if plain_basis and case.lee_carter is None:
        added = totals["pv_indexation"] + totals["pv_accrual"]
        paid = float(reserved(case, inputs)) * totals["pv_benefit"]
        left = totals["pv_liability"] + paid - added
        tests.append(("Liability at the horizon and net payments", left, liability))
    return tests


def _real(case: PensionModel) -> bool:
    return case.liability.future_indexation == "full"


def _price(case: PensionCase, values: dict[str, Any], years: float, real: bool) -> float:
    """P(0, years) on today's curve, nominal or index-linked."""
    with jax.enable_x64(True):
        when = np.array([years])
        result = float(log_bond(case.curve, values, when)[0])
        prices = float(log_bond(case.inflation.break_even, values, when)[0]) if real else 0.0
    return float(np.exp(result - prices))


def _tested(test: Expected, source: Scenarios, tests: int) -> MarketTest:
    """The mean over independent groups of paths against its expectation; `tests`: their number."""
    name, values, expected = test
    mean = statistics.mean(values, source.groups(np.arange(values.size)))
    low, high = mean.interval(SIGNIFICANT, tests)
    none = ROUND_OFF * abs(expected)
    agrees = bool(low - none <= expected <= high + none)
    return MarketTest(name, mean.value, expected, mean.standard_error, agrees)


def show(run: PensionRun, result: tuple[MarketTest, ...]) -> Sequence[Table]:
    """The tests in a table, which is a part of the reconciliation."""
    rows = [
        (
            test.name,
            Mark(bool(test.ok), "holds" if test.ok else "fails"),
            *measured(test.own, test.standard_error, decimals([test.own], 4)),
            number(test.expected),
        )
        for test in result
    ]
    head = [("Test", ""), ("", ""), ("Simulated", ""), ("", ""), ("Expected", "")]
    caption = "Market consistency under Q on fresh paths with the trained policy"
    return [Table(head, rows, caption, 2)]


CONSISTENCY = Chapter(
    "market consistency", "Market consistency", tuple[MarketTest, ...], measure, show,
    needs=(TRAINING.name, "reconciliation"), key="market_consistency",
)  # fmt: skip


def show_certificate(run: PensionRun, result: Certificate) -> list[Block]:
    """The comparison of the adjoint with bumps, and every limit."""
    gap = number(result.smoothing_gap)
    facts = [("Smoothing gap", gap, "objective with exact rules minus that with smooth ones")]
    return [
        Facts([*facts, *evidence.gradient(run)]),
        bump_table(result, "", name_of),
        limit_table(result, "", "Step", _step),
    ]


CERTIFICATE = certificate(tolerance=lambda problem: 1e-9, show=show_certificate)  # of a share


def _step(step) -> str:
    return number((finite(step) or 0) + 1, 0)


def assumptions(run: PensionRun) -> Section:
    """Model, notes, kinds of assets, inputs held fixed, engine, seed and versions."""
    blocks: list[Block] = [Text(run.model)] if run.model else []
    blocks += [*evidence.notes(run), *not_asked(run)]
    if run.kinds:
        rows = [(name.capitalize(), text) for name, text in run.kinds.items()]
        blocks.append(Table([("Kind", ""), ("Meaning", "")], rows, "Kinds of assets", 2))
    if run.held:
        names = ", ".join(name_of(name).lower() for name in run.held)
        blocks.append(Text(f"Held fixed, without a sensitivity: {names}.", caveat=True))
    blocks += [*evidence.times(run), evidence.made_with(run), _glossary()]
    return Section("assumptions", "Assumptions, versions and terms", "Assumptions", blocks)


def _glossary() -> Table:
    rows = [
        ("P, Q", "real-world and risk-neutral scenarios; shown next to all simulated numbers"),
        ("Funding ratio F", "assets divided by liability, both at the same instant"),
        ("Certainty equivalent", "the certain ratio with the same utility as the policy"),
        ("KR01, IE01", "change for +1 bp at one node of the nominal or break-even curve"),
        ("Hedge ratio", "rate sensitivity of assets and swaps, divided by that of the liability"),
        ("Headroom", "rise in rates until the swaps' losses use up the eligible assets"),
        ("CVaR 95 %", "the mean of the worst 5 % of paths"),
        (
            "±",
            "half of the 95 % interval of an estimate, simulation error only",
        ),
    ]
    return Table([("Term", ""), ("Meaning", "")], rows, "Terms", 2)
