"""`snapo explain`: parts of a change of value against closed forms and the exact lattice."""

import csv
import datetime
import json
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm
from tests.domains.gas_storage.explain.valued import valued
from tests.domains.gas_storage.storage_cases import CASES, read, tables_of, untrained

from snapo.case.error import CaseError
from snapo.domains.gas_storage.chapters.vega import by_date
from snapo.domains.gas_storage.contract.simulator import StorageSimulator
from snapo.domains.gas_storage.explain import CASH, FIRST, POLICY, REST, SECOND, command, runs
from snapo.domains.gas_storage.explain import parts as store_parts
from snapo.domains.gas_storage.explain.chain import delivery_periods
from snapo.domains.gas_storage.explain.change import (
    ChangePart,
    CurveMove,
    ExplainedChange,
    decimals_of,
)
from snapo.domains.gas_storage.explain.flows import DayFlow, TakenFlow, passed_days, read_flows
from snapo.domains.gas_storage.explain.parts import explained_change
from snapo.domains.gas_storage.explain.runs import ValuedRun, check_pair, later_paths, on_date_of
from snapo.domains.gas_storage.read.case import read_case
from snapo.domains.gas_storage.references.lattice import refined
from snapo.domains.gas_storage.setup import bare_problem, factors
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo, Sobol
from snapo.solver.sensitivity import sensitivities

VALUATION = datetime.date(2019, 8, 29)
EXERCISE = {"2019-12-15": (1200.0, "2020-01-20"), "2020-01-20": (800.0, "2020-02-18"),
            "2020-03-31": (900.0, "2020-04-22")}  # fmt: skip


def silent(text: str) -> None:
    pass


def error_of(row: ChangePart) -> float:
    assert row.standard_error is not None
    return row.standard_error


class BlackTerms(NamedTuple):
    """Delta times move, half of gamma times its square, and the derivative by the volatility."""

    first: float
    second: float
    vega: float


def black(day: str, volume: float, paid: str, up: float) -> BlackTerms:
    """The terms of one of the calls of G4."""
    date = datetime.date.fromisoformat(day)
    i = (date - VALUATION).days
    forward = 53.5 + 24.6 * np.sin(2 * np.pi * i / 365)
    strike = forward + {"2020-01-20": 2.0, "2020-03-31": 2.8}.get(day, 0.0)
    sigma = 0.78 + 0.35 * np.sin(2 * np.pi * i / 365)
    deviation = sigma * np.sqrt(-np.expm1(-2 * 16.5 * i / 365) / (2 * 16.5))
    d1 = np.log(forward / strike) / deviation + deviation / 2
    later = (datetime.date.fromisoformat(paid) - VALUATION).days
    size, move = volume * np.exp(-0.09 * later / 365), up * forward
    gamma = norm.pdf(d1) / (forward * deviation)
    vega = size * forward * norm.pdf(d1) * deviation / sigma
    return BlackTerms(size * norm.cdf(d1) * move, size * gamma * move**2 / 2, vega)


def vega_of(setup) -> dict[str, tuple[float, float]]:
    """By month, with the standard error."""
    case, problem, engine = setup.case, setup.problem, setup.engines.evaluate
    wide = by_date(problem, ["volatility"], len(case.days) + 1)
    paths = setup.evaluation.sensitivity_paths
    held = sensitivities(wide, setup.policy, paths=paths, engine=engine).held["volatility"]
    months = np.array([f"{day:%Y-%m}" for day in (*case.days, case.end)])
    return {str(month): held.along(months == month) for month in np.unique(months)}


