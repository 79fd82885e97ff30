"""Is the model the market's? Risk-neutral tests on fresh paths, each with its error."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.inputs import plain
from snapo.problem.scenarios import EVALUATE, Pseudo, Scenarios, stream
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals
from snapo.study.study import StudyRun

from ..fund.simulator import PensionSimulator
from ..market.curve import log_bond
from ..market.state import log_factor
from ..people.cash_flows import reserved
from ..people.liability import nodes
from ..read.cells import empty
from ..records.case import PensionCase
from .setup import case_of

PATHS = 16384
ROUND_OFF = 1e-12  # of a value that does not vary over paths
SURE = 0.997  # that all tests together hold, where all is consistent
TENORS = (1, 10, 30)  # years: bonds that are priced at the horizon


class Priced(PensionSimulator):
    """The fund, with the discounted worth of bonds at the horizon: "bond 10".

    Per unit of their forward price; index-linked where the liability
    is valued as following prices.
    """

    def terminal(self, constants, state, smooth):
        market = state.market
        worth = log_factor(constants.market, constants.last_shape, market) + market.log_discount
        if _real(self.case):
            worth = worth + market.log_price
        years = np.rint(nodes(self.case.step) * self.case.step * 1e6) / 1e6
        bonds = {f"bond {u}": jnp.exp(worth[np.flatnonzero(years == u)[0]]) for u in TENORS}
        return super().terminal(constants, state, smooth) | bonds


def work(run: StudyRun) -> dict[str, Any]:
    """ "market_consistency": discounted values beside their expectations, with the trained
    policy.

    The scenarios are "Q" whatever the measure of the case, without the cost of hedging currencies,
    which nobody receives. Costs count where they are paid. None where scenarios are supplied;
    appraised values and bases with a spread are no prices.
    """
    case, setup = case_of(run), run.setup
    if case.scenarios is not None:
        return {"market_consistency": []}
    free = replace(case.currencies, hedge_cost=empty("hedge_cost", (len(case.currencies.names),)))
    simulator = Priced(replace(case, measure="Q", currencies=free))  # pyright: ignore
    source = Pseudo(setup.training.seed, stream=stream(EVALUATE, 3))
    problem, policy = replace(setup.problem, simulator=simulator), run.solution.policy
    assert policy is not None
    engine = setup.engines.evaluate
    totals = path_totals(problem, policy, PATHS, engine=engine, source=source)
    inputs, liability = plain(problem.inputs), run.get("liability")
    tests = _tests(case, inputs, totals, liability)
    return {
        "market_consistency": [
            _tested(name, values, expected, source, len(tests)) for name, values, expected in tests
        ]
    }


def _tests(case: PensionCase, inputs: dict[str, Any], totals, liability: float) -> list[tuple]:
    """(name, values [paths], their expectation) of each test."""
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
            name = f"Refit of the curve: {kind.lower()} of {u}y bought after {years:g}y"
            tests.append((name, values, then))
    if not case.assets.smoothed.size:
        paid = totals["pv_benefit"] + totals["pv_expenses"] + totals["pv_cost"]
        left = totals["pv_assets"] + paid - totals["pv_contribution"]
        tests.append(("Assets: remainder and payments", left, float(case.assets.amount.used())))
    plain_basis = case.liability.basis == "risk-free" and not _real(case)
    if plain_basis and case.lee_carter is None:
        added = totals["pv_indexation"] + totals["pv_accrual"]
        paid = float(reserved(case, inputs)) * totals["pv_benefit"]
        left = totals["pv_liability"] + paid - added
        tests.append(("Liability: remainder and payments", left, liability))
    return tests


def _real(case: PensionCase) -> bool:
    return case.liability.future_indexation == "full"


def _price(case: PensionCase, given: dict[str, Any], years: float, real: bool) -> float:
    """P(0, years) on today's curve, nominal or index-linked."""
    with jax.enable_x64(True):
        when = np.array([years])
        found = float(log_bond(case.curve, given, when)[0])
        prices = float(log_bond(case.inflation.break_even, given, when)[0]) if real else 0.0
    return float(np.exp(found - prices))


def _tested(
    name: str, values: np.ndarray, expected: float, source: Scenarios, tests: int
) -> dict[str, Any]:
    """One line: the mean over independent groups of paths against its expectation."""
    found = statistics.mean(values, source.groups(np.arange(values.size)))
    low, high = found.interval(SURE, tests)
    none = ROUND_OFF * abs(expected)
    row = {"name": name, "own": found.value, "expected": expected}
    row["standard_error"] = found.standard_error
    return row | {"ok": bool(low - none <= expected <= high + none)}
