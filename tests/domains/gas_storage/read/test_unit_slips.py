"""Slips of units in a storage contract: one note each, with the file and the number."""

import shutil
from pathlib import Path

import pytest

from snapo.case.load import load
from snapo.domains.gas_storage import DOMAIN
from snapo.domains.gas_storage.read.case import read_case
from snapo.study.commands import check
from snapo.study.domain import CaseRequest

CASES = Path(__file__).parents[1] / "cases"
TEMPLATE = Path(str(DOMAIN.templates["flagship"]))

# A file of the template, a text in it, what replaces it, and the beginning and a part of the note.
SLIPS = {
    "spot volatility": (
        "case.toml", "spot_volatility = 0.85", "spot_volatility = 45.0",
        "model.spot_volatility: spot_volatility is 4,500 volatility points (45)", "0.85 is 85 %",
    ),
    "interest rate": (
        "case.toml", 'interest_rate = "rates.csv"', "interest_rate = 0.9",
        "market.interest_rate: interest_rate is 9,000 bp (0.9)", "0.02 is 2 %",
    ),
    "a node of the rates": (
        "rates.csv", "0.0115", "0.75", "rates.csv, line ", "is 7,500 bp (0.75)",
    ),
    "a price": (
        "curve.csv", "2021-05,15.68", "2021-05,1568", "curve.csv, line 3, column price: ",
        "forward_curve 2021-05-01 is 1,568 EUR/MWh, outside 1 to 1,000 EUR/MWh, as are 30 more",
    ),
    "a price among others": (
        "curve.csv", "2021-06,15.42", "2021-06,771", "curve.csv, line 4, column price: ",
        "forward_curve 2021-06-01 is 771 EUR/MWh, 4",
    ),
    "value at the end": (
        "case.toml", "end_inventory = 0.0", 'end_inventory = "free"\nend_value = 15.0',
        "contract.end_value: end_value is 1,500 percentage points (15)", "share of the spot price",
    ),
    "loss": (
        "case.toml", "# inventory_loss = 0.0 ", "inventory_loss = 0.1 ",
        "contract.inventory_loss: inventory_loss is 10 percentage points a day (0.1)", "a day",
    ),
    "fuel": (
        "case.toml", "# injection_fuel = 0.0 ", "injection_fuel = 0.9 ",
        "contract.injection_fuel: injection_fuel is 90 percentage points", "0.015 is 1.5 %",
    ),
    "mean reversion": (
        "case.toml", "spot_mean_reversion = 91.0", "spot_mean_reversion = 0.25",
        "model.spot_mean_reversion: spot_mean_reversion is 0.25 1/year, outside 1 to 1,000 1/year",
        "it is per year",
    ),
    "last day": (
        "case.toml", "end = 2022-04-01", "end = 2022-03-31", "contract.end: 2022-03-31 ",
        "end = 2022-04-01",
    ),
    "cost in cents": (
        "case.toml", "injection_cost = 0.01", "injection_cost = 100.0",
        "contract.injection_cost: injection_cost is 100 EUR/MWh, outside 0 to 5", "EUR/MWh",
    ),
    "cost of a year": (
        "case.toml", "# inventory_cost = 0.0 ", "inventory_cost = 5.0 ",
        "contract.inventory_cost: inventory_cost is 5 EUR/MWh/day", "EUR/MWh per day",
    ),
    "rates in GWh": (
        "ratchets.csv", "132", "0.132", "ratchets.csv, line ", "ratchet_injection 2021-04-01 at ",
    ),
}  # fmt: skip


def copy(folder: Path, source: Path = TEMPLATE) -> Path:
    return Path(shutil.copytree(source, folder))


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_of_units_has_one_note(slip, tmp_path):
    file, old, new, start, part = SLIPS[slip]
    folder = copy(tmp_path / "case")
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1))
    (note,) = read_case(*load(folder)).notes
    assert note.startswith(start)
    assert part in note


def test_a_curve_in_another_unit_has_one_note(tmp_path):
    """15.68 EUR/MWh are 0.01568 EUR/kWh."""
    folder = copy(tmp_path / "case")
    lines = [line.split(",") for line in (folder / "curve.csv").read_text().splitlines()]
    text = "\n".join(
        ",".join(line)
        if len(line) != 2 or line[0] == "date"
        else f"{line[0]},{float(line[1]) / 1000}"
        for line in lines
    )
    (folder / "curve.csv").write_text(text)
    data = (folder / "case.toml").read_text()
    data = data.replace("injection_cost = 0.01", "injection_cost = 0.0")
    data = data.replace("withdrawal_cost = 0.025", "withdrawal_cost = 0.0")
    (folder / "case.toml").write_text(data)
    (note,) = read_case(*load(folder)).notes
    assert "outside 1 to 1,000 EUR/MWh, as are 340 more of its numbers" in note
    # In its own unit the same curve has none: a thousandth of 1 to 1,000.
    (folder / "case.toml").write_text(data.replace('volume_unit = "MWh"', 'volume_unit = "kWh"'))
    assert not read_case(*load(folder)).notes


def test_check_prints_the_note_before_the_lines_of_the_case(tmp_path):
    folder = copy(tmp_path / "case")
    text = (folder / "case.toml").read_text()
    (folder / "case.toml").write_text(text.replace("volatility = 0.85", "volatility = 45.0"))
    printed: list[str] = []
    lines = check(CaseRequest(folder), printed.append)
    assert printed == [
        "note: model.spot_volatility: spot_volatility is 4,500 volatility points (45), outside 0.5 "
        "to 500 volatility points: a fraction is expected (0.85 is 85 %)."
    ]
    assert lines[-1] == "the contract can be met"


def test_fixed_costs_before_the_valuation_date_are_noted(tmp_path):
    folder = copy(tmp_path / "case", CASES / "quick")
    text = (folder / "case.toml").read_text()
    (folder / "case.toml").write_text(
        text.replace("[market]", 'fixed_costs = "fixed.csv"\n[market]')
    )
    (folder / "fixed.csv").write_text("date,amount\n2024-12-01,5\n2024-12-31,5\n2025-01-01,5\n")
    case = read_case(*load(folder))
    assert case.notes == (
        "fixed.csv, line 2: the amount of 2024-12-01 is due before the valuation date, 2025-01-01, "
        "as is 1 more: such amounts are ignored.",
    )
    assert case.contract.fixed_costs.used().tolist() == [5.0]


@pytest.mark.parametrize("name", ["G1", "G2", "G3", "G4", "G5", "G6", "quick"])
def test_the_cases_of_the_tests_have_no_note(name):
    assert not read_case(*load(CASES / name)).notes
