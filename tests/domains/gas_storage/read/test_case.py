"""The storage case format: what a good case says, and what is answered to a bad one."""

import dataclasses
import datetime
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import read_case

from snapo.case.error import CaseError
from snapo.domains.gas_storage.contract.records import LevelAtEnd, PriceAtEnd, ValueAtEnd
from snapo.domains.gas_storage.contract.terms import (
    discount,
    fixed_costs_value,
    value_without_decisions,
)
from snapo.domains.gas_storage.prices.supplied import SuppliedPrices
from snapo.domains.gas_storage.prices.three_factor_seasonal import ThreeFactorSeasonal

CASES = Path(__file__).parents[1] / "cases"
D = datetime.date


@pytest.fixture
def folder(tmp_path):
    """Copies a case into a folder of its own, where a test may spoil it."""

    def copy(name: str = "G1") -> Path:
        return Path(shutil.copytree(CASES / name, tmp_path / name))

    return copy


def change(file: Path, old: str, new: str) -> Path:
    """Replaces `old`, which must be there, by `new`; returns the folder."""
    text = file.read_text(encoding="utf-8")
    assert old in text, f"{old!r} is not in {file}"
    file.write_text(text.replace(old, new, 1), encoding="utf-8")
    return file.parent


# What good cases say.


@pytest.mark.parametrize("name", ["G1", "G2", "G3", "G4", "G5", "G6", "quick"])
def test_every_case_is_read_and_consistent(name):
    case = read_case(CASES / name)
    horizon = len(case.days)
    contract, market = case.contract, case.market
    assert horizon == len(case.day) > 0
    assert case.days[-1] == case.end - datetime.timedelta(1)
    assert case.end_day == case.day[-1] + 1
    assert market.forward_curve.used().shape == (horizon,)
    assert market.gas_day.shape == contract.injection_cost_day.shape == (horizon,)
    assert contract.max_inventory.used().shape == (horizon + 1,)
    assert contract.ratchets.inventory.used().shape == contract.ratchets.injection.used().shape
    for field in dataclasses.fields(contract):
        entry = getattr(contract, field.name)
        if hasattr(entry, "used"):
            assert np.isfinite(entry.used()).all()
    assert case.notes == ()


def test_flagship_numbers():
    case = read_case(CASES / "G1")
    assert (case.valuation_date, case.days[0], case.end) == (
        D(2021, 4, 25),
        D(2021, 4, 25),
        D(2022, 4, 1),
    )
    assert len(case.days) == 341
    prices = dict(zip(case.days, case.market.forward_curve.used(), strict=True))
    assert (prices[D(2021, 4, 30)], prices[D(2021, 5, 1)], prices[D(2022, 3, 31)]) == (
        16.61,
        15.68,
        16.81,
    )
    assert case.market.forward_curve.labels[0] == "2021-04-25"
    paid = case.market.gas_day + case.valuation_date.toordinal()
    assert D.fromordinal(paid[0]) == D(2021, 5, 20)
    assert D.fromordinal(paid[-1]) == D(2022, 4, 20)
    np.testing.assert_array_equal(case.contract.injection_cost_day, case.day)
    rows = case.contract.ratchets
    np.testing.assert_array_equal(rows.inventory.used()[0], [0, 2000, 5000, 7000])
    np.testing.assert_array_equal(rows.withdrawal.used()[-1], [150, 200, 260, 275])
    np.testing.assert_array_equal(rows.injection.used()[7], [250, 175, 155, 132])
    assert rows.inventory.labels[1] == "2021-04-01 at 2000"
    assert isinstance(case.model, ThreeFactorSeasonal)
    assert case.model.spot_mean_reversion.used() == 91.0
    # 83 days from 1 February 2021 to 25 April.
    assert case.model.season[0] == math.cos(2 * math.pi * 83 / 365.25)
    assert case.model.season.shape == (342,)
    assert isinstance(case.contract.at_end, LevelAtEnd)
    assert case.market.zero_rate_day.tolist() == [0, 37, 98, 220, 341, 585]


