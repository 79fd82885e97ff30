"""The Dutch standard model: the law's own example, its formulas by hand, and a fund in the large."""

import datetime
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from snapo.case.error import CaseError
from snapo.domains.pension.read.cells import TableReader
from snapo.domains.pension.read.tables import RegulationTable
from snapo.domains.pension.regulation.in_force import read_regulation
from snapo.domains.pension.regulation.position import (
    Losses,
    correlated,
    currency_loss,
    equity_loss,
    shifted_discount,
    total,
)


def read(day=datetime.date(2024, 12, 31), **keys):
    place = TableReader(Path("case.toml"), "regulation", [], set())
    found = read_regulation(place, RegulationTable(**({"rules": "dutch-ftk"} | keys)), day)
    assert found is not None
    return found


RULES = read().rules


def test_the_example_of_annex_3():
    """A rate of 4 % at 16 years falls by 0.96 and rises by 1.28 percentage points."""
    years, discount = np.array([0.0, 16.0]), np.array([1.0, 1.04**-16])
    for name, change in (("fall", -0.0096), ("rise", 0.0128)):
        moved = shifted_discount(RULES, name, years, discount)
        assert moved[0] == 1
        assert moved[1] ** (-1 / 16) - 1 - 0.04 == pytest.approx(change, abs=1e-15)


def test_the_root_of_article_2():
    """S = 10, 20, 5, 0, 6, 3 and 2: 902 under the root where rates fall, 694 where they rise."""
    losses = Losses(10.0, 20.0, 5.0, 0.0, 6.0, 3.0, 2.0, True)
    assert total(RULES, losses) == pytest.approx(np.sqrt(902), rel=1e-15)
    assert total(RULES, replace(losses, falling=False)) == pytest.approx(np.sqrt(694), rel=1e-15)


def test_groups_of_shares_and_currencies_are_correlated():
    assert correlated([3.0, 4.0], 0.0) == pytest.approx(5.0)
    assert correlated([3.0, 4.0], 1.0) == pytest.approx(7.0)
    held = {"developed": 100.0, "emerging": 50.0, "unlisted-property": 20.0, "none": 999.0}
    parts = np.array([30.0, 20.0, 3.0])
    by_hand = np.sqrt((parts**2).sum() + 2 * 0.75 * (600 + 90 + 60))
    assert equity_loss(RULES, held) == pytest.approx(by_hand)
    # 20 % of two developed currencies at 0.5, 35 % of an emerging one at 0.25 to them.
    developed = 0.2 * np.sqrt(10**2 + 20**2 + 10 * 20)
    by_hand = np.sqrt(developed**2 + 3.5**2 + 2 * 0.25 * developed * 3.5)
    assert currency_loss(RULES, [10.0, 20.0, 10.0], [False, False, True]) == pytest.approx(by_hand)


def test_the_factors_are_those_of_the_table_and_constant_beyond_it():
    assert RULES.since == "2015-01-01"
    assert RULES.factors["rise"][[0, 4, 9]].tolist() == [2.05, 1.49, 1.34]
    assert RULES.factors["real_fall"][[0, 9, 15]].tolist() == [0.75, 0.88, 0.88]
    discount = 1.02 ** -np.array([25.0, 80.0])
    moved = shifted_discount(RULES, "fall", np.array([25.0, 80.0]), discount)
    assert moved == pytest.approx(1.0152 ** -np.array([25.0, 80.0]), rel=1e-14)


def test_a_change_of_law_is_a_change_of_file(tmp_path):
    own = Path(__file__).parents[4] / "src/snapo/domains/pension/regulation/dutch_ftk.toml"
    text = own.read_text()
    later = text.replace("2015-01-01", "2030-01-01").replace("minimum = 0.04", "minimum = 0.05")
    (tmp_path / "law.toml").write_text(text + later[later.index("[[version]]") :])
    place = TableReader(tmp_path / "case.toml", "regulation", [], set())
    for year, minimum in ((2029, 0.04), (2030, 0.05)):
        table = RegulationTable(rules="law.toml")
        found = read_regulation(place, table, datetime.date(year, 6, 1))
        assert found is not None
        assert found.rules.minimum == minimum


@pytest.mark.parametrize(
    "keys, named",
    [
        ({"rules": "dutch-ftkk"}, "dutch-ftk"),
        ({"policy_ratios": [1.0] * 13}, "12 months"),
    ],
)
def test_mistakes_are_named(keys, named):
    with pytest.raises(CaseError, match=named):
        read(**keys)


def test_before_the_law_there_is_none():
    with pytest.raises(CaseError, match="no version is in force on 2014-12-31"):
        read(datetime.date(2014, 12, 31))


def test_shares_sold_short_lose_nothing_in_a_fall_and_offset_nothing():
    """A fall of developed shares costs its own part of the long ones alone."""
    fall = RULES.falls["developed"]
    assert equity_loss(RULES, {"developed": 100.0, "emerging": -40.0}) == pytest.approx(100 * fall)
    assert equity_loss(RULES, {"developed": -100.0}) == 0
