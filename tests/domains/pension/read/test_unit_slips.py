"""Slips of units in the case of a fund: one note each, with the file and the number."""

import pytest
from tests.domains.pension.every_key import CASES, written
from tests.domains.pension.miniature import short_case

from snapo.case.plausible import checked_numbers
from snapo.domains.pension.read.case import read_case, resolve
from snapo.domains.pension.records.inputs import every_given
from snapo.domains.pension.records.plausible import RANGES, amounts

# A file of the small example, a text in it, what replaces it, the beginning of the note and a part.
SLIPS = {
    "a node of the curve": (
        "curve.csv", "20,0.02394", "20,0.2394", "curve.csv, line 11, column zero: zero_rate 20y is "
        "2,394 bp (0.2394), outside -200 to 1,500 bp", "0.02 is 2 %",
    ),
    "a forward": (
        "curve.csv", "20,0.02394", "20,0.002394", "curve.csv, line 11, column zero: forward rate up to 20y is -621.54 bp, outside -500 to 2,000",
        "0.02 is 2 %",
    ),
    "a break-even": (
        "break_evens.csv", "10,0.02053", "10,0.2053", "break_evens.csv, line 8, column rate: ",
        "break_even 10y is 2,053 bp",
    ),
    "wage growth": (
        "case.toml", "real_wage_growth = 0.004", "real_wage_growth = 0.4",
        "inflation.real_wage_growth: real_wage_growth is 4,000 bp (0.4), outside -500 to 500 bp",
        "per year",
    ),
    "mean of a class": (
        "assets.csv", "Equity,equity,0.054", "Equity,equity,0.54", "assets.csv, line 8, column mean: ",
        "asset_mean Equity is 54 percentage points",
    ),
    "volatility of a class": (
        "assets.csv", "0.054,0.2,", "0.054,2.0,", "assets.csv, line 8, column volatility: ",
        "asset_volatility Equity is 200 percentage points",
    ),
    "cost of trading": (
        "assets.csv", ",Growth,0,0.7,0.001,", ",Growth,0,0.7,0.3,", "assets.csv, line 8, column cost: ",
        "asset_cost Equity is 3,000 bp",
    ),
    "spread": ("credit.csv", "BBB,0.013", "BBB,1.3", "credit.csv, line 3, column spread: ", "13,000 bp"),
    "volatility of a spread": (
        "credit.csv", ",0.35,", ",3.5,", "credit.csv, line 3, column volatility: ", "350 percentage points",
    ),
    "loss by default": ("credit.csv", ",0.002", ",0.2", "credit.csv, line 3, column default_loss: ",
                        "2,000 bp"),
    "volatility of a currency": (
        "currencies.csv", "USD,0.1", "USD,1.0", "currencies.csv, line 3, column volatility: ",
        "100 percentage points",
    ),
    "cost of hedging": ("currencies.csv", "0.5,0.0005", "0.5,0.5", "currencies.csv, line 3, column ",
                        "currency_hedge_cost USD is 5,000 bp"),
    "notional": (
        "overlay.csv", "10,0,", "10,50,", "overlay.csv, line 3, column notional: ",
        "overlay_notional 10y is 50 EUR",
    ),
    "cost of swaps": ("overlay.csv", "0.25,0.0001", "0.25,1", "overlay.csv, line 3, column cost: ",
                      "overlay_cost 10y is 10,000 bp"),
    "leverage": ("case.toml", "leverage = 1.0", "leverage = 100.0", "overlay.leverage: ",
                 "1 is a notional as large as the assets"),
    "collateral": ("case.toml", "collateral_stress = 0.035", "collateral_stress = 3.5",
                   "overlay.collateral_stress: ", "0.035 is 350 bp"),
    "volatility of rates": (
        "case.toml", "volatility = 0.008", "volatility = 0.8",
        "rates.volatility: rate_volatility is 8,000 bp (0.8)", "0.008 is 0.8 %",
    ),
    "volatility of prices": (
        "case.toml", "index_volatility = 0.01", "index_volatility = 1.0",
        "inflation.index_volatility: ", "outside 2 to 500 bp",
    ),
    "price of risk": ("case.toml", "price_of_risk = -0.15", "price_of_risk = -15.0",
                      "rates.price_of_risk: rate_price_of_risk is -15 ", "per unit of volatility"),
    "reversion of rates": ("case.toml", "mean_reversion = 0.03 ", "mean_reversion = 30.0 ",
                           "rates.mean_reversion: rate_mean_reversion is 30", "per year"),
    "members": ("cohorts.csv", "35,420,3200", "35,0.42,3200", "cohorts.csv, line 3, column number: ",
                "members Actives M 35 is 0.42 members"),
    "a pension in thousands": (
        "cohorts.csv", "71,610,11800", "71,610,11.8", "cohorts.csv, line 9, column pension: ",
        "accrued_pension Pensioners M 71 is 11.8 EUR/year",
    ),
    "service in months": ("cohorts.csv", "3200,41000,8", "3200,41000,96",
                          "cohorts.csv, line 3, column service: service Actives M 35 is 96 years",
                          "outside 0 to 60 years"),
    "improvement": ("case.toml", "improvement = 0.012", "improvement = 0.12",
                    "mortality.improvement: improvement is 1,200 bp", "per year"),
    "multiplier": ("multipliers.csv", "0.92", "92", "multipliers.csv, line ", "0.95 is 95 %"),
    "accrual": ("case.toml", "accrual_rate = 0.0175", "accrual_rate = 0.175",
                "plan.accrual_rate: plan_accrual_rate is 1,750 bp", "1/60 is 0.0167"),
    "offset": ("case.toml", "offset = 15000.0", "offset = 15.0", "plan.offset: plan_offset is 15 EUR",
               "outside 50 to 300,000 EUR/year"),
    "expenses": ("case.toml", "expenses = 900000.0", "expenses = 0.9",
                 "plan.expenses: plan_expenses is 0.9 EUR/year", "same unit as the other amounts"),
    "cap": ("case.toml", "cap = 0.04", "cap = 0.4", "plan.indexation.cap: ", "indexation_cap is 4,000"),
    "ratios": ("case.toml", "upper_ratio = 1.2", "upper_ratio = 120.0",
               "plan.indexation.upper_ratio: ", "1.05 is 105 %"),
    "contribution": ("case.toml", "cap = 0.35", "cap = 35.0", "plan.contribution.cap: ",
                     "contribution_cap is 3,500 percentage points"),
    "rate of valuation": ("case.toml", "rate = 0.002", "rate = 0.2",
                          "liability.rate: liability_rate is 2,000 bp", "0.02 is 2 %"),
    "a shift of rates": (
        "stress.csv", "Rates +100 bp,curve,,add,0.01", "Rates +100 bp,curve,,add,100",
        "stress.csv, line 3, column size: stress shift Rates +100 bp is 1,000,000 bp",
        "0.01 is 100 bp",
    ),
    "a fall of prices": (
        "stress.csv", "Spreads x 2,credit_spread,,multiply,1", "Spreads x 2,credit_spread,,multiply,100",
        "stress.csv, line 10, column size: stress factor Spreads x 2 is 100", "-0.3 is a fall",
    ),
}  # fmt: skip


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_of_units_has_one_note(slip, tmp_path):
    file, old, new, start, part = SLIPS[slip]
    (note,) = read_case(short_case(tmp_path / "case", [(file, old, new)])).notes
    assert note.startswith(start)
    assert part in note


