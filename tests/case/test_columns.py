"""The same table as CSV, as a European CSV, as Parquet and from frames: read alike, to the digit."""

import datetime
import math
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas
import polars
import pyarrow
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import snapo
from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError
from snapo.case.table import TableContext

DAYS = st.dates(datetime.date(1950, 1, 1), datetime.date(2150, 1, 1))
PRICES = st.floats(-1e9, 1e9, allow_subnormal=False)
TEXTS = st.text("abc XYZ,;\"'äß", min_size=1).map(str.strip).filter(lambda x: x and x[0] not in "#")
TABLE = st.lists(st.tuples(DAYS, PRICES, TEXTS), min_size=1, max_size=8)
COLUMNS = ("date", "price", "name")


def read(folder: Path, name: str) -> list[tuple]:
    section = TableContext(folder / "case.toml", "market", [])
    rows = read_rows(FileReference(section, "curve", name), COLUMNS)
    return [(row.day("date"), row.number("price"), row.cells["name"]) for row in rows]


def european(table) -> str:
    """As a spreadsheet of the continent writes it: days first, decimal commas, a mark in front."""
    lines = ["\ufeffdate;price;name"]
    for day, price, name in table:
        number = repr(price).replace(".", ",")
        quoted = '"' + name.replace('"', '""') + '"'
        lines.append(f"{day.day:02}.{day.month:02}.{day.year};{number};{quoted}")
    return "\r\n".join(lines) + "\r\n"


@settings(max_examples=25, deadline=None)
@given(TABLE)
def test_every_way_to_write_a_table_is_read_alike(table):
    columns = {name: list(each) for name, each in zip(COLUMNS, zip(*table))}
    frames = (pandas.DataFrame(columns), polars.DataFrame(columns), pyarrow.table(columns))
    with TemporaryDirectory() as made:
        folder = Path(made)
        for frame in frames:
            for name in ("curve.csv", "curve.parquet"):
                snapo.write_table(frame, folder / name)
                assert read(folder, name) == table
        # A number without a fraction could be a thousand there; such a file is refused in words.
        if all("." in repr(price) and "e" not in repr(price) for _, price, _ in table):
            (folder / "euro.csv").write_bytes(european(table).encode())
            try:
                assert read(folder, "euro.csv") == table
            except CaseError as error:
                assert "euro.csv" in str(error)


def test_missing_cells_midnights_and_whole_numbers(tmp_path):
    frame = pandas.DataFrame(
        {
            "date": pandas.to_datetime(["2024-12-31", "2025-01-01"]),
            "price": [1, 2],
            "name": ["a", None],
        }
    )
    for name in ("curve.csv", "curve.parquet"):
        snapo.write_table(frame, tmp_path / name)
        days = [datetime.date(2024, 12, 31), datetime.date(2025, 1, 1)]
        assert read(tmp_path, name) == [(days[0], 1.0, "a"), (days[1], 2.0, "")]


def test_a_mistake_in_a_parquet_file_has_its_line(tmp_path):
    frame = polars.DataFrame({"date": ["2024-12-31", "soon"], "price": [1.0, 2.0], "name": "a"})
    snapo.write_table(frame, tmp_path / "curve.parquet")
    with pytest.raises(CaseError, match="line 3, column date"):
        read(tmp_path, "curve.parquet")
    (tmp_path / "curve.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(CaseError, match="not a Parquet file"):
        read(tmp_path, "curve.parquet")


def test_what_is_no_frame_or_no_such_file_is_refused(tmp_path):
    with pytest.raises(TypeError, match="a list is not a data frame"):
        snapo.write_table([1, 2], tmp_path / "curve.csv")
    with pytest.raises(ValueError, match=r"must end in \.csv or \.parquet"):
        snapo.write_table(polars.DataFrame({"a": [1]}), tmp_path / "curve.xls")


@pytest.mark.parametrize(
    ("low", "high", "cell", "allowed"),
    [
        (-math.inf, math.inf, "much", "a finite number, written like 12.5"),
        (-math.inf, 5.0, "7", "a number of at most 5"),
        (8.0, math.inf, "7", "a number of at least 8"),
        (8.0, 9000.0, "7", "a number from 8 to 9,000"),
    ],
)
def test_a_cell_out_of_its_range_is_refused_with_both_ends(low, high, cell, allowed):
    row = Row("prices.csv", 3, {"price": cell})
    with pytest.raises(CaseError, match=f"line 3, column price: .* must be {allowed}"):
        row.number("price", low, high)


@pytest.mark.parametrize("name", ["data/curve.csv", "data/../curve.csv", "data/curve.parquet"])
def test_a_case_may_not_name_a_file_below_its_folder(name, tmp_path):
    """Runs hash and copy the files next to a case only: with an edited data/curve.csv, --resume
    would return the old value, and the copy in the run would lack the file."""
    (tmp_path / "data").mkdir()
    for folder in (tmp_path, tmp_path / "data"):
        (folder / "curve.csv").write_text("date,price,name\n2025-01-01,1.5,a\n")
        (folder / "curve.parquet").write_bytes(b"")
    with pytest.raises(CaseError, match=r"not below it; move the file there and write 'curve\."):
        read(tmp_path, name)
    assert read(tmp_path, "curve.csv") == [(datetime.date(2025, 1, 1), 1.5, "a")]
    section = TableContext(tmp_path / "book.toml", "cases", [])
    rows = read_rows(FileReference(section, "table", "data/curve.csv", below=True), COLUMNS)
    assert rows[0].number("price") == 1.5
