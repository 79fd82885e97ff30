"""Park and loan: a linear program, a gas store, the mirrored contract, unit-days of the fees."""

import datetime
from typing import Any

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import linprog
from tests.domains.energy.energy_cases import HOME, case_at, exact
from tests.domains.gas_storage.storage_cases import CASES, bare, read, tables_of

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.case.table import TableContext, parse
from snapo.domains.energy.chapters.ladder import FlatVolumes, no_flat_volumes
from snapo.domains.energy.contracts.park_and_loan import ParkAndLoanTable, read_park_and_loan
from snapo.domains.energy.core.simulator import simulator_of
from snapo.domains.energy.methods.grid import grid_of
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.read.case import EnergyCase, read_case
from snapo.domains.energy.setup import bare_problem, factors_of, make_setup
from snapo.domains.energy.summary import lines
from snapo.domains.gas_storage.bounds.basis import gaussian_basis
from snapo.domains.gas_storage.ladder.forwards import PathCurves, drawn_states
from snapo.domains.gas_storage.ladder.methods import fitted_rule, followed
from snapo.domains.gas_storage.ladder.products import usual_products
from snapo.domains.gas_storage.ladder.rolling import Chains, TradeBlock, intrinsic_in, rolling
from snapo.domains.gas_storage.ladder.store import FlatStore
from snapo.domains.gas_storage.references.lattice import lattice as store_lattice
from snapo.engine import TRAJECTORY
from snapo.engine.native import Native
from snapo.problem.smooth import Exact
from snapo.solver.bound import bound
from snapo.solver.evaluate import evaluate
from snapo.solver.sensitivity import sensitivities
from snapo.testing.derivatives import wrong_derivatives

FOLDER = HOME / "template_park_and_loan"
DAY = datetime.date
DAYS = [DAY(2026, 7, 1) + datetime.timedelta(n) for n in range(184)]
SHORT = {"start": DAY(2026, 9, 11), "end": DAY(2026, 10, 21), "max_park": 200.0, "max_loan": 150.0}


def contract(**changes: Any) -> EnergyCase:
    """The template, keys of `[contract]` changed."""
    return case_at(FOLDER, {f"contract.{name}": value for name, value in changes.items()})


def short(**changes: Any) -> EnergyCase:
    """40 days of it around the first of October, where prices rise from 30 to 31.5."""
    return contract(**SHORT | changes)


def best_plan(case: EnergyCase) -> float:
    """A linear program of the volumes that open and close parks and loans, at forward prices."""
    terms, price, count = case.contract, case.market.forward_curve.used(), len(case.days)
    discount = np.exp(-0.03 * case.day / 365)
    (park, loan), (deliver, take), (park_fee, loan_fee) = (
        [np.broadcast_to(x.used(), count) for x in pair]
        for pair in (terms.limits, terms.rates, terms.fees)
    )
    initial, completion = (float(x.used()) for x in terms.turn)
    # Per day: units parked, taken back, on loan, repaid.
    gains = [-price - initial, price - completion, price - initial, -price - completion]
    below, start = np.tri(count), float(terms.balance.values[0])
    after = [np.cumsum((discount * fee)[::-1])[::-1] for fee in (park_fee, loan_fee)]
    left = [
        x and float(x.used()) * np.exp(-0.03 * (case.day[-1] + 1) / 365) for x in terms.cash_out
    ]
    worth = [left[0] or 0.0, -(left[1] or 0.0)]
    gain = np.concatenate(
        [discount * g + sign * (worth[k] - after[k])
         for g, k, sign in zip(gains, (0, 0, 1, 1), (1, -1, 1, -1))]
    )  # fmt: skip
    first = max(start, 0.0), max(-start, 0.0)
    constant = sum(first[k] * (worth[k] - after[k][0]) for k in (0, 1))
    zero = np.zeros_like(below)
    parked, on_loan = np.hstack([below, -below, zero, zero]), np.hstack([zero, zero, below, -below])
    limits = [park.copy(), loan.copy()]
    for k in (0, 1):
        if left[k] is None:
            limits[k][-1] = 0.0
    rows = [parked, -parked, on_loan, -on_loan]
    values = [
        limits[0] - first[0],
        np.full(count, first[0]),
        limits[1] - first[1],
        np.full(count, first[1]),
    ]
    one = np.eye(count)
    rows += [np.hstack([one, 0 * one, 0 * one, one]), np.hstack([0 * one, one, one, 0 * one])]
    values += [deliver * terms.open[:, 0], take * terms.open[:, 1]]
    result = linprog(-gain, np.concatenate(rows), np.concatenate(values), bounds=(0, None))
    assert result.status == 0
    return constant - result.fun


