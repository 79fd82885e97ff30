"""The case of a run is read again with the keys that were recorded."""

import datetime

import pytest

from snapo.study.prepare import _as_recorded, _plain


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (datetime.date(2026, 5, 1), datetime.date(2026, 5, 4)),
        (datetime.datetime(2026, 5, 1), datetime.datetime(2026, 5, 4, 12)),
        (1.0, 2),
    ],
)
def test_a_recorded_value_has_the_type_of_that_in_the_file(old, new):
    """A date with a time, as a contract by the hour has it, stays one."""
    result = _as_recorded({"contract": {"end": old}}, _plain({"contract": {"end": new}}))
    assert result == {"contract": {"end": new}} and type(result["contract"]["end"]) is type(new)
