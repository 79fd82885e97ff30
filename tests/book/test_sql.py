"""Queries of the documentation run, on the tables of a book."""

import re
from pathlib import Path

import pytest

from snapo.book.parquet import query
from snapo.case.error import CaseError

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "book.md"
QUERIES = re.findall(r"```sql\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_page_has_queries():
    assert len(QUERIES) >= 5


@pytest.mark.parametrize("sql", QUERIES)
def test_every_query_of_the_page_runs(sql, valued):
    columns, rows = query(valued.out, sql)
    assert columns and rows


def test_the_error_of_a_sum_is_that_of_the_result(valued):
    """The documented query of shares gives value and error of result.json."""
    sql = next(sql for sql in QUERIES if "stddev_samp" in sql)
    ((value, error),) = query(valued.out, sql)[1]
    row = valued.result["sums"][0]
    assert value == pytest.approx(row["value"], rel=1e-12)
    assert error == pytest.approx(row["standard_error"], rel=1e-9)


def test_tables_add_up(valued):
    sql = """SELECT stress, sum(value), sum(change), sum(explained) FROM "values" GROUP BY stress"""
    table = {row[0]: row[1:] for row in query(valued.out, sql)[1]}
    for row in valued.result["sums"]:
        expected = row["value"], row["change"], row["explained"]
        assert table[row["stress"]] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_a_query_reads_nothing_else(valued, tmp_path):
    """Neither files of the machine nor the network; the folder itself cannot be written."""
    (tmp_path / "secret.csv").write_text("a\n1\n")
    for sql in (
        f"SELECT * FROM read_csv('{tmp_path / 'secret.csv'}')",
        f"COPY (SELECT 1) TO '{tmp_path / 'out.csv'}'",
        "SELECT nothing FROM nowhere",
        "INSTALL httpfs",
    ):
        with pytest.raises(CaseError, match="--sql"):
            query(valued.out, sql)
    assert not (tmp_path / "out.csv").exists()