@pytest.mark.prove
def test_two_days_are_an_integral():
    """Opened on the first day and closed on the second, where the expected spread is above the
    fees: S = F exp(v x - v^2 var(x) / 2), x an Ornstein-Uhlenbeck factor of speed 12, v = 0.9."""
    fees = {"initial_fee": 0.03, "completion_fee": 0.01, "park_fee": 0.004, "loan_fee": 0.03}
    days = {"start": DAY(2026, 9, 11), "end": DAY(2026, 9, 13), "max_park": 40.0, "max_loan": 30.0}
    case = contract(**days, **fees)
    forward, times = case.market.forward_curve.used(), case.day / 365
    assert forward.tolist() == [30.0, 30.0]
    discount, decay = np.exp(-0.03 * times), np.exp(-12.0 / 365)
    variance = (1 - np.exp(-24.0 * times[0])) / 24.0

    def gain(x: float) -> float:
        now, later = (
            f * np.exp(0.9 * k * x - 0.5 * (0.9 * k) ** 2 * variance)
            for f, k in zip(forward, (1.0, decay))
        )
        spread = discount[1] * later - discount[0] * now
        paid = [discount @ (0.03 + fees[name], 0.01) for name in ("park_fee", "loan_fee")]
        worth = 40.0 * max(spread - paid[0], 0.0) + 30.0 * max(-spread - paid[1], 0.0)
        return worth * np.exp(-x * x / 2 / variance) / np.sqrt(2 * np.pi * variance)

    value = quad(gain, -1.6, 1.6, limit=400)[0]
    assert value > 1.0
    assert exact(case, finer=8) == pytest.approx(value, rel=1e-4)


FREE = dict.fromkeys(("park_fee", "loan_fee", "initial_fee", "completion_fee"), 0.0)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"max_park": 0.0},
        FREE,
        {"balance": -70.0, "loan_fee": 0.03, "completion_fee": 0.05},
        {"cash_out_park": 28.0, "cash_out_loan": 31.4, "balance": 37.5},
        {"deliver_window": {"first": DAY(2026, 9, 1), "last": DAY(2026, 9, 20)},
         "take_window": {"first": DAY(2026, 10, 10), "last": DAY(2026, 12, 1)}},
        {"max_deliver": 50 / 3, "max_take": 50 / 3, "max_loan": 101.3},
    ],
)  # fmt: skip
def test_without_volatility_a_linear_program(changes):
    """Volumes that open and close are its own, with a park and a loan at once allowed."""
    case = short(**changes)
    assert grid_of(case.contract.layout, bare_problem(case).schedule).exact
    assert exact(case, forward=True) == pytest.approx(best_plan(case), rel=1e-6)


def quick(**changes: Any) -> EnergyCase:
    """The small gas store of the tests as a park: its balance is the gas in store."""
    file, data = tables_of(CASES / "quick")
    keys = {"start", "end"}
    table = {key: value for key, value in data["contract"].items() if key in keys} | {
        "max_park": 50.0, "max_deliver": 5.0, "max_take": 10.0, "balance": 10.0,
        "initial_fee": 0.08, "completion_fee": 0.03,
    }  # fmt: skip
    return read_case(file, data | {"kind": "park-and-loan", "contract": table | changes})


def store():
    """The same as a store, with the fees as costs of injection and withdrawal."""
    return read("quick", contract={"injection_cost": 0.08, "withdrawal_cost": 0.03})


@pytest.mark.prove
def test_a_park_is_a_gas_store():
    """On the same nodes of the price: the lattice of a store, which shares no code with this one."""
    simulator, _, schedule = bare(store())
    factors = factors_of(bare_problem(quick()))
    values = (
        store_lattice(schedule, factors, "linear", step=5.0, spacing=0.3).value,
        exact(quick(), finer=1),
    )
    assert simulator.horizon == len(quick().days)
    assert values[1] == pytest.approx(values[0], rel=1e-6)


