"""Slips of units in an inventory: one note each, with the key and the number."""

import pytest
from tests.domains.inventory.inventory_cases import case

from snapo.case.load import load
from snapo.domains.inventory import DOMAIN

SPREAD = {"kind": "negative-binomial", "mean": 5.0}
SLIPS = {
    "a rate for a factor": (
        {"horizon": {"discount": 0.04}},
        "horizon.discount: discount is 0.04, outside 0.5 to 1: a factor per week is expected",
    ),
    "holding of a year in cents": (
        {"holding": 5200.0},
        "item.holding: holding_cost is 5,200 EUR/piece/week, outside 4e-05 to 40 EUR/piece/week: it "
        "must refer to one week and unit, and a missing unit costs 4.",
    ),
    "a shortage in thousands": (
        {"purchase": 5000.0, "holding": 1.0},
        "item.shortage: shortage_cost is 4 EUR/piece, outside 5 to 5,000,000 EUR/piece: a unit costs "
        "5000.",
    ),
    "a deviation in single pieces": (
        {"demand": SPREAD | {"deviation": 40.0}},
        "demand.deviation: demand_deviation is 40 piece/week, outside 0 to 25 piece/week",
    ),
    "a stock in single pieces": (
        {"stock": 20000.0},
        "item.stock: start_stock now is 20,000 piece, outside 0 to 5,000 piece: the mean demand",
    ),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_of_units_has_one_note(slip):
    changes, start = SLIPS[slip]
    (note,) = case(**changes).notes
    assert note.startswith(start)


def test_factors_of_a_season_in_percent_are_noted(tmp_path):
    (tmp_path / "season.csv").write_text("period,factor\n1,120\n2,80\n")
    season = {"file": "season.csv"}
    (note,) = case(season=season, folder=tmp_path).notes
    assert note.startswith("season.csv, line 2, column factor: season 1 is 120, outside 0.02 to 20")


def test_the_numbers_of_a_network_are_looked_at():
    file, data = load(DOMAIN.templates["line"] / "case.toml")
    assert not DOMAIN.read(file, data).notes
    data["place"][0]["demand"] = SPREAD | {"deviation": 40.0}
    data["place"][2]["holding"] = 4000.0
    first, second = DOMAIN.read(file, data).notes
    assert first.startswith("place[2].holding: holding_cost works is 4,000 EUR/pallet/week")
    assert second.startswith("place[0].demand.deviation: shop.demand_deviation is 40 pallet")
