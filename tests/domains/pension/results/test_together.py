"""Funds with all that is new at once, from the template and a user's edits, to the end of a run.

`study`: four minutes of processor time each, nearly all of it compiling.
"""

import re

import pytest
from tests.domains.pension.miniature import short_case, solved

pytestmark = pytest.mark.study

ASSETS = """\
name,kind,mean,volatility,weight,low,high,group,group_low,group_high,cost,maturity,rating,currency,eligible,max_sale,band,risk
Cash,cash,,,0.02,0,0.3,,,,0,,,,1,,,
Bonds 10y,bond,,,0.25,0,0.7,Matching,0.2,0.9,0.0003,10,,,1,,0.005,
Linkers,index-linked,,,0.10,0,0.5,Matching,,,0.0004,15,,,0.8,,0.005,
Bonds 20y,bond,,,0.05,0,0.6,Matching,,,0.0005,20,,,1,,,
Credit BBB,credit,,,0.13,0,0.3,Matching,,,0.003,7,BBB,,0.5,,0.005,
Equity,equity,0.054,0.2,0.35,0,0.6,Growth,0,0.7,0.001,,,USD,0,,0.01,developed
Property,property,0.044,0.15,0.1,0,0.2,Growth,,,0.01,,,,0,0.1,,unlisted-property
"""
OVERLAY = """\
tenor,kind,notional,low,high,cost
10,rates,20000000,0,0.3,0.0001
30,rates,0,0,0.3,0.0002
20,inflation,5000000,0,0.3,0.0002
"""
RECOVERY = "date,amount\n2025-12-31,5000000\n2026-06-30,5000000\n"
BUNDLES = """
[regulation]
rules = "dutch-ftk"
policy_ratios = [1.0, 1.01, 1.02]
insurance_risk = 0.03
active_risk = 0.01

[funding]
rules = "uk"
technical_provisions = 0.01
buy_out = -0.001
"""
INDEXATION = {
    "limited increases": 'kind = "capped"\nmonth = 1\ncap = 0.04\nfloor = 0.0\n',
    "fixed increases": 'kind = "fixed"\nrate = 0.02\nmonth = 1\n',
    "personal pots": 'kind = "none"\n',
    "borrowed cash": 'kind = "none"\n',
}
# Bonds up to 120 % of the assets, on borrowed cash.
BORROWED = (
    ("Cash,cash,,,0.02,0,0.3", "Cash,cash,,,-0.2,-0.4,0.3"),
    ("0.25,0,0.7,Matching,0.2,0.9", "0.47,0,1.2,Matching,0.2,1.4"),
)
POTS = """[pots]
rules = "dutch-wtp"
allocation = "allocation.csv"
reserve = 0.05
fill_return = 0.1
"""
ALLOCATION = "age,protection,exposure\n20,0.2,1.5\n45,0.5,1.2\n60,0.8,0.7\n68,1,0.35\n"


def edited(text: str, kind: str) -> str:
    """The template's case with the edits of a user who wants this kind of fund."""
    table = rf"[plan.indexation]\n{INDEXATION[kind]}\n"
    text = re.sub(r"\[plan\.indexation\].*?(?=\[plan\.contribution\])", table, text, flags=re.S)
    text = re.sub(r"\[reconcile\].*?tolerance = 0\.001\n", "", text, flags=re.S)
    text = text.replace('return_kind = "total"', 'turnover = 0.5\nreturn_kind = "total"', 1)
    gone = ["lower_ratio", "upper_ratio"] + ["cap", "floor"] * (kind != "limited increases")
    text = re.sub(rf'"indexation_({"|".join(gone)})", ?', "", text)
    if kind == "limited increases":
        text = text.replace('# unit = "assets"', 'unit = "liability"', 1)
        text = text.replace('future_indexation = "none"', 'future_indexation = "capped"', 1)
    if kind != "personal pots":
        return text.replace("# schedule =", "schedule =", 1) + BUNDLES
    paid = '[plan.contribution]\nkind = "fixed"\nrate = 0.25\n\n'
    text = re.sub(r"\[plan\.contribution\].*?(?=\[liability\])", paid, text, flags=re.S)
    text = re.sub(r'"contribution_(floor|cap)", ?', "", text)
    return re.sub(r"\[frontier\].*?(?=\[training\])", POTS, text, flags=re.S)


@pytest.mark.parametrize("kind", INDEXATION)
def test_every_part_is_done_and_nothing_is_left_out(kind, tmp_path):
    folder = short_case(tmp_path / "case")
    assets = ASSETS
    for old, new in BORROWED if kind == "borrowed cash" else ():
        assert old in assets
        assets = assets.replace(old, new)
    (folder / "assets.csv").write_text(assets)
    (folder / "overlay.csv").write_text(OVERLAY)
    (folder / "recovery.csv").write_text(RECOVERY)
    (folder / "allocation.csv").write_text(ALLOCATION)
    file = folder / "case.toml"
    file.write_text(edited(file.read_text(), kind))
    result = solved(folder)
    assert result["status"] == "trained"
    assert result["failures"] == {}
    assert not any(result["dropped"].values())
    assert "present_mix_yearly" in result["references"]
    report = (folder / "run" / "report.html").read_text()
    assert 'class="missing"' not in report
    told = {"personal pots": "Solidarity reserve", "borrowed cash": "A weight below zero"}
    assert told.get(kind, "Required own funds") in report