@pytest.mark.prove
def test_calls_one_percent_up(tmp_path):
    """G4: the terms of first and second order are Black's, and the rest is less than 1 %."""
    settings = {"evaluation": {"paths": 8192, "sensitivity_paths": 8192}}
    first, setup = valued(tmp_path / "a", "G4", tables=settings)
    second, _ = valued(tmp_path / "b", "G4", setup, setup.policy, 1.01, settings)
    change = explained_change(first, second, silent)
    rows = {(row.part, row.period): row for row in change.parts}
    vegas = vega_of(setup)
    for day, call in EXERCISE.items():
        exact_terms = black(day, *call, 0.01)
        vega, error = vegas[day[:7]]
        print(day, "vega", vega, error, exact_terms.vega)
        assert abs(vega - exact_terms.vega) < 2 * error < 0.03 * exact_terms.vega
        month = f"{datetime.date.fromisoformat(day):%b}\u00a0{day[:4]}"
        for part, exact in zip((FIRST, SECOND), exact_terms):
            row = rows[part, month]
            print(day, part, row.amount, row.standard_error, exact)
            assert abs(row.amount - exact) < 2 * error_of(row)
            assert error_of(row) < 0.1 * exact
    assert rows[FIRST, "Feb\u00a02020"].amount == vegas["2020-02"][0] == 0
    rest = rows[REST, ""]
    assert abs(rest.amount) < 0.01 * abs(change.change)
    assert error_of(rest) < 0.005 * abs(change.change)
    assert_allclose(sum(row.amount for row in change.parts), change.change, atol=1e-9)


FIRST_DAY = datetime.date(2025, 1, 1)


def exact_value(problem: Problem) -> float:
    prices = factors(problem)
    assert prices is not None
    return refined(jax.tree.map(np.asarray, problem.schedule), prices, "linear").value


@pytest.mark.prove
def test_a_day_later(tmp_path):
    """Every part against the difference of two values by the lattice, one cause after another."""
    first, setup = valued(tmp_path / "a", "quick")
    plan = passed_days(first.case, setup.problem, setup.policy, 1, 0.0, 1)  # pyright: ignore
    inventory = plan.planned_inventory - 2.0
    changed = {
        "contract": {"inventory": inventory, "injection_cost": 0.08},
        "market": {"valuation_date": datetime.date(2025, 1, 2), "interest_rate": 0.05},
        "model": {"volatility": 1.0},
    }
    second, _ = valued(tmp_path / "b", "quick", None, setup.policy, 1.02, changed)
    day = plan.flows[0]
    flows = {FIRST_DAY: TakenFlow(day.planned - 2.0, day.price + 0.5)}
    change = explained_change(first, second, silent, flows)
    rows = {row.part: row for row in change.totals}
    other = second.case
    planned = on_date_of(first, second, plan.planned_inventory)
    start = on_date_of(first, second, inventory)
    market = replace(start.market, forward_curve=other.market.forward_curve)
    tables = [first.case, planned, start]
    tables.append(replace(start, market=market, model=other.model))  # curve and volatility
    market = replace(market, zero_rate=other.market.zero_rate)
    tables += [replace(tables[-1], market=market), other]
    values = [exact_value(bare_problem(case)) for case in tables]
    flow = change.flows[0]
    assert flow.taken == pytest.approx(flow.planned - 2.0)
    found = [
        (rows["time"], values[1] - values[0] + flow.planned_cash),
        (rows["decisions taken"], values[2] - values[1] + flow.forward_cash - flow.planned_cash),
        (rows["interest rate"], values[4] - values[3]),
        (rows["contract"], values[5] - values[4]),
    ]
    for row, exact in found:
        print(row.part, row.amount, row.standard_error, exact)
        assert abs(row.amount - exact) < 3 * error_of(row) + 2e-4 * values[0]
    curve = sum(rows[name].amount for name in ("curve", "curve, second order", "volatility"))
    print(curve, values[3] - values[2], rows["rest"])
    assert rows["policy"].amount == 0
    assert rows["spot prices"].amount == pytest.approx(-0.5 * flow.taken)
    numbers = first.case, setup.problem, setup.policy, 1, inventory, 1
    with pytest.raises(CaseError, match="in store, but the second run has"):
        passed_days(*numbers, {FIRST_DAY: TakenFlow(day.planned, day.price)})  # pyright: ignore
    with pytest.raises(CaseError, match="this day lies between the two valuation dates"):
        passed_days(*numbers, {})  # pyright: ignore
    assert_allclose(sum(row.amount for row in change.parts), change.change, atol=1e-9)
    assert_allclose(change.profit, change.change + change.cash, atol=1e-9)


