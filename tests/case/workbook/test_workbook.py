"""Cases as workbooks: TOML, workbook and TOML again are equal; formulas are their stored values."""

import datetime
from pathlib import Path

import openpyxl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.case.workbook import Unreadable, lines, tables, unpacked, write_workbook
from snapo.study import commands

KEYS = st.text("abcäxyz_-. \"'[]=", min_size=1, max_size=6)
VALUES = st.one_of(
    st.booleans(),
    st.integers(-(2**62), 2**62),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(["=1+1", "_x0041_", " a ", "2021-04-01", "\r\n", "+49", "1e5", "TRUE"]),
    st.dates(datetime.date(1600, 1, 1)),
    st.just([]),
    st.just({}),
    st.lists(st.integers(0, 9), min_size=1, max_size=3),
)
TREES = st.recursive(
    VALUES,
    lambda inner: st.one_of(
        st.dictionaries(KEYS, inner, min_size=1, max_size=3),
        st.lists(st.dictionaries(KEYS, inner, min_size=1, max_size=2), min_size=1, max_size=2),
    ),
    max_leaves=8,
)
NAMES = st.sampled_from(["market", "contract", "units", "fund", "plan"])


def same(one, other) -> bool:
    """Equal, with NaN equal to itself and truth values apart from numbers."""
    if isinstance(one, dict):
        return (
            isinstance(other, dict)
            and set(one) == set(other)
            and all(same(one[k], other[k]) for k in one)
        )
    if isinstance(one, list):
        return isinstance(other, list) and len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, bool) or isinstance(other, bool):
        return one is other
    return one == other or (one != one and other != other)


@settings(max_examples=60, deadline=None)
@given(st.dictionaries(KEYS, TREES, max_size=4))
def test_tables_become_lines_and_tables_again(data):
    assert same(tables(list(lines(data))), data)


@settings(max_examples=8, deadline=None)
@given(data=st.dictionaries(NAMES, TREES, min_size=1, max_size=3))
def test_toml_workbook_and_toml_are_equal(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("book")
    write_workbook(folder, data, folder / "mine.xlsx")
    found = load(folder / "mine.xlsx")[1]
    assert set(found) == set(data) and all(same(found[key], data[key]) for key in data)


@pytest.mark.prove
@pytest.mark.parametrize(
    "kind, size", [("gas-storage", None), ("pension", "small"), ("pharma", None), ("own", None)]
)
def test_every_example_is_the_same_case_as_a_workbook(kind, size, tmp_path):
    commands.new(kind, tmp_path / "plain", size)
    (file, *_) = commands.new_workbook(kind, tmp_path / "book", size)
    assert same(load(file)[1], load(tmp_path / "plain")[1])
    plain, book = tmp_path / "plain", tmp_path / "book" / "case"
    for each in plain.glob("*.csv"):
        assert cells(each) == cells(book / each.name)
    with pytest.raises(CaseError, match="this file exists"):
        commands.new_workbook(kind, tmp_path / "book", size)


def cells(file: Path) -> list[list]:
    """The numbers and texts of a CSV."""

    def number(text: str):
        try:
            return float(text)
        except ValueError:
            return text

    text = [line for line in file.read_text().splitlines() if line and not line.startswith("#")]
    return [[number(cell.strip()) for cell in line.split(",")] for line in text]


CONTRACT = {"start": datetime.date(2021, 4, 1), "inventory": 1500.0, "volume_unit": "MWh", "end": 1}


def book(folder: Path, change) -> Path:
    write_workbook(folder, {"kind": "gas-storage", "contract": CONTRACT}, folder / "case.xlsx")
    made = openpyxl.load_workbook(folder / "case.xlsx")
    change(made)
    made.save(folder / "case.xlsx")
    return folder / "case.xlsx"


def _set(sheet: str, cell: str, value):
    return lambda made: made[sheet].__setitem__(cell, value)


@pytest.mark.parametrize(
    "change, words",
    [
        (_set("contract", "B4", "=1000+500"), "sheet contract, cell B4"),
        (_set("contract", "A4", "contract.."), "is not a key"),
        (_set("contract", "A5", "contract.start"), "appears twice"),
        (_set("contract", "A1", "name"), "must have the columns key, value"),
        (_set("contract", "B4", None), "sheet contract, line 4"),
        (lambda made: made.create_sheet("...csv"), "such as curve.csv"),
        (lambda made: made.create_sheet("other.csv"), "the sheet is empty"),
    ],
)
def test_a_mistake_in_a_workbook_is_named(change, words, tmp_path):
    with pytest.raises(CaseError) as told:
        unpacked(book(tmp_path, change))
    assert words in str(told.value)


def test_what_is_no_workbook_is_refused(tmp_path):
    (tmp_path / "case.xlsx").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(CaseError, match="not a workbook"):
        load(tmp_path / "case.xlsx")
    with pytest.raises(Unreadable):
        tables([("a[1].b", 1, "")])