@pytest.mark.prove
def test_methods_of_a_desk_are_those_of_the_store():
    """Intrinsic in products, rolling intrinsic and least squares, path by path."""
    case, schedule = quick(), bare(store())[2]
    problem = bare_problem(case)
    forward, factors = problem.schedule.steps.forward, factors_of(problem)
    curve = np.append(forward, forward[-1:])
    products = usual_products(case.days, case.valuation_date)
    curves = PathCurves(factors, curve, drawn_states(factors, 200, 1))
    basis = gaussian_basis(factors, priced=False)
    results = []
    for flat in (
        FlatVolumes(simulator_of(problem).layout, problem.schedule),
        FlatStore(schedule, "linear"),
    ):
        rule = fitted_rule(flat, basis, curves.states, curves.spots)
        money = (
            np.array(intrinsic_in(flat, products.blocks(0), curve)),
            rolling(Chains(flat), products.blocks, curves, 200).money,
            followed(rule, curves.states, curves.spots).money,
        )
        results.append(money)
    for ours, theirs in zip(*results):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-7)


def mirrored(folder, sign: float, **changes: Any) -> EnergyCase:
    """Normal prices around 40 days of the curve, or around the same with the opposite sign."""
    folder.mkdir()
    rows = ["date,price"] + [f"2026-{m:02d},{sign * price}" for m, price in ((9, 30.0), (10, 31.5))]
    (folder / "curve.csv").write_text("\n".join(rows))
    (folder / "case.toml").write_text((FOLDER / "case.toml").read_text())
    model = {"model.kind": "one-factor-normal", "model.volatility": 30.0}
    return case_at(folder, model | {f"contract.{x}": y for x, y in (SHORT | changes).items()})


@pytest.mark.prove
def test_loans_are_parks_at_the_opposite_prices(tmp_path):
    """The mirror: limits, rates and fees of both sides exchanged, -F for F; normal prices are
    symmetric."""
    loans = {"max_park": 120.0, "max_loan": 200.0, "max_deliver": 25.0, "loan_fee": 0.01}
    parks = {
        "max_park": 200.0,
        "max_loan": 120.0,
        "max_take": 25.0,
        "park_fee": 0.01,
        "loan_fee": 0.004,
    }
    values = [
        exact(mirrored(tmp_path / "a", 1.0, **loans), finer=1),
        exact(mirrored(tmp_path / "b", -1.0, **parks), finer=1),
    ]
    assert values[0] > 100.0
    assert values[1] == pytest.approx(values[0], rel=1e-9)


@pytest.mark.prove
@pytest.mark.parametrize("changes", [{}, {"park_fee": 0.05, "loan_fee": 0.08, "initial_fee": 0.2}])
def test_policy_and_bound_enclose_the_exact_value(changes):
    """The fitted rule at most 0.3 % below, the bound at most 0.8 % above; and the derivatives."""
    case = short(**changes)
    setup, value = make_setup(case, Native()), exact(case)
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    result = evaluate(problem, rule, paths=16384, engine=engine)
    assert result.standard_error < 1e-3 * value
    assert value * 0.997 <= result.value + 3 * result.standard_error
    assert result.value <= value + 3 * result.standard_error
    relaxation = EnergyRelaxation(problem)
    upper = bound(problem, rule, relaxation=relaxation, engine=engine, paths=1024).upper
    assert value <= upper.value + 3 * upper.standard_error
    assert upper.value - 3 * upper.standard_error <= value * 1.008
    assert wrong_derivatives(problem, rule, paths=16, engine=engine) == []


@pytest.mark.prove
def test_derivatives_by_the_fees_are_unit_days():
    """Minus the discounted units at the end of each day, opened and closed, on the same paths; by
    the park fee within two errors of the lattice's central difference."""
    case = short()
    setup = make_setup(case, Native())
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    paths, discount = 8192, np.exp(-0.03 * case.day / 365)
    draws = problem.sources.evaluation.draws(np.arange(paths), problem.simulator)
    rollout = engine.bind(problem).values(rule, draws, Exact(), record=TRAJECTORY)
    states = rollout.record["state"].levels[:, :, 0]
    levels = np.concatenate([states, np.asarray(rollout.state.levels)[None, :, 0]])
    parked, on_loan = np.maximum(levels, 0.0), np.maximum(-levels, 0.0)
    rises = [np.diff(x, axis=0) for x in (parked, on_loan)]
    units = {
        "park_fee": parked[1:],
        "loan_fee": on_loan[1:],
        "initial_fee": sum(np.maximum(x, 0.0) for x in rises),
        "completion_fee": sum(np.maximum(-x, 0.0) for x in rises),
    }
    table = sensitivities(problem, rule, paths=paths, engine=engine)
    along = {name: -discount @ volume for name, volume in units.items()}
    for name, result in along.items():
        assert float(np.sum(table.held[name].value)) == pytest.approx(result.mean(), rel=1e-5)
    up, down = (exact(short(park_fee=0.004 + x)) for x in (1e-3, -1e-3))
    error = along["park_fee"].std(ddof=1) / np.sqrt(paths)
    assert abs((up - down) / 2e-3 - along["park_fee"].mean()) < 2 * error