@pytest.mark.prove
@pytest.mark.parametrize("elapsed", [0, 10])
def test_cash_of_forced_flows(elapsed):
    """G5: -156,115.5176 whatever the policy, on the valuation date or ten days later."""
    case = read("G5")
    problem = bare_problem(case)
    policy = untrained(problem.simulator, problem.schedule)  # pyright: ignore
    passed = passed_days(case, problem, policy, len(case.days), 0.0, elapsed)
    assert_allclose(passed.planned_cash, -156_115.5176 * np.exp(0.09 * elapsed / 365), rtol=1e-9)
    left = passed.planned_inventory
    assert left == pytest.approx(5000.0 + 20 * 211.5 - 15 * 187.54)
    exact = [flow.taken - flow.planned for flow in passed.flows]
    assert_allclose(exact, -left / len(case.days))


def test_later_paths_have_the_noise_of_the_same_days():
    first = read("quick")
    later = read("quick", market={"valuation_date": datetime.date(2025, 1, 4)})
    one, other = (StorageSimulator.of(case) for case in (first, later))
    source = later_paths(Pseudo(5), one, other, 3)
    assert source is not None and source.groups(np.arange(4)).tolist() == [0, 0, 1, 1]
    before, after = Pseudo(5).draws(np.arange(4), one), source.draws(np.arange(4), other)
    assert int(after.first) == int(before.first) + 3
    assert np.array_equal(before.keys, after.keys)
    assert later_paths(Sobol(5), one, other, 3) is None


def test_before_the_start_the_later_paths_begin_on_the_same_day():
    """G4: decisions from December on; the noise of its first day stays that of this day."""
    one = StorageSimulator.of(read("G4"))
    later = read("G4", market={"valuation_date": datetime.date(2019, 9, 1)})
    other = StorageSimulator.of(later)
    source = later_paths(Pseudo(5), one, other, 0)
    assert source is not None
    draws = source.draws(np.arange(2), other)
    assert int(draws.first) == one.first_step == other.first_step + 3
    assert draws.before == other.initial_steps


def run_of(name: str, **tables) -> ValuedRun:
    file, data = tables_of(CASES / name, **tables)
    return ValuedRun(file.parent, file, data, read_case(file, data), "auto", 1.0, 0.1, None)


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        (
            {"market": {"valuation_date": datetime.date(2025, 1, 4)}},
            {},
            "name the earlier run first",
        ),
        ({}, {"contract": {"end": datetime.date(2025, 1, 29)}}, "do not end with those"),
    ],
)
def test_a_run_that_cannot_follow(first, second, words):
    with pytest.raises(CaseError, match=words):
        check_pair(run_of("quick", **first), run_of("quick", **second))


def test_a_run_of_another_kind(tmp_path, monkeypatch):
    monkeypatch.setattr(runs.run_folder, "read", lambda folder: {"kind": "pension"})
    with pytest.raises(
        CaseError, match='explained: "battery", "gas-storage", "park-and-loan", "pl'
    ):
        ValuedRun.read(tmp_path)


def test_a_run_without_a_value(tmp_path, monkeypatch):
    record = {"kind": "gas-storage", "parts": {}, "decides": {}}
    monkeypatch.setattr(runs.run_folder, "read", lambda folder: record)
    with pytest.raises(CaseError, match="has no value with a standard error: solve its case again"):
        ValuedRun.read(tmp_path)


def test_runs_of_two_currencies():
    first, second = run_of("quick"), run_of("quick")
    other = replace(second, case=replace(second.case, currency="USD"))
    with pytest.raises(CaseError, match="both must have the same unit"):
        check_pair(first, other)


def test_a_measure_of_risk_is_refused():
    run = run_of("quick", objective={"kind": "cvar", "level": 0.95})
    with pytest.raises(CaseError, match='it must be "mean"'):
        run.check()


def test_the_case_on_a_later_date_keeps_its_market():
    date = datetime.date(2025, 1, 4)
    second = run_of("quick", market={"valuation_date": date, "interest_rate": 0.2})
    first = run_of("quick")
    case = on_date_of(first, second, 7.0)
    assert case.valuation_date == date and float(case.contract.inventory.used()) == 7.0
    assert_allclose(case.market.forward_curve.used(), first.case.market.forward_curve.used()[3:])
    assert case.model.delivery.curve is case.market.forward_curve  # pyright: ignore
    assert float(case.market.zero_rate.values[0]) == 0.03


