"""Named scenarios: kept in the run folder and nowhere else, whatever they are called."""

import csv
import io
import json

import pytest

from snapo.live.scenarios import FOLDER, MAXIMUM, Refused, SavedScenarios, slug

VALUE = {"value": 12.5, "standard_error": 0.5, "change": 1.0, "change_error": 0.1}
HOSTILE = (
    "../../etc/passwd", "..", ".", "/", "\\..\\..", "a/b", "C:\\x", "nul", "\x00", "\u202eabc", "-rf",
    "~", "$HOME", "`id`", "%2e%2e%2f", "name\nwith lines", "<img src=x onerror=alert(1)>",
    "'; DROP TABLE", "=1+1", "   ", "", "🙂", "case", "x" * 5000,
)  # fmt: skip


@pytest.fixture
def kept(tmp_path):
    (tmp_path / "run").mkdir()
    return SavedScenarios(tmp_path / "run")


def test_a_scenario_comes_back_as_it_was(kept):
    found = kept.keep("High winter", {"forward_curve": [1.0, 2.5]}, {"value": VALUE, "x": 1})
    (record,) = kept.all()
    assert found == record["id"] == "high-winter" and record["name"] == "High winter"
    assert record["values"] == {"forward_curve": [1.0, 2.5]} and record["value"] == VALUE
    assert "x" not in record


def test_the_same_name_again_takes_its_place(kept):
    kept.keep("Low", {"a": [1.0]}, {})
    kept.keep("low", {"a": [2.0]}, {})
    (record,) = kept.all()
    assert record["values"] == {"a": [2.0]}


@pytest.mark.parametrize("name", HOSTILE)
def test_no_name_leads_out_of_the_folder(kept, tmp_path, name):
    before = sorted(tmp_path.rglob("*"))
    try:
        found = kept.keep(name, {}, {"value": VALUE})
    except Refused:
        assert sorted(tmp_path.rglob("*")) == before
        return
    made = [each for each in tmp_path.rglob("*") if each not in before]
    folder = tmp_path / "run" / FOLDER
    assert all(each.is_relative_to(folder) or each == folder for each in made)
    assert kept.folder_of(found).parent == folder
    kept.forget(found)
    assert kept.all() == []


@pytest.mark.parametrize("found", ["..", "../run", "", "/etc", "A B", "none", "a/../a"])
def test_an_id_that_is_none_is_refused(kept, found):
    kept.keep("a", {}, {})
    for ask in (kept.folder_of, kept.forget, kept.zipped, kept.one):
        with pytest.raises(Refused):
            ask(found)


def test_a_damaged_scenario_is_passed_over(kept):
    kept.keep("good", {}, {})
    (kept.folder / "bad").mkdir()
    (kept.folder / "bad" / "scenario.json").write_text("{")
    (kept.folder / "other").mkdir()
    (kept.folder / "other" / "scenario.json").write_text(json.dumps({"id": "good", "values": {}}))
    assert [each["id"] for each in kept.all()] == ["good"]


def test_a_table_for_a_spreadsheet_holds_no_formula(kept):
    kept.keep("=HYPERLINK(1)", {"curve": [1.0]}, {"value": VALUE})
    header, row = csv.reader(io.StringIO(kept.table()))
    assert row[0] == "'=HYPERLINK(1)" and row[header.index("value")] == "12.5"


def test_there_is_an_end_to_them(kept, monkeypatch):
    monkeypatch.setattr("snapo.live.scenarios.MAXIMUM", 2)
    kept.keep("a", {}, {})
    kept.keep("b", {}, {})
    kept.keep("b", {}, {})
    with pytest.raises(Refused, match="delete one"):
        kept.keep("c", {}, {})
    assert MAXIMUM == 200 and slug("Ä ö--ß x") == "a-o-x"


def test_a_scenario_alone_holds_every_number(kept):
    rows = [{"label": "2021-05", "value": 7.0, "low": 6.0, "high": 8.0}]
    deltas = [{"input": "curve", "effect": 3.0, "low": 2.5, "high": 3.5, "rows": rows}]
    found = kept.keep("a", {"curve": [1.0, 2.5]}, {"value": VALUE, "deltas": deltas})
    table = list(csv.reader(io.StringIO(kept.one(found))))
    assert table[1] == ["value", "", "", "12.5", "0.5", "", ""]
    assert ["moved", "curve", "2", "2.5", "", "", ""] in table
    assert table[-1] == ["delta", "curve", "2021-05", "7.0", "", "6.0", "8.0"]