def test_dated_ratchets_change_on_their_date():
    rows = read_case(CASES / "G3").contract.ratchets
    assert rows.withdrawal.used()[4, 0] == 44.85  # 2019-09-19
    assert rows.withdrawal.used()[5, 0] == 31.41  # 2019-09-20
    assert len(rows.withdrawal.values) == 12


def test_volatility_by_delivery_day_reaches_the_end_date():
    model = read_case(CASES / "G3").model
    assert model.volatility.used().shape == (17, 1)
    assert model.volatility.used()[-1, 0] == 0.8655
    assert model.volatility.labels[0] == "2019-09-15"


def test_three_calls_are_worth_black_76():
    """The case as read holds everything that the sum of three Black-76 calls needs."""
    case = read_case(CASES / "G4")
    market, contract, model = case.market, case.contract, case.model
    volume = contract.ratchets.withdrawal.used()[:, 0]
    value = 0.0
    for t in np.flatnonzero(volume):
        reversion, years = model.mean_reversion.used()[0], case.day[t] / 365
        variance = -math.expm1(-2 * reversion * years) / (2 * reversion)
        deviation = model.volatility.used()[t, 0] * math.sqrt(variance)
        forward, strike = market.forward_curve.used()[t], contract.withdrawal_cost.used()[t]
        high = math.log(forward / strike) / deviation + deviation / 2
        call = forward * normal(high) - strike * normal(high - deviation)
        value += volume[t] * call * discount(market, market.gas_day)[t]
        assert contract.withdrawal_cost_day[t] == market.gas_day[t]
    assert volume[np.flatnonzero(volume)].tolist() == [1200, 800, 900]
    assert value == pytest.approx(10_447.3037, abs=5e-5)


def normal(x: float) -> float:
    """The standard normal distribution function."""
    return math.erfc(-x / math.sqrt(2)) / 2


def test_forced_flows_have_the_published_value():
    """Every policy earns the same, so that the expected cash flow follows from the records."""
    case = read_case(CASES / "G5")
    contract, market = case.contract, case.market
    gas = market.forward_curve.used() * discount(market, market.gas_day)
    injection, withdrawal = contract.min_injection.used(), contract.min_withdrawal.used()
    value = np.sum(withdrawal * (1 - contract.withdrawal_fuel.used()) * gas)
    value -= np.sum(injection * (1 + contract.injection_fuel.used()) * gas)
    paid = discount(market, contract.injection_cost_day)
    value -= np.sum(injection * contract.injection_cost.used() * paid)
    paid = discount(market, contract.withdrawal_cost_day)
    value -= np.sum(withdrawal * contract.withdrawal_cost.used() * paid)
    assert value == pytest.approx(-156_115.5176, abs=5e-5)


def test_slow_storage_has_a_price_for_every_day():
    case = read_case(CASES / "G6")
    assert len(case.days) == 365
    monthly = [26, 25, 23, 22, 21.5, 21, 20.8, 20.7, 22, 23, 24, 25.5]
    firsts = [price for day, price in pairs(case) if day.day == 1]
    assert firsts == monthly


def pairs(case):
    return zip(case.days, case.market.forward_curve.used(), strict=True)


# Dates, curves and rules.


def test_valuation_after_the_end_has_no_days_and_is_no_error(folder):
    path = change(
        folder() / "case.toml", "valuation_date = 2021-04-25", "valuation_date = 2022-04-02"
    )
    case = read_case(path)
    assert case.expired
    assert case.days == ()
    assert value_without_decisions(case) == 0.0


def test_valuation_on_the_end_date_is_feasible_only_at_the_level(folder):
    file = folder() / "case.toml"
    change(file, "valuation_date = 2021-04-25", "valuation_date = 2022-04-01")
    with pytest.raises(CaseError, match=r"contract\.end_inventory: got 0;.*2022-04-01.*1500"):
        read_case(file)
    change(file, "inventory = 1500.0", "inventory = 0.0")
    case = read_case(file)
    assert not case.expired
    assert case.days == ()
    assert case.end_day == 0


