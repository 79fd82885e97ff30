"""`[pots]` as it is read: the law at the date, allocations by age, and mistakes."""

import datetime
from importlib.resources import files

import numpy as np
import pytest
from tests.domains.pension.every_key import CASES, written

from snapo.case.error import CaseError
from snapo.domains.pension.read.case import resolve


def read(folder, **changes):
    data = {key: value for key, value in CASES["personal pots"].items() if value is not None}
    for name, change in changes.items():
        data[name] = (data.get(name) or {}) | change
    return resolve(written(folder), data)


def test_allocations_go_with_age_and_the_law_has_a_date(tmp_path):
    case = read(tmp_path)
    assert case.pots is not None
    # Active 60.5, deferred 55, pensioner 72, spouse 80.
    assert np.array_equal(case.pots.protection.used(), [[0.8, 0.2, 1.0, 1.0]] * 2)
    assert np.array_equal(case.pots.exposure.used(), [[0.7, 1.5, 0.3, 0.3]] * 2)
    rules = case.pots.rules
    assert rules.since == "2023-07-01"
    assert (rules.largest, rules.from_contributions, rules.from_excess_return) == (0.15, 0.1, 0.1)
    assert not case.plan.accruing


@pytest.mark.parametrize(
    ("change", "where", "words"),
    [
        ({"pots": {"fill_return": 0.2}}, "pots.fill_return", "at most 0.1"),
        ({"pots": {"fill_contribution": 0.11}}, "pots.fill_contribution", "at most 0.1"),
        ({"pots": {"largest": 0.2}}, "pots.largest", "at most 0.15"),
        ({"pots": {"reserve": 0.12, "largest": 0.1}}, "pots.reserve", "at most 0.1"),
        ({"pots": {"rules": "none.toml"}}, "pots.rules", "no such file"),
        ({"fund": {"valuation_date": datetime.date(2020, 1, 1)}}, "pots.rules", "no version"),
        ({"plan": {"open": True, "entry_age": 30.0}}, "plan.open", "must be false"),
        ({"liability": {"future_indexation": "full"}}, "liability.future_indexation", "none"),
        ({"liability": {"basis": "fixed", "rate": 0.02}}, "liability.basis", "risk-free or spread"),
        ({"regulation": {"rules": "dutch-ftk"}}, "regulation", "promised rights"),
    ],
)
def test_mistakes(change, where, words, tmp_path):
    with pytest.raises(CaseError) as error:
        read(tmp_path, **change)
    assert where in str(error.value)
    assert words in str(error.value)


def test_a_file_of_rules_must_be_next_to_the_case(tmp_path):
    """A run hashes and copies the files next to a case only."""
    own = (files("snapo.domains.pension.regulation") / "dutch_wtp.toml").read_text()
    (tmp_path / "law").mkdir()
    for name in ("law/mine.toml", "mine.txt", "mine.toml"):
        (tmp_path / name).write_text(own)
    with pytest.raises(CaseError, match=r"pots.rules: got 'law/mine.toml'.* not below it"):
        read(tmp_path, pots={"rules": "law/mine.toml"})
    with pytest.raises(CaseError, match=r"pots.rules: got 'mine.txt'.* .toml file"):
        read(tmp_path, pots={"rules": "mine.txt"})
    case = read(tmp_path, pots={"rules": "mine.toml"})
    assert case.pots is not None and case.pots.rules.since == "2023-07-01"
