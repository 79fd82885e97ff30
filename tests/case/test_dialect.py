"""Files as spreadsheets of other countries write them: read where they leave no doubt."""

import datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError
from snapo.case.table import TableContext


def rows_of(folder: Path, text: str) -> tuple[list[Row], list[str]]:
    """The rows of a file with the columns date and price, and the notes of the case."""
    (folder / "curve.csv").write_bytes(text.encode("utf-8"))
    notes: list[str] = []
    section = TableContext(folder / "case.toml", "market", notes)
    return read_rows(FileReference(section, "curve", "curve.csv"), ("date", "price")), notes


def refused(folder: Path, text: str) -> str:
    with pytest.raises(CaseError) as caught:
        for row in rows_of(folder, text)[0]:
            row.day("date"), row.number("price")
    return str(caught.value)


GERMAN = "\ufeffdate;price\r\n01.04.2021;16,61\r\n30.04.2021;1.015,68\r\n02.05.2021;-17\r\n"


def test_a_file_of_a_german_spreadsheet(tmp_path):
    rows, notes = rows_of(tmp_path, GERMAN)
    assert [row.number("price") for row in rows] == [16.61, 1015.68, -17]
    days = [datetime.date(2021, 4, 1), datetime.date(2021, 4, 30), datetime.date(2021, 5, 2)]
    assert [row.day("date") for row in rows] == days
    assert notes == [
        "curve.csv was read with semicolons between the columns, commas as decimal marks."
    ]


def test_tabs_quotes_midnights_and_months(tmp_path):
    rows, notes = rows_of(tmp_path, '"date"\t"price"\n2021-04-01 00:00:00\t16.61\n')
    assert rows[0].day("date") == datetime.date(2021, 4, 1) and rows[0].number("price") == 16.61
    assert notes == ["curve.csv was read with tabs between the columns."]
    rows, notes = rows_of(tmp_path, "date;price\n04/2021;16,5\n10/2021;2\n")
    assert [row.month("date") for row in rows] == [(2021, 4), (2021, 10)]


def test_days_with_slashes_are_read_where_one_of_them_tells_the_order(tmp_path):
    rows, notes = rows_of(tmp_path, "date,price\n04/05/2021,1\n13/05/2021,2\n")
    assert rows[0].day("date") == datetime.date(2021, 5, 4)
    assert notes == ["curve.csv was read with days before months."]
    rows, notes = rows_of(tmp_path, "date,price\n04/05/2021,1\n04/13/2021,2\n")
    assert rows[0].day("date") == datetime.date(2021, 4, 5)
    assert notes == ["curve.csv was read with months before days."]


def test_a_plain_file_has_no_note(tmp_path):
    rows, notes = rows_of(tmp_path, "date,price\n2021-04-01,1234.5\n")
    assert rows[0].number("price") == 1234.5 and not notes


@pytest.mark.parametrize(
    ("text", "place", "reason"),
    [
        ("date;price\n01.04.2021;1,5\n02.04.2021;1.5\n", "line 2, column price", "and 1.5 a point"),
        ("date;price\n01.04.2021;1.234\n", "line 2, column price", "decimals or thousands"),
        ("date;price\n01.04.2021;1,234\n", "line 2, column price", "decimals or thousands"),
        ("date,price\n04/05/2021,1\n", "line 2, column date", "are ambiguous"),
        (
            "date,price\n13/05/2021,1\n05/13/2021,1\n",
            "line 3, column date",
            "the month comes first, but in 13/05/2021 the day",
        ),
        ("date;price\n31.02.2021;1\n", "line 2, column date", "no such day"),
        ('date,price\n2021-04-01,"1,5"\n', "line 2, column price", "written like 12.5"),
        ("date;price\n01.04.21;1\n", "line 2, column date", "YYYY-MM-DD"),
    ],
)
def test_what_could_mean_two_things_is_refused(tmp_path, text, place, reason):
    message = refused(tmp_path, text)
    assert "curve.csv" in message and place in message and reason in message


@given(
    st.lists(
        st.tuples(
            st.dates(datetime.date(1900, 1, 1), datetime.date(2200, 1, 1)),
            st.integers(-(10**9), 10**9),
        ),
        min_size=1,
        max_size=8,
    )
)
def test_a_european_file_says_the_same_as_a_plain_one(tmp_path_factory, given):
    folder = tmp_path_factory.mktemp("dialect")
    plain = "date,price\n" + "".join(f"{day},{cents / 100:.2f}\n" for day, cents in given)
    european = "date;price\n" + "".join(
        f"{day.day:02}.{day.month:02}.{day.year};" + f"{cents / 100:,.2f}".translate(SWAP) + "\n"
        for day, cents in given
    )
    one, other = (
        [(row.day("date"), row.number("price")) for row in rows_of(folder, text)[0]]
        for text in (plain, european)
    )
    assert one == other


SWAP = str.maketrans(",.", ".,")
