"""Names of parts under `[report]`."""

from pathlib import Path

import pytest

from snapo.case.error import CaseError
from snapo.case.parts import PartNames, known_parts, names_of_parts
from snapo.case.table import CaseTable, parse

FILE, KNOWN = Path("case.toml"), ("training", "today", "frontier")


class ReportTable(CaseTable):
    parts: PartNames = names_of_parts("today")


def test_known_parts_are_taken_as_they_are_named():
    assert known_parts(FILE, ["today", "training"], KNOWN) == ("today", "training")
    assert known_parts(FILE, [], KNOWN, {"frontier": "a reason"}) == ()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (
            ["today", "fronteer"],
            "case.toml, report.parts[1]: got 'fronteer'; there is no such part; "
            "the nearest known part is frontier.",
        ),
        (
            ["wheat"],
            "case.toml, report.parts[0]: got 'wheat'; there is no such part; "
            "the known parts are training, today, frontier.",
        ),
        (
            ["frontier"],
            "case.toml, report.parts[0]: got 'frontier'; a run of this case has no such part: "
            "the case has no [frontier].",
        ),
    ],
)
def test_other_names_are_refused(names, message):
    with pytest.raises(CaseError) as caught:
        known_parts(FILE, names, KNOWN, {"frontier": "the case has no [frontier]"})
    assert str(caught.value) == message


@pytest.mark.parametrize("value", ["today", [""], [1], {"today": True}])
def test_what_is_no_list_of_names_is_refused(value):
    with pytest.raises(CaseError, match=r'report.parts: .* names of parts such as \["today"\]'):
        parse(ReportTable, {"parts": value}, "case.toml", "report")
