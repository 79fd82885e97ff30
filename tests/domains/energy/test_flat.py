"""Swing contracts with flat volumes over products: intrinsic, rolling, least squares, against D3."""

import datetime
import json
from types import SimpleNamespace

import numpy as np
import pytest
from tests.domains.energy.energy_cases import HOME, battery, exact, swing

from snapo.case.error import CaseError
from snapo.domains.energy.chapters.ladder import METHODS, FlatVolumes, measure, no_flat_volumes
from snapo.domains.energy.core.simulator import simulator_of
from snapo.domains.energy.setup import bare_problem, factors_of
from snapo.domains.energy.study import study
from snapo.domains.gas_storage.bounds.basis import gaussian_basis
from snapo.domains.gas_storage.ladder.forwards import PathCurves, drawn_states
from snapo.domains.gas_storage.ladder.methods import fitted_rule, followed
from snapo.domains.gas_storage.ladder.products import usual_products
from snapo.domains.gas_storage.ladder.rolling import (
    Chains,
    Infeasible,
    TradeBlock,
    intrinsic_in,
    rolling,
)
from snapo.study import commands
from snapo.study.chapters.ladder import IN_PRODUCTS, ROLLING
from snapo.study.domain import CaseRequest, Options
from snapo.study.study import StudyRun

SHORT = {"end": swing().days[0].replace(month=12)}  # two months


def flat(case):
    """The contract, its curve with a price of the end, its factors and what trades."""
    problem = bare_problem(case)
    contract = FlatVolumes(simulator_of(problem).layout, problem.schedule)
    forward = problem.schedule.steps.forward
    products = usual_products(case.days, case.valuation_date)
    return contract, np.append(forward, forward[-1:]), factors_of(problem), products


@pytest.mark.prove
@pytest.mark.parametrize(
    "changes",
    [{}, {"annual": None}, {"shortfall": "strike"}, {"side": "put"}, {"min_daily": 0.2},
     {"shortfall": "firm", "annual": {"min": 250.0, "max": 250.0}}],
)  # fmt: skip
def test_days_as_products_are_no_restriction(changes):
    """The plan by day is the lattice at forward prices."""
    case = swing(**changes)
    contract, curve, _, _ = flat(case)
    days = tuple(TradeBlock(t, t + 1) for t in range(contract.horizon))
    assert intrinsic_in(contract, days, curve) == pytest.approx(exact(case, True), rel=1e-6)


@pytest.mark.prove
def test_least_squares_of_two_months():
    """At most half a percent below the exact value, out of sample."""
    case = swing(**SHORT, annual={"min": 20.0, "max": 40.0})
    contract, curve, factors, _ = flat(case)
    curves = [PathCurves(factors, curve, drawn_states(factors, n, n)) for n in (1000, 4000)]
    basis = gaussian_basis(factors, priced=False)
    rule = fitted_rule(contract, basis, curves[0].states, curves[0].spots)
    money = followed(rule, curves[1].states, curves[1].spots).money.reshape(2, -1).mean(axis=0)
    error, value = money.std() / np.sqrt(len(money)), exact(case)
    assert value * 0.995 - 3 * error < money.mean() < value + 3 * error


def test_rolling_intrinsic_is_between_the_plan_and_the_exact_value():
    """Without a spread; on each path at least the plan of today, as far as nodes resolve it."""
    case = swing(**SHORT, annual={"min": 20.0, "max": 40.0})
    contract, curve, factors, products = flat(case)
    curves = PathCurves(factors, curve, drawn_states(factors, 300, 1))
    money = rolling(Chains(contract), products.blocks, curves, 300).money
    plan = intrinsic_in(contract, products.blocks(0), curve)
    pairs = money.reshape(2, -1).mean(axis=0)
    error = pairs.std() / np.sqrt(len(pairs))
    assert plan + 3 * error < money.mean() < exact(case) + 3 * error
    assert money.min() > plan * (1 - 2.5e-3)


def test_a_product_across_the_end_of_a_year_has_a_reason():
    case = swing(year_begins="11-15", shortfall=6.0)
    contract, _, _, products = flat(case)
    with pytest.raises(Infeasible, match="beyond the end of a contract year"):
        Chains(contract).of(products.blocks(0))


def test_contracts_of_several_levels_or_moves_have_a_reason():
    assert "one flow" in no_flat_volumes(battery().contract.layout)
    assert "one flow" in no_flat_volumes(swing(rights={"most": 10, "rest": 2}).contract.layout)
    assert not no_flat_volumes(swing().contract.layout)


def test_an_hourly_contract_has_no_products():
    from tests.domains.energy.energy_cases import case_at

    with pytest.raises(CaseError, match="a contract by the hour has none"):
        case_at(HOME / "template_battery", {"products.months": {}})


SMALL = ("training.steps=2", "training.paths=32", "evaluation.paths=256",
         "evaluation.sensitivity_paths=64", "evaluation.judge_paths=0")  # fmt: skip


def run_with_all_methods(kind, folder, *assignments):
    """Solves a small case of this kind with a ladder, all of which is there: its folder, and rows
    of deltas by product."""
    case, out = folder / "case", folder / "out"
    commands.new(kind, case)
    text = (case / "case.toml").read_text()
    (case / "case.toml").write_text(f"{text}\n[products]\nmonths = {{ bid_offer = 0.1 }}\n")
    request = CaseRequest(case, (*assignments, *SMALL))
    commands.solve(request, lambda _: None, out=out, ladder=True)
    methods = json.loads((out / "parts" / "methods.json").read_text())["methods"]
    assert len(methods["methods"]) == 8 and not methods["missing"] and not methods["warnings"]
    part = json.loads((out / "parts" / "deltas-by-product.json").read_text())
    return out, part["deltas_by_product"]


@pytest.mark.prove
def test_a_run_of_a_swing_has_all_methods(tmp_path):
    keys = "contract.end=2026-12-01", "contract.annual={ min = 20.0, max = 40.0 }"
    out, rows = run_with_all_methods("swing", tmp_path, *keys)
    assert [row["product"] for row in rows] == ["day ahead", "no product yet", "2026-11"]
    assert all(row["undiscounted"] >= row["discounted"] >= 0 for row in rows)
    assert 20 < sum(row["undiscounted"] for row in rows) < 40  # the volume that is taken
    assert "Methods side by side" in (out / "report.html").read_text()


@pytest.mark.study
def test_a_run_of_a_park_and_loan_has_all_methods(tmp_path):
    _, rows = run_with_all_methods("park-and-loan", tmp_path, "contract.end=2026-09-01")
    assert rows[0]["product"] == "day ahead"


@pytest.mark.prove
def test_methods_that_trade_products_leave_contracts_of_hours_alone(tmp_path):
    """Hours of a day are no products of days: rolling intrinsic showed 289.5 where the exact value
    of a day of the template was 200.69."""
    case = battery(end=datetime.datetime(2026, 5, 4, 12), energy=2.0, cycles=None)
    whole = study(case, Options("native", ladder=True))
    assert METHODS.part.name in {part.name for part in whole.parts}
    run = StudyRun(whole, tmp_path, lambda _: None)
    run.trained = SimpleNamespace(policy=run.setup.policy)  # pyright: ignore
    methods = measure(run)
    assert len(methods.methods) == 6 and not methods.warnings
    assert [x.method for x in methods.missing] == [IN_PRODUCTS, ROLLING]
    assert all("the steps are hours" in x.reason for x in methods.missing)
