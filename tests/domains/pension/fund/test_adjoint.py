"""The adjoint against central differences, for every input of a case with every feature."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.market_cases import full, given, no_contribution, plan

from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.policies.allocation import new_policy
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.plan import Liability
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.inputs import named_inputs, values
from snapo.problem.inputs import replace as with_values
from snapo.problem.problem import prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Smooth
from snapo.solver.adjoint import float64, pull_back

PATHS, STEPS = 8, 5
WEIGHT = {
    "funding_ratio": 1.0,
    "pv_contribution": 0.02,
    "pv_benefit": 0.01,
    "pv_cost": 0.05,
    "pv_indexation": 0.05,
    "pv_accrual": 0.03,
    "pv_expenses": 0.04,
    "shortfall_square": 1.0,
    "pv_shortfall": 0.01,
    "collateral_shortfall": 0.1,
}


def everything():
    """Cuts and partial indexation, a target rule with limits, and a spread on the curve."""
    base = full(STEPS)
    terms = plan(
        indexation="conditional",
        expenses=given("expenses", 0.3),
        contribution=replace(
            no_contribution(
                "target", loading=0.1, target_ratio=1.1, cap=0.9, floor=0.05, sponsor_limit=9.0
            ),
            has_floor=True,
            has_cap=True,
            has_sponsor_limit=True,
        ),
    )
    rule = replace(
        terms.indexation,
        cut_years=5,
        lower_ratio=given("indexation_lower_ratio", 0.8),
        required_ratio=given("indexation_required_ratio", 1.1),
    )
    assert base.overlay is not None
    return replace(
        base,
        plan=replace(terms, indexation=rule),
        liability=Liability("spread", given("liability_rate", 0.002), "none"),
        overlay=replace(base.overlay, leverage=given("overlay_leverage", 0.19)),
    )


def real():
    """Fully indexed rights on the real curve, spread contributions, everything in advance."""
    base = full(STEPS)
    terms = plan("advance", "capped", contribution=no_contribution("spread"))
    return replace(
        base,
        plan=terms,
        liability=Liability("risk-free", given("liability_rate", 0.0), "full"),
    )


CASES = [
    pytest.param(everything, id="everything"),
    pytest.param(real, id="real", marks=pytest.mark.study),
]


@pytest.fixture(scope="module", params=CASES)
def problem(request):
    one = request.param()
    simulator = PensionSimulator.of(one)
    inputs = pension_inputs(one)
    schedule = prepare(simulator, inputs)
    policy = new_policy(one, simulator, schedule, jax.random.key(0))
    return simulator, inputs, schedule, policy


@pytest.mark.prove
def test_every_input_agrees_with_central_differences(problem):
    simulator, inputs, schedule, policy = problem
    draws, smooth = Pseudo(1).draws(np.arange(PATHS), simulator), Smooth(jnp.asarray(0.5))
    weights = {name: np.full(PATHS, w / PATHS) for name, w in WEIGHT.items()}

    def swept(engine, schedule):
        return engine.adjoint(simulator, policy, schedule, draws, smooth, weights)

    engine, start = Xla("float64"), values(inputs)
    ours, native = (
        pull_back(simulator, inputs, [swept(each, schedule).schedule])
        for each in (engine, Native("float64"))
    )

    def value(i, place, bump):
        moved = [each.copy() for each in start]
        moved[i].ravel()[place] += bump
        made = prepare(simulator, with_values(inputs, moved))  # compiled already
        totals = float64(swept(engine, made).totals)
        return sum(w * totals[name].mean() for name, w in WEIGHT.items())

    dead, rng = [], np.random.default_rng(0)
    for i, entry in enumerate(named_inputs(inputs)):
        found = ours[entry.name][0].ravel()
        assert native[entry.name][0].ravel() == pytest.approx(found, rel=1e-8, abs=1e-12)
        # Of long rows (payments, correlations) a sample.
        size = entry.input.value.size
        for place in range(size) if size <= 4 else rng.choice(size, 4, replace=False):
            h = 1e-4 * max(abs(entry.input.value.ravel()[place]), 0.01)
            central = (value(i, place, h) - value(i, place, -h)) / (2 * h)
            # Values are of order one, and so is rounding: 1e-15 / h.
            assert found[place] == pytest.approx(central, rel=1e-6, abs=3e-14 / h), (
                entry.name,
                place,
            )
        if not np.any(found):
            dead.append(entry.name)
    # These rules and rights are not part of the case, or do not bind in it.
    unused = ("accrual_rate", "plan_", "normal_cost", "payroll", "contribution_", "indexation_")
    unused += ("overlay_leverage", "overlay_collateral_stress", "liability_rate", "expenses")
    unused += ("wage_volatility", "real_wage_growth")
    assert all(name.startswith(unused) for name in dead), dead
