"""The tables of a run as a workbook: native numbers, no formulas, charts."""

import json

import pytest

from snapo.study import run_folder
from snapo.study.workbook import write_run

openpyxl = pytest.importorskip("openpyxl", reason="workbooks need the extra `xlsx`")


@pytest.fixture
def book(tmp_path):
    table = {"value": 12.5, "paths": {"evaluate": 64}, "notes": ["=1+1"], "bound": None}
    (tmp_path / run_folder.RESULT).write_text(json.dumps(table))
    (tmp_path / run_folder.HISTORY).write_text("step,objective,exact\n1,-9.5,nan\n2,-10.25,-9.0\n")
    rows = "price,2025-01,EUR,3.5,0.1\nprice,2025-02,EUR,4.5,0.1\n"
    (tmp_path / run_folder.SENSITIVITIES).write_text(f"input,label,unit,held,held_error\n{rows}")
    (tmp_path / "profile.csv").write_text("day,mean,=x\n2025-01-01,1.5,a\n2025-01-02,2.5,@b\n")
    return openpyxl.load_workbook(write_run(tmp_path))


def test_every_table_has_a_sheet_with_native_cells(book):
    assert book.sheetnames == ["contents", "result", "history", "profile", "sensitivities"]
    result = {row[0].value: row[1] for row in book["result"].iter_rows(2)}
    assert result["value"].value == 12.5 and result["paths, evaluate"].value == 64
    assert result["notes"].data_type == "s" and result["notes"].value == "=1+1"
    history = list(book["history"].iter_rows(min_row=2, values_only=True))
    assert history == [(1, -9.5, None), (2, -10.25, -9)]
    profile = book["profile"]
    assert profile["A2"].is_date and profile["A2"].number_format == "yyyy-mm-dd"
    assert profile["C1"].data_type == "s" and profile["C3"].value == "@b"


def test_tables_have_native_charts_and_number_formats(book):
    for name in ("history", "profile", "sensitivities"):
        assert len(book[name]._charts) == 1, name
    assert book["sensitivities"]["D2"].number_format == "0.0000"
    assert book["sensitivities"].freeze_panes == "A2"


PART = {
    "today": {
        "spot": 20.5,
        "action": "=inject",
        "ladder": [
            {"inventory": 0.0, "action": "wait", "notes": ["a", "b"]},
            {"inventory": 10.0, "action": "sell", "tables": {"mean": [1.0, 2.0]}},
        ],
        "by_year": {"years": [1, 2, 3], "mean": [0.5, 0.25, None], "edges": [0.0, 1.0, 2.0, 3.0]},
        "weights": [[0.5, 0.5], [0.25, 0.75]],
        "quantiles": {"cash": {"p05": 1.0, "p95": 2.0}, "water": {"p05": 3.0, "p95": 4.0}},
    },
    "profile": {"name [as a] very long name that no sheet can have": {"mean": [1.0, 2.0]}},
}


def test_the_tables_of_parts_are_sheets_too(tmp_path):
    (tmp_path / run_folder.RESULT).write_text('{"value": 1.0}')
    (tmp_path / run_folder.PARTS).mkdir()
    (tmp_path / run_folder.PARTS / "some-part.json").write_text(json.dumps(PART))
    (tmp_path / run_folder.PARTS / "damaged.json").write_text("{")
    book = openpyxl.load_workbook(write_run(tmp_path))
    found = {
        sheet.title: list(sheet.iter_rows(values_only=True))
        for sheet in book.worksheets
        if sheet.title not in ("contents", "result")
    }
    assert found["today"] == [("what", "value"), ("spot", 20.5), ("action", "=inject")]
    assert book["today"]["B3"].data_type == "s"
    assert found["today ladder"] == [
        ("inventory", "action", "notes"), (0, "wait", "a; b"), (10, "sell", None),
    ]  # fmt: skip
    assert found["today ladder sell tables"] == [("row", "mean"), (1, 1), (2, 2)]
    rows = [("row", "years", "mean"), (1, 1, 0.5), (2, 2, 0.25), (3, 3, None)]
    assert found["today by_year"] == rows
    assert found["today by_year edges"][-1] == (4, 3)
    assert found["today weights"] == [("row", "1", "2"), (1, 0.5, 0.5), (2, 0.25, 0.75)]
    names = [("name", "p05", "p95"), ("cash", 1, 2), ("water", 3, 4)]
    assert found["today quantiles"] == names
    (long,) = [name for name in found if name.startswith("profile")]
    assert len(long) <= 31
    contents = dict(book["contents"].iter_rows(values_only=True))
    assert contents["today weights"] == "parts/some-part.json, today, weights"
    assert set(contents) == {"sheet", "result", *found}
