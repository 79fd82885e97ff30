"""Quotes of a case: products by name, quotes of the same days, and the curve of a contract."""

import datetime
import json
from pathlib import Path

import numpy as np
import pytest
from tests.domains.gas_storage.curves.test_smooth import QUOTES, REFERENCE
from tests.domains.gas_storage.storage_cases import bare, random_actions, read_case

from snapo.case.error import CaseError
from snapo.domains.gas_storage.curves.products import delivery
from snapo.engine.native import Native
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import pull_back
from snapo.study import commands
from snapo.study.domain import CaseRequest

D = datetime.date
CASE = """kind = "gas-storage"
[contract]
start = {start}
end = {end}
inventory = 100.0
max_inventory = 1000.0
max_injection = 50.0
max_withdrawal = 60.0
end_inventory = "free"
[market]
valuation_date = 2025-11-25
quotes = "quotes.csv"
{market}
[model]
kind = "one-factor"
mean_reversion = 12.0
volatility = 0.6
"""


def case(folder: Path, quotes: dict[str, float], market: str = "", start=D(2025, 12, 1),
         end=D(2027, 4, 1)):  # fmt: skip
    rows = [f"{name},{price}" for name, price in quotes.items()]
    (folder / "quotes.csv").write_text("\n".join(["product,price", *rows]), "utf-8")
    file = folder / "case.toml"
    file.write_text(CASE.format(start=start, end=end, market=market), "utf-8")
    return read_case(folder)


@pytest.mark.parametrize(
    ("name", "first", "last"),
    [
        ("2026-01-15", D(2026, 1, 15), D(2026, 1, 15)),
        ("weekend 2026-01-17", D(2026, 1, 17), D(2026, 1, 18)),
        ("2024-02", D(2024, 2, 1), D(2024, 2, 29)),
        ("2026-q4", D(2026, 10, 1), D(2026, 12, 31)),
        ("Summer 2026", D(2026, 4, 1), D(2026, 9, 30)),
        ("winter  2026", D(2026, 10, 1), D(2027, 3, 31)),
        ("gas year 2026", D(2026, 10, 1), D(2027, 9, 30)),
        ("2026", D(2026, 1, 1), D(2026, 12, 31)),
        ("2026-01-15/2026-01-31", D(2026, 1, 15), D(2026, 1, 31)),
    ],
)
def test_the_days_of_a_product(name, first, last):
    assert delivery(name) == (first, last)


@pytest.mark.parametrize(
    "name", ["winter", "2026-Q5", "2026-13", "weekend 2026-01-18", "2026-02-01/2026-01-01", ""]
)
def test_no_product(name):
    with pytest.raises(ValueError, match=r"."):
        delivery(name)


def test_the_curve_of_a_contract_is_made_from_its_quotes(tmp_path):
    """shared/cases/desk.md, D8."""
    quoted = case(tmp_path, QUOTES)
    at = {day.isoformat(): price for day, price in zip(quoted.days, forward(quoted))}
    for text, values in REFERENCE.items():
        assert at[text] == pytest.approx(values[0], abs=1.1e-6)
    flat = case(tmp_path, QUOTES, 'curve = { smoother = "spline" }')
    weekend = case(tmp_path, QUOTES, "curve = { factors = { saturday = 0.94, sunday = 0.94 } }")
    for column, item in ((1, weekend), (2, flat)):
        values = dict(zip([day.isoformat() for day in item.days], forward(item)))
        assert values["2027-03-31"] == pytest.approx(REFERENCE["2027-03-31"][column], abs=1.1e-6)


def forward(item) -> np.ndarray:
    return item.market.forward_curve.used()


def test_quotes_of_the_same_days_agree_or_are_refused_by_name(tmp_path):
    """D8: 31.4144444 is the mean of the three months by their days, 31.60 is not."""
    alone = case(tmp_path, QUOTES)
    agreed = case(tmp_path, QUOTES | {"2026-Q1": 31.4144444})
    np.testing.assert_array_equal(forward(agreed), forward(alone))
    assert any("2026-Q1 agrees with the other quotes" in note for note in agreed.notes)
    with pytest.raises(CaseError) as error:
        case(tmp_path, QUOTES | {"2026-Q1": 31.60})
    text = str(error.value)
    assert "line 9, column price" in text and "31.6" in text
    assert "2026-01, 2026-02, 2026-03 together give 31.4144" in text