def test_valuation_on_the_end_date_by_price_needs_that_price(folder):
    file = folder() / "case.toml"
    change(file, "valuation_date = 2021-04-25", "valuation_date = 2022-04-01")
    change(file, "end_inventory = 0.0", 'end_inventory = "free"\nend_value = 0.9')
    case = read_case(file)
    assert isinstance(case.contract.at_end, PriceAtEnd)
    assert case.has_end_price
    assert case.market.forward_curve.used().tolist() == [15.36]
    assert value_without_decisions(case) == pytest.approx(0.9 * 1500 * 15.36, rel=1e-14)


def test_the_last_day_nominated_already_leaves_the_discounted_end_value(folder):
    file = folder() / "case.toml"
    change(file, "valuation_date = 2021-04-25", "valuation_date = 2022-03-31")
    change(file, "end_inventory = 0.0", 'end_inventory = "free"\nend_value = "left.csv"')
    change(file, "[market]", 'first_decision = "next-day"\n[market]')
    change(file, 'interest_rate = "rates.csv"', "interest_rate = 0.05")
    (file.parent / "left.csv").write_text("inventory,value\n0,0\n1000,9000\n7000,20000\n")
    case = read_case(file)
    assert case.days == ()
    value = (9000 + 500 / 6000 * 11000) * math.exp(-0.05 / 365)
    assert value_without_decisions(case) == pytest.approx(value, rel=1e-14)


def test_valuation_before_the_start_waits_for_it(folder):
    path = change(
        folder() / "case.toml", "valuation_date = 2021-04-25", "valuation_date = 2021-03-01"
    )
    case = read_case(path)
    assert case.days[0] == D(2021, 4, 1)
    assert case.day[0] == 31


def test_next_day_leaves_today_out(folder):
    path = change(folder() / "case.toml", "[market]", 'first_decision = "next-day"\n[market]')
    assert read_case(path).days[0] == D(2021, 4, 26)


def test_days_win_over_months_and_the_current_month_covers_the_rest(folder):
    path = folder()
    change(path / "curve.csv", "2021-05,15.68", "2021-05-07,99\n2021-05,15.68\n2021-05-06,98")
    prices = dict(pairs(read_case(path)))
    assert [prices[D(2021, 5, day)] for day in (5, 6, 7, 8)] == [15.68, 98, 99, 15.68]
    assert prices[D(2021, 4, 25)] == 16.61


def test_a_byte_order_mark_and_blank_lines_are_harmless(folder):
    path = folder()
    for name in ("curve.csv", "case.toml"):
        file = path / name
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n\r\n"))
    assert len(read_case(path).days) == 341


def test_fixed_costs_before_the_valuation_date_are_left_out(folder):
    path = change(folder() / "case.toml", "[market]", 'fixed_costs = "fees.csv"\n[market]')
    (path / "fees.csv").write_text("date,amount\n2021-04-01,5\n2021-04-25,6\n2021-10-01,7\n")
    contract = read_case(path).contract
    assert contract.fixed_costs.used().tolist() == [6, 7]
    assert contract.fixed_cost_day.tolist() == [0, 159]
    owed = 6 + 7 * math.exp(-np.interp(159, [98, 220], [0.0072, 0.0087]) * 159 / 365)
    assert fixed_costs_value(read_case(path)) == pytest.approx(owed, rel=1e-14)


def test_outages_count_both_ends_and_the_least_factor(folder):
    path = folder()
    change(path / "case.toml", "[market]", 'outages = ["2021-07-01/2021-07-14"]\n[market]')
    case = read_case(path)
    closed = [
        day for day, left in zip(case.days, case.contract.injection_factor, strict=True) if not left
    ]
    assert (closed[0], closed[-1], len(closed)) == (D(2021, 7, 1), D(2021, 7, 14), 14)
    change(path / "case.toml", '["2021-07-01/2021-07-14"]', '"out.csv"')
    (path / "out.csv").write_text(
        "from,to,injection_factor,withdrawal_factor\n2021-07-01,2021-07-14,0.5,1\n"
        "2021-07-10,2021-07-20,0.8,0.25\n"
    )
    case = read_case(path)
    at = case.days.index(D(2021, 7, 12))
    assert case.contract.injection_factor[at] == 0.5
    assert case.contract.withdrawal_factor[at] == 0.25
    assert case.contract.injection_factor[at + 5] == 0.8


