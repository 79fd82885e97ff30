"""Exposure by day: the mean of every output, by contract and in sums."""

import numpy as np
import pytest
from tests.book.books import results_of

from snapo.book.parquet import query


def rows_of(valued, column="", label=""):
    rows = valued.result["exposure"]
    return {x["output"]: x for x in rows if (x["by"], x["label"]) == (column, label)}


def test_flows_by_day_add_up_to_the_outputs(valued):
    """Of every contract: the paths of the exposure are the first of those of the value."""
    for result in results_of(valued.book, valued.out).values():
        base = result.points[0]
        flows = {x.output: x for x in base.exposure}
        assert {"cash_flow", "injection", "withdrawal"} <= flows.keys()
        for figures in base.outputs:
            if figures.name in ("injection", "withdrawal"):
                total = flows[figures.name].blocks.mean(0).sum()
                assert total == pytest.approx(figures.value, rel=1e-5)
        assert flows["injection"].days[0] == "2025-01-01"
        assert not result.points[1].exposure


def test_the_sums_are_those_of_the_contracts(valued):
    sums = rows_of(valued)
    parts = [rows_of(valued, "desk", desk) for desk in "AB"]
    for output, row in sums.items():
        together = np.sum([x[output]["value"] for x in parts], 0)
        np.testing.assert_allclose(together, row["value"], atol=1e-9)
    assert sums["injection"]["unit"] == "MWh" and len(sums["injection"]["days"]) == 30
    sql = """SELECT day, sum(value) FROM exposure WHERE output = 'injection'
        GROUP BY day ORDER BY day"""
    table = dict(query(valued.out, sql)[1])
    assert list(table) == sums["injection"]["days"]
    np.testing.assert_allclose(list(table.values()), sums["injection"]["value"], atol=1e-9)


def test_a_twin_has_twice_the_error_and_the_report_a_chart(valued):
    """Desk A is a contract and its twin."""
    first = results_of(valued.book, valued.out)["first"].points[0]
    blocks = next(x.blocks for x in first.exposure if x.output == "cash_flow")
    single = blocks.std(0, ddof=1) / np.sqrt(len(blocks))
    twins = rows_of(valued, "desk", "A")["cash_flow"]["standard_error"]
    np.testing.assert_allclose(twins, 2 * single, rtol=1e-9, atol=1e-12)
    page = (valued.out / "report.html").read_text(encoding="utf-8")
    assert "Exposure by day" in page and "by desk, daily mean" in page
