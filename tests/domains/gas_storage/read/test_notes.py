"""Remarks on what is allowed and often a mistake: each says which number counts."""

import shutil
from pathlib import Path

import pytest

from snapo.case.load import load
from snapo.domains.gas_storage.read.case import read_case

CASES = Path(__file__).parents[1] / "cases"
COST, MARKET = "injection_cost = 0.05", "[market]"

# A text of the case or of the curve, what replaces it, and words of the only remark.
NOTES = {
    "outages overlap": (
        MARKET,
        f'outages = ["2025-01-03/2025-01-09", "2025-01-08/2025-01-12"]\n{MARKET}',
        ["2025-01-03 to 2025-01-09 and 2025-01-08 to 2025-01-12 overlap", "smaller factor"],
    ),
    "an outage after the end": (
        MARKET,
        f'outages = ["2025-01-31/2025-02-03"]\n{MARKET}',
        ["2025-01-31 to 2025-02-03 is outside of the contract, 2025-01-01 to 2025-01-31"],
    ),
    "two quotes": (
        "2025-01-01,27.03",
        "2025-01,20\n2025-01-01,27.03",
        ["curve.csv 2025-01-01 and 29 more days have a quote", "the quote for the day is used"],
    ),
    "paid late": (
        MARKET,
        f"{MARKET}\nsettlement = {{ months = 1200, day = 20 }}",
        ["market.settlement: the flow of 2025-01-01 is paid on 2125-01-20, 100 years later"],
    ),
    "an injection that pays": (
        COST,
        "injection_cost = -40.0",
        ["On 2025-01-01 an injection earns money: injection_cost is -40, and gas costs 27.03"],
    ),
    "a round trip that pays": (
        COST,
        "injection_cost = -0.2",
        ["earns money at any prices", "withdrawal_cost is -0.15"],
    ),
}


@pytest.mark.parametrize("name", NOTES)
def test_a_remark_says_which_number_counts(name, tmp_path):
    old, new, words = NOTES[name]
    folder = Path(shutil.copytree(CASES / "quick", tmp_path / "case"))
    good = read_case(*load(folder))
    for file in (folder / "case.toml", folder / "curve.csv"):
        file.write_text(file.read_text().replace(old, new))
    case = read_case(*load(folder))
    (note,) = set(case.notes) - set(good.notes)
    for word in words:
        assert word in note


def test_outages_that_follow_each_other_need_no_remark(tmp_path):
    folder = Path(shutil.copytree(CASES / "quick", tmp_path / "case"))
    text = (folder / "case.toml").read_text()
    outages = 'outages = ["2025-01-03/2025-01-08", "2025-01-09/2025-01-12"]\n[market]'
    (folder / "case.toml").write_text(text.replace(MARKET, outages))
    assert not read_case(*load(folder)).notes