def test_dated_limits_hold_from_their_date_on(folder):
    path = folder()
    change(path / "case.toml", "[market]", 'min_inventory = "min.csv"\n[market]')
    (path / "min.csv").write_text("date,value\n2021-11-01,3000\n2021-11-02,0\n")
    case = read_case(path)
    at = case.days.index(D(2021, 11, 1))
    assert case.contract.min_inventory.used()[at - 1 : at + 2].tolist() == [0, 3000, 0]
    assert case.contract.min_inventory.labels[0] == "before 2021-11-01"
    assert case.notes == ("min.csv begins on 2021-11-01; until then min_inventory is 0.",)


def test_a_table_of_end_values(folder):
    path = folder()
    change(
        path / "case.toml", "end_inventory = 0.0", 'end_inventory = "free"\nend_value = "left.csv"'
    )
    (path / "left.csv").write_text("inventory,value\n0,0\n1000,9000\n7000,20000\n")
    at_end = read_case(path).contract.at_end
    assert isinstance(at_end, ValueAtEnd)
    assert at_end.value.used().tolist() == [0, 9000, 20000]


MULTI = """[model]
kind = "multi-factor"
factors = [
    { mean_reversion = 12.0, volatility = "v.csv" },
    { mean_reversion = 0, volatility = 0.3 },
]
correlation = [[1.0, -0.3], [-0.3, 1.0]]
"""


def with_model(path: Path, model: str) -> Path:
    """The case in `path` with another [model], the last table of the file."""
    text = (path / "case.toml").read_text(encoding="utf-8")
    (path / "case.toml").write_text(text[: text.index("[model]")] + model, encoding="utf-8")
    return path


def test_many_factors(folder):
    path = with_model(folder(), MULTI)
    (path / "v.csv").write_text("date,value\n2021-04-01,0.6\n2021-10-01,0.9\n")
    model = read_case(path).model
    used = model.volatility.used()
    assert used.shape == (342, 2)
    assert used[0].tolist() == [0.6, 0.3]
    assert used[-1].tolist() == [0.9, 0.3]
    assert model.volatility.labels == ("1 2021-04-01", "1 2021-10-01", "2")
    assert model.mean_reversion.used().tolist() == [12.0, 0.0]
    assert model.correlation.values.tolist() == [-0.3]
    assert model.correlation.labels == ("2,1",)


SUPPLIED = """[model]
kind = "supplied"
training_paths = "train.npy"
evaluation_paths = "test.parquet"
rescale_to_curve = true
"""


def test_supplied_paths_are_rescaled_to_mean_one(folder):
    parquet = pytest.importorskip("pyarrow.parquet")
    arrow = pytest.importorskip("pyarrow")
    path = with_model(folder("quick"), SUPPLIED)
    paths = np.random.default_rng(1).lognormal(3.0, 0.2, (50, 30))
    np.save(path / "train.npy", paths)
    columns = [f"d{number}" for number in range(30)]
    parquet.write_table(arrow.table(list(2 * paths.T), names=columns), path / "test.parquet")
    model = read_case(path).model
    assert isinstance(model, SuppliedPrices)
    np.testing.assert_allclose(model.paths.training.mean(axis=0), 1, rtol=1e-12)
    np.testing.assert_allclose(model.paths.training, model.paths.evaluation, rtol=1e-12)


def test_training_has_the_defaults_of_the_training_loop():
    from snapo.case.settings import TrainingTable
    from snapo.solver.learning.settings import TrainingPlan as Loop

    defaults = {field.name: field.default for field in dataclasses.fields(Loop)}
    # A case says its steps and paths itself; validations follow the steps where they are left out.
    defaults |= {"steps": 240, "paths": 512, "validation_every": None}
    del defaults["automatic"]
    assert {name: field.default for name, field in TrainingTable.model_fields.items()} == defaults
