"""Tables written as TOML are read back as they were."""

import datetime
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from snapo.case.toml import to_toml

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
    with pytest.raises(TypeError, match="has no form in TOML"):
        to_toml({"x": None})