def test_what_is_left_is_cashed_out():
    """A loan on which nothing may flow, and is repaid in money."""
    case = short(balance=-40.0, max_take=0.0, max_deliver=0.0, cash_out_loan=45.0)
    days = np.exp(-0.03 * np.append(case.day, case.day[-1] + 1) / 365)
    value = -40.0 * (0.006 * days[:-1].sum() + 45.0 * days[-1])
    assert exact(case, forward=True) == pytest.approx(value, rel=1e-12)
    with pytest.raises(CaseError, match=r"contract: balance: no decisions can meet"):
        lines(short(balance=-40.0, max_deliver=0.5))


def test_the_balance_ends_at_zero_whatever_is_decided():
    layout = contract().contract.layout
    schedule = bare_problem(short()).schedule
    low, high = schedule.steps.intervals.next_low, schedule.steps.intervals.next_high
    assert low[-1, 0] == high[-1, 0] == 0.0 and low.min() == -150.0 and high.max() == 200.0
    assert not no_flat_volumes(layout)
    days = tuple(TradeBlock(t, t + 1) for t in range(len(low)))
    flat = FlatVolumes(layout, schedule)
    curve = np.append(schedule.steps.forward, 0.0)
    assert intrinsic_in(flat, days, curve) == pytest.approx(exact(short(), forward=True), rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"max_park": 0.0, "max_loan": 0.0}, "max_park: .*more than 0"),
        ({"balance": 1500.0}, "balance: .*-500 to 1000"),
        ({"cash_out_park": 30.0, "cash_out_loan": 20.0}, "cash_out_park: .*at most cash_out_loan, 20"),
        ({"take_window": {"first": DAY(2026, 9, 1), "last": DAY(2026, 8, 1)}}, "take_window.last"),
        ({"deliver_window": {"first": DAY(2027, 9, 1), "last": DAY(2027, 9, 2)}}, "deliver_window.first"),
        ({"loan_fee": -0.1}, "loan_fee"),
    ],
)  # fmt: skip
def test_mistakes_are_named(changes, where):
    with pytest.raises(CaseError, match=where):
        contract(**changes)


@hypothesis.settings(max_examples=60, deadline=None)
@hypothesis.given(
    st.sampled_from(["max_park", "max_loan", "max_deliver", "max_take", "park_fee", "loan_fee",
                     "initial_fee", "completion_fee", "cash_out_loan"]),
    st.one_of(st.floats(max_value=-1e-9), st.just(float("nan")), st.text(max_size=3), st.booleans(),
              st.lists(st.integers(), max_size=2)),
)  # fmt: skip
def test_a_number_that_cannot_be_is_refused_by_its_key(key, value):
    file, data = load(FOLDER)
    with pytest.raises(CaseError, match=f"contract.{key}"):
        table = parse(ParkAndLoanTable, data["contract"] | {key: value}, str(file), "contract")
        read_park_and_loan(TableContext(file, "contract", []), table, DAYS)


@pytest.mark.prove
@hypothesis.settings(max_examples=20, deadline=None)
@hypothesis.given(
    st.integers(0, 6), st.integers(0, 6), st.integers(1, 4), st.integers(1, 4), st.integers(0, 5)
)
def test_fees_lower_the_value_and_limits_raise_it(park, loan, deliver, take, fee):
    numbers = {"max_park": 10.0 * park + 1, "max_loan": 10.0 * loan, "max_deliver": 3.0 * deliver,
               "max_take": 3.0 * take}  # fmt: skip
    value = exact(short(**numbers), forward=True)
    dear = {"park_fee": 0.004 + fee / 100, "loan_fee": 0.006 + fee / 100}
    assert -1e-9 <= exact(short(**numbers | dear), forward=True) <= value + 1e-9
    wide = numbers | {"max_loan": 10.0 * loan + 7, "max_take": 20.0}
    assert exact(short(**wide), forward=True) >= value - 1e-9