ROWS = (
    ChangePart(FIRST, "Jan 2025", 2.5, 0.2, "delta times move"),
    ChangePart(FIRST, "Feb 2025", -1.0, 0.1, "delta times move"),
    ChangePart(SECOND, "Jan 2025", 0.25, 0.1, "half"),
    ChangePart(SECOND, "Feb 2025", 0.0, 0.0, "half"),
    ChangePart(REST, "", 0.05, 0.02, "others"),
    ChangePart(CASH, "", 12.0, None, "minus the money"),
)
TOTALS = (
    ChangePart(FIRST, "", 1.5, 0.21, "delta times move"),
    ChangePart(SECOND, "", 0.25, 0.1, "half"), *ROWS[4:],
)  # fmt: skip


def test_flows_from_a_file(tmp_path):
    file = tmp_path / "taken.csv"
    file.write_text("date,volume,price\n2025-01-01,-2.5,30\n2025-01-02,0,31.5\n")
    assert read_flows(file)[datetime.date(2025, 1, 1)] == (-2.5, 30.0)
    file.write_text("date,volume,price\n2025-01-01,many,30\n")
    with pytest.raises(CaseError, match=r"taken.csv, line 2, column volume"):
        read_flows(file)
    with pytest.raises(CaseError, match="flows"):
        read_flows(tmp_path / "none.csv")


def test_the_command_writes_parts_and_report(tmp_path, monkeypatch):
    moves = CurveMove("Jan 2025", 31, 0.5, 5.0), CurveMove("Feb 2025", 28, -0.5, 2.0)
    flows = (DayFlow("2025-01-01", 12.0, 12.0, 1.0, 1.0, -12.0, -12.0, -12.0),)
    change = ExplainedChange(
        (tmp_path / "a", tmp_path / "b"), "Store", "EUR", "MWh", ("2025-01-01", "2025-01-02"),
        (100.0, 113.8), (0.1, 0.1), -12.0, ROWS, TOTALS, moves, flows, 2, 1024, ("a note",),
    )  # fmt: skip
    monkeypatch.setattr(command.ValuedRun, "read", lambda folder: run_of("quick"))
    monkeypatch.setattr(store_parts, "explained_change", lambda *runs: change)
    answer = command.explain(tmp_path / "a", tmp_path / "b", silent, out=tmp_path / "x")
    assert (answer["change"], answer["profit"]) == (13.8, 1.8)
    assert sum(row.amount for row in ROWS) == pytest.approx(13.8)
    rows = list(csv.DictReader((tmp_path / "x" / "explain.csv").read_text().splitlines()))
    assert [float(row["amount"]) for row in rows] == [row.amount for row in ROWS]
    assert rows[2]["part"] == "curve, second order" and rows[-1]["standard_error"] == ""
    saved = json.loads((tmp_path / "x" / "explain.json").read_text())
    assert saved["parts"][0]["amount"] == 2.5 and saved["flows"][0]["cash"] == -12.0
    text = command.summary(answer)
    assert "profit and loss" in text and "note: a note" in text
    html = (tmp_path / "x" / "explain.html").read_text()
    assert "Days between" in html and "Curve, second order +0.25" in html


@pytest.mark.parametrize("products", [None, {"day_ahead": {}, "months": {}}])
def test_delivery_periods_have_each_day_once(products):
    case = read("G4", **({} if products is None else {"products": products}))
    periods = delivery_periods(case.days, case.products)
    days = [day for period in periods for day in range(period.first, period.after)]
    assert days == list(range(len(case.days)))
    assert len(periods) == 4


def test_digits_follow_the_size_of_the_value():
    assert [decimals_of(x) for x in (10_447.3, 656.15, 15.28, 0.0)] == [2, 3, 4, 2]


@pytest.mark.study
def test_a_run_against_itself(solved, tmp_path):
    """The chain of revaluations ends at the value in result.json, to the bits."""
    run = solved("gas-storage") / "run"
    answer = command.explain(run, run, silent, out=tmp_path)
    amounts = {row["part"]: row["amount"] for row in answer["totals"]}
    assert set(amounts) == {FIRST, SECOND, POLICY, REST}
    assert not any(amounts.values())
    assert all(row["standard_error"] == 0 for row in answer["totals"])
