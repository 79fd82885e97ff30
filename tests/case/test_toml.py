"""Tables written as TOML are read back as they were."""

import datetime
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.case.toml import impossible_moment, to_toml

TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**63), 2**63 - 1)
DATES = st.dates(datetime.date(1900, 1, 1))
PLAIN = TEXTS | NUMBERS | st.booleans() | DATES
VALUES = st.recursive(
    PLAIN,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=12,
)


@given(st.dictionaries(TEXTS, VALUES, max_size=5))
def test_what_was_written_is_read(tables):
    assert tomllib.loads(to_toml(tables)) == tables


def test_keys_of_a_table_stand_before_the_tables_in_it():
    tables = {"plan": {"cap": {"high": 1.0}, "age": 67.0}, "title": 'a "b"\n', "x": [{"a": 1}, {}]}
    assert tomllib.loads(to_toml(tables)) == tables


def test_a_value_that_toml_does_not_have_is_refused():
    with pytest.raises(TypeError, match="cannot be written in TOML"):
        to_toml({"x": None})


CASE = """title = "2021-13-01"  # until 2021-14-01
[contract]
start = {}
end = 2022-01-01
[[contract.nomination]]
holidays = [  # 2021-13-03
  2021-12-24, {}
]
"""


@pytest.mark.parametrize(
    ("start", "holiday", "where", "got", "why"),
    [
        ("2021-13-01", "2021-12-25", "line 3, contract.start", "2021-13-01", "no month 13"),
        ("2021-00-01", "2021-12-25", "line 3, contract.start", "2021-00-01", "no month 00"),
        ("2021-11-31", "2021-12-25", "line 3, contract.start", "2021-11-31", "2021 has 30 days"),
        ("2021-1-1", "2021-12-25", "line 3, contract.start", "2021-1-1", "date; a date is YYYY-MM"),
        ("0000-01-01", "2021-12-25", "line 3, contract.start", "0000-01-01", "no year 0000"),
        ("2021-01-01 25:00:00", "2021-12-25", "line 3, contract.start", "2021-01-01 25:00:00",
         "no hour 25"),
        ("12:00:61", "2021-12-25", "line 3, contract.start", "12:00:61", "time: there is no second"),
        ("2021-01-01", "2021-02-30", "line 7, contract.nomination.holidays", "2021-02-30",
         "February 2021 has 28 days"),
    ],
)  # fmt: skip
def test_a_date_that_does_not_exist_is_named_with_its_key(
    start, holiday, where, got, why, tmp_path
):
    (tmp_path / "case.toml").write_text(CASE.format(start, holiday))
    with pytest.raises(CaseError) as refused:
        load(tmp_path)
    assert (refused.value.where, refused.value.value) == (where, got)
    assert "this is not a " in refused.value.allowed and why in refused.value.allowed
    assert "a date is YYYY-MM-DD and a time hh:mm:ss" in refused.value.allowed


@given(st.dates(datetime.date(1, 1, 1)), st.times())
def test_dates_and_times_that_exist_are_no_mistake(day, time):
    moment = datetime.datetime.combine(day, time)
    assert impossible_moment(f"[{day}, {time}, {moment}, {moment.isoformat()}Z, 1.5, -7]") is None
