"""Properties of reading a case: dates, quotes, settlement months, and attainable inventories."""

import calendar
import copy
import datetime
import math
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.domains.gas_storage.storage_cases import read_case

from snapo.case.csv import Row
from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.domains.gas_storage.contract.feasibility import attainable
from snapo.domains.gas_storage.read.case import quotes
from snapo.domains.gas_storage.read.case import read_case as resolve
from snapo.domains.gas_storage.read.contract import months_after

D = datetime.date
FLAGSHIP = Path(__file__).parents[1] / "cases" / "G1"


@given(st.dates(D(2000, 1, 1), D(2100, 1, 1)), st.integers(0, 36), st.integers(1, 31))
def test_months_after_counts_months_and_stays_in_the_month(day, months, day_of_month):
    paid = months_after(day, months, day_of_month)
    assert (paid.year * 12 + paid.month) - (day.year * 12 + day.month) == months
    assert paid.day == min(day_of_month, calendar.monthrange(paid.year, paid.month)[1])


@given(st.dates(D(1, 1, 1), D(9999, 12, 31)))
def test_every_day_of_the_calendar_is_read_back(day):
    assert Row("f.csv", 2, {"date": day.isoformat()}).day("date") == day


@given(st.text(max_size=12))
def test_any_other_text_is_no_date(text):
    row = Row("f.csv", 2, {"date": text})
    try:
        assert row.day("date").isoformat() == text
    except CaseError as error:
        assert str(error).startswith("f.csv, line 2, column date: got ")


@given(st.text(max_size=12) | st.floats().map(str) | st.integers().map(str))
def test_a_number_is_finite_or_refused(text):
    try:
        assert math.isfinite(Row("f.csv", 2, {"price": text}).number("price"))
    except CaseError as error:
        assert "column price" in str(error)


@settings(max_examples=60)
@given(
    st.dictionaries(st.integers(1, 12), st.integers(1, 99), max_size=12),
    st.dictionaries(st.dates(D(2021, 1, 1), D(2021, 12, 31)), st.integers(100, 199), max_size=30),
    st.randoms(use_true_random=False),
)
def test_quotes_merge_alike_in_any_order(months, days, random):
    lines = [(f"2021-{month:02d}", str(price)) for month, price in months.items()]
    lines += [(day.isoformat(), str(price)) for day, price in days.items()]
    random.shuffle(lines)
    rows = [Row("c.csv", n, {"date": d, "price": p}) for n, (d, p) in enumerate(lines, 2)]
    by_day, by_month = quotes(rows)
    assert {day: quote.value for day, quote in by_day.items()} == days
    prices = {(2021, month): price for month, price in months.items()}
    assert {month: quote.value for month, quote in by_month.items()} == prices


CASE = """
kind = "gas-storage"
[contract]
start = 2025-01-01
end = 2025-01-31
inventory = {start}
max_inventory = 50
ratchets = "ratchets.csv"
ratchet_interpolation = "{kind}"
end_inventory = "free"
[market]
valuation_date = 2025-01-01
forward_curve = "curve.csv"
[model]
kind = "one-factor"
mean_reversion = 20
volatility = 0.9
"""
RATCHETS = "date,inventory,max_withdrawal,max_injection\n2025-01-01"


@settings(max_examples=30, deadline=None)
@given(
    levels=st.lists(st.integers(1, 40), min_size=1, max_size=4, unique=True),
    rates=st.lists(st.tuples(st.integers(0, 20), st.integers(0, 20)), min_size=5, max_size=5),
    start=st.integers(0, 50),
    kind=st.sampled_from(["linear", "step"]),
)
def test_attainable_inventories_hold_every_simulated_path(
    tmp_path_factory, levels, rates, start, kind
):
    """No sequence of decisions leaves the sets, least of all one that goes all the way."""
    path = tmp_path_factory.mktemp("case")
    rows = [0, *sorted(levels), 50]
    lines = [f",{level},{out},{into}" for level, (out, into) in zip(rows, rates * 2, strict=False)]
    (path / "ratchets.csv").write_text(RATCHETS + "\n".join(lines) + "\n")
    (path / "curve.csv").write_text("date,price\n2025-01,30\n")
    (path / "case.toml").write_text(CASE.format(start=start, kind=kind))
    case = read_case(path)
    sets = attainable(case)
    ratchets = case.contract.ratchets
    random = np.random.default_rng(7)
    inventory = np.full(200, float(start))
    for t in range(len(case.days)):
        table = (
            ratchets.inventory.used()[t],
            ratchets.withdrawal.used()[t],
            ratchets.injection.used()[t],
        )
        out, into = rate(inventory, *table, kind)
        # A third of the paths always injects, a third always withdraws.
        share = np.r_[np.ones(67), -np.ones(67), random.uniform(-1, 1, 66)]
        inventory = inventory + np.where(share > 0, share * into, share * out)
        inventory = np.clip(inventory, 0, 50)
        low, high = np.array(sets[t + 1]).T
        inside = (inventory[:, None] >= low - 1e-6) & (inventory[:, None] <= high + 1e-6)
        assert inside.any(axis=1).all()


def rate(inventory, levels, withdrawal, injection, kind):
    """Rates at each inventory, written independently of the package."""
    if kind == "linear":
        return np.interp(inventory, levels, withdrawal), np.interp(inventory, levels, injection)
    row = np.searchsorted(levels, inventory, side="right") - 1
    return withdrawal[row], injection[row]


ODD = [
    *(0, -1, 10**400, 1e308, math.nan, math.inf, True, "", "x", "x.csv", "a\0b.csv"),
    *("a" * 300 + ".csv", "..csv", "rates.csv", "flow", "free", [], [[1.0]], ["2021-01-01"], {}),
    *({"days": 10**30}, {"months": 1}, D(1, 1, 1), D(9999, 12, 31), datetime.time(1, 2)),
]
KEYS = [(name, key) for name in ("contract", "market") for key in load(FLAGSHIP)[1][name]]
KEYS += [("contract", key) for key in ("min_injection", "end_value", "outages", "fixed_costs")]


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(KEYS), st.sampled_from(ODD))
def test_an_odd_value_is_read_or_refused_and_never_a_crash(place, value):
    file, data = load(FLAGSHIP)
    data = copy.deepcopy(data)
    data[place[0]][place[1]] = value
    try:
        resolve(file, data)
    except CaseError as error:
        assert str(error).startswith((str(file), "rates.csv", "curve.csv", "ratchets.csv"))