def test_salaries_in_thousands_mean_that_nobody_accrues(tmp_path):
    folder = short_case(tmp_path / "case")
    text = (folder / "cohorts.csv").read_text()
    for salary in ("41000", "38000", "52000", "45000"):
        text = text.replace(salary, salary[:2])
    (folder / "cohorts.csv").write_text(text)
    case = read_case(folder)
    (note,) = case.notes
    assert note == (
        "cohorts.csv, line 3, column salary: salary Actives M 35 is 41 EUR/year, below 15,000 "
        "EUR/year, as are 3 more of its numbers: plan.offset is 15,000, so that no active member "
        "accrues a pension."
    )
    assert case.slips == ("salary",)


def test_one_salary_in_thousands_is_noted(tmp_path):
    case = read_case(short_case(tmp_path / "case", [("cohorts.csv", "41000", "41")]))
    (note,) = case.notes
    assert "salary Actives M 35 is 41 EUR/year, outside 3,000 to 1,000,000 EUR/year:" in note


def test_a_fee_of_half_of_the_holding_is_noted(tmp_path):
    fee = [("assets.csv", "cost,maturity", "fee,maturity")]
    fee += [("case.toml", '"asset_cost", ', "")]
    fee += [("assets.csv", ",Growth,,,0.01,", ",Growth,,,0.5,")]
    (note,) = read_case(short_case(tmp_path / "case", fee)).notes
    start = (
        "assets.csv, line 9, column fee: asset_fee Property is 5,000 bp (0.5), outside 0 to 500 bp"
    )
    assert note.startswith(start)


def test_every_input_of_every_kind_of_case_has_a_range(tmp_path):
    """All but assets, of which the funding ratio tells, and correlations, which are -1 to 1."""
    path = written(tmp_path)
    for data in CASES.values():
        case = resolve(path, {key: item for key, item in data.items() if item is not None})
        ranges = [*RANGES, *amounts(case)]
        missing = {
            item.name
            for item in every_given(case)
            if not any(range_.fits(checked_numbers(item)) for range_ in ranges)
        }
        assert missing <= {"assets", "correlation", "gompertz"}


def test_other_rules_and_ready_made_scenarios_are_looked_at(tmp_path):
    path = written(tmp_path)
    everything = CASES["everything"]
    rules = {
        "regulation": everything["regulation"] | {"policy_ratios": [101.0, 1.01]},
        "funding": everything["funding"] | {"technical_provisions": 0.5, "recovery_years": 60.0},
    }
    case = resolve(path, everything | rules)
    assert {"policy ratio", "funding margin", "funding recovery years"} <= set(case.slips)
    assert any(
        "regulation.policy_ratios[0]: policy ratio of month 1 is 101, outside 0.4 to 2.5" in note
        for note in case.notes
    )
    formula = CASES["index-linked"]
    mortality = formula["mortality"] | {"male": [10.4, 0.096]}
    assert "hazard at 65" in resolve(path, formula | {"mortality": mortality}).slips
    scenarios = (tmp_path / "training.csv").read_text().replace(",0.02,", ",2.0,")
    (tmp_path / "training.csv").write_text(scenarios)
    case = resolve(path, {k: v for k, v in CASES["ready-made scenarios"].items() if v is not None})
    assert "scenario growth" in case.slips