def test_a_month_that_a_quarter_and_two_months_imply_is_made_from_them(tmp_path):
    """Any quotes that are independent determine the curve, not only those in a row."""
    months = {"2026-01": 32.20, "2026-02": 32.00, "2026-Q1": 31.4144444444}
    item = case(tmp_path, months, start=D(2026, 1, 1), end=D(2026, 4, 1))
    march = [price for day, price in zip(item.days, forward(item)) if day.month == 3]
    assert np.mean(march) == pytest.approx(30.10, abs=1e-6)


@pytest.mark.parametrize(
    ("quotes", "market", "words"),
    [
        ({"2025-12": 31.5}, "", "2026-01-01: no quoted product contains this day"),
        ({"2025-12": 31.5, "Dec 25": 31.0}, "", "line 3, column product"),
        ({"2025-12": 31.5, "2025-12-01/2025-12-31": 31.0}, "", "line 2 has a price for the same"),
        (QUOTES, 'curve = { smoother = "cubic" }', 'smoother "daily" or "spline"'),
        (QUOTES, "curve = { factors = { sunday = 0.0 } }", "above 0"),
        (QUOTES, "curve = { factors = { sun = 0.9 } }", "day of the week"),
        (QUOTES, 'forward_curve = "curve.csv"', "[market] needs exactly one of"),
    ],
)
def test_mistakes_are_named(tmp_path, quotes, market, words):
    with pytest.raises(CaseError) as error:
        case(tmp_path, quotes, market)
    assert words in str(error.value)


@pytest.mark.prove
def test_a_derivative_by_quote_is_the_bump_of_the_quote_with_decisions_held(tmp_path):
    dates = {"start": D(2026, 1, 10), "end": D(2026, 3, 20)}
    quotes = {"2026-01": 32.2, "2026-Q1": 31.4, "2026-04": 27.0}
    item = case(tmp_path, quotes, **dates)
    assert item.quotes is not None
    actions = random_actions(len(item.days), 8)
    weights = {"cash_flow": np.full(8, 1 / 8)}

    def rolled(item):
        simulator, _, schedule = bare(item)
        draws = Pseudo(3).draws(np.arange(8), simulator)
        engine = Native("float64")
        return engine.values(simulator, None, schedule, draws, Exact(), actions=actions)

    def value(quotes) -> float:
        return float(np.mean(rolled(case(tmp_path, quotes, **dates)).totals["cash_flow"]))

    simulator, inputs, schedule = bare(item)
    draws = Pseudo(3).draws(np.arange(8), simulator)
    back = Native("float64").adjoint(
        simulator, None, schedule, draws, Exact(), weights, actions=actions, wrt=("schedule",)
    )
    by_day = pull_back(simulator, inputs, [back.schedule])["forward_curve"][0]
    by_quote = by_day @ item.quotes.matrix
    for i, (name, price) in enumerate(quotes.items()):
        up, down = (value(quotes | {name: price + h}) for h in (0.01, -0.01))
        assert by_quote[i] == pytest.approx((up - down) / 0.02, rel=1e-6, abs=1e-6)


@pytest.mark.prove
def test_a_run_reports_the_deltas_by_quote(tmp_path):
    """All quotes 1 higher are a curve that is 1 higher: the deltas by quote sum to those by day."""
    dates = {"start": D(2026, 1, 10), "end": D(2026, 3, 20)}
    case(tmp_path, {"2026-01": 32.2, "2026-02": 31.8, "2026-03": 30.1}, **dates)
    small = ("training.steps=2", "training.paths=32", "evaluation.paths=256",
             "evaluation.sensitivity_paths=64", "evaluation.judge_paths=0")  # fmt: skip
    request = CaseRequest(tmp_path, small)
    commands.solve(request, lambda _: None, out=tmp_path / "out")
    part = json.loads((tmp_path / "out" / "parts" / "deltas-by-quote.json").read_text())
    rows = part["deltas_by_quote"]
    assert [row["product"] for row in rows] == ["2026-01", "2026-02", "2026-03"]
    daily = json.loads((tmp_path / "out" / "parts" / "deltas.json").read_text())["deltas_daily"]
    for name in ("discounted", "undiscounted"):
        assert sum(row[name] for row in rows) == pytest.approx(sum(daily[name]), rel=1e-9)
    assert all(row["low"] <= row["discounted"] <= row["high"] for row in rows)
    assert "Deltas by quoted product" in (tmp_path / "out" / "report.html").read_text()
    written = (tmp_path / "out" / "quotes.csv").read_text().splitlines()
    assert written[0].startswith("product,price,discounted") and len(written) == 4
