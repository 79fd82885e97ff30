"""`--set key=value`: values as TOML writes them, places by key, number or name."""

import datetime

import pytest

from snapo.case.error import CaseError
from snapo.study.assign import assigned

DATA = {
    "title": "Sums",
    "contract": {"inventory": 1000, "rates": [1.0, 2.0]},
    "assets": [{"name": "equity", "weight": 0.4}, {"name": "bonds", "weight": 0.6}],
}


def put(*assignments):
    return assigned(DATA, assignments)[0]


def test_values_are_toml():
    assert put("contract.inventory=2000")["contract"]["inventory"] == 2000
    assert put("contract.rates=[3, 4.5]")["contract"]["rates"] == [3, 4.5]
    assert put('title="a = b"')["title"] == "a = b"
    assert put("start=2027-04-01")["start"] == datetime.date(2027, 4, 1)
    assert put("contract.open = true")["contract"]["open"] is True
    assert DATA["contract"]["inventory"] == 1000, "the tables of the case stay as they are"


def test_elements_by_number_and_by_name():
    assert put("assets.bonds.weight=0.5")["assets"][1]["weight"] == 0.5
    assert put("assets.0.weight=0.5")["assets"][0]["weight"] == 0.5
    assert put("contract.rates.1=9")["contract"]["rates"] == [1.0, 9]


def test_tables_are_made_and_the_last_one_counts():
    data, paths = assigned(DATA, ["training.seed=1", "training.seed=2"])
    assert data["training"] == {"seed": 2}
    assert paths == {"training.seed"}


@pytest.mark.parametrize(
    ("assignment", "clause"),
    [
        ("contract.inventory", "such as contract.inventory=2000"),
        ("=3", "such as contract.inventory=2000"),
        ("contract..inventory=3", "such as contract.inventory=2000"),
        ("title=Other", "text needs quotation marks; in a shell: --set 'title=\"Other\"'"),
        (
            "contract.start=2021-13-01",
            "contract.start: got 2021-13-01; this is not a date: there is "
            "no month 13; a date is YYYY-MM-DD and a time hh:mm:ss, without quotation marks.",
        ),
        (
            "contract.start=2021-02-29",
            "got 2021-02-29; this is not a date: February 2021 has 28 days",
        ),
        (
            "contract.start=2021-01-01T24:00:00",
            "this is not a date: there is no hour 24; a date is",
        ),
        ("auction.at=07:60:00", "got 07:60:00; this is not a time: there is no minute 60; a date"),
        ("contract.start=31.12.2024", "got 31.12.2024; this is not a date; a date is YYYY-MM-DD"),
        (
            "holidays=[2021-01-01, 2021-04-31]",
            "got 2021-04-31; this is not a date: April 2021 has 30",
        ),
        ("contract.inventory=", "got nothing; this is not a valid value in TOML"),
        ("contract.rates=[1,", "this is not a valid value in TOML"),
        ("contract.inventory=1\nkind = 2", "this is not a valid value in TOML"),
        ("contract.inventory.low=3", "contract.inventory is a value, not a table with keys"),
        (
            "contract.rates.2=3",
            "got element 2; the array has 2 elements, which are numbered from 0",
        ),
        ("assets.bond.weight=1", "the nearest known key is bonds"),
        ("assets.-1.weight=1", "got element -1"),
    ],
)
def test_a_bad_path_or_value_is_one_clear_message(assignment, clause):
    with pytest.raises(CaseError) as caught:
        put(assignment)
    assert clause in str(caught.value)
    assert str(caught.value).startswith("--set")
