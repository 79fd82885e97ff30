"""Numbers of the model and the ranking of parameters as a reader meets them."""

import pytest
from tests.domains.pharma.filled import filled, folder

from snapo.domains.pharma.chapters.estimation import _of_fit
from snapo.domains.pharma.chapters.model import (
    MODEL,
    NumberStatement,
    Statement,
    UnitStatement,
    location,
)
from snapo.domains.pharma.chapters.sensitivities import _ranking
from snapo.domains.pharma.derivatives.sensitivities import Rank
from snapo.report.page import Table
from snapo.report.quantity import SPACE

UNIT = filled(UnitStatement, name="crystalliser")


@pytest.mark.parametrize(
    ("label", "unit", "written"),
    [
        ("t^0", "kg/m3/K^k", ("t⁰", f"2{SPACE}kg/m³")),
        ("t^1", "kg/m3/K^k", ("t¹", f"2{SPACE}kg/m³/K")),
        ("t^2", "kg/m3/K^k", ("t²", f"2{SPACE}kg/m³/K²")),
        ("t^0", "1/K^k", ("t⁰", "2")),
        ("t^1", "1/K^k", ("t¹", f"2{SPACE}1/K")),
        ("node 1", "K", ("node 1", f"2{SPACE}K")),
    ],
)
def test_a_coefficient_has_the_unit_of_its_power(label, unit, written):
    row = filled(NumberStatement, label=label, value=2.0, unit=unit)
    table = MODEL(folder((MODEL, Statement(units=(UNIT,), numbers=(row,))))).blocks[-1]
    assert isinstance(table, Table)
    (row,) = table.rows
    assert (row[1], row[3]) == written


def test_a_place_keeps_the_digits_of_a_temperature():
    assert (location(313.15), location(303.0, "K"), location(None)) == (
        "313.15",
        f"303{SPACE}K",
        "–",
    )


def test_a_ranking_has_its_words_outside_the_columns_of_numbers():
    ranks = [Rank("T", 0.5, "yield", False, spent, 0.1) for spent in (False, True)]
    table = _ranking(tuple(ranks))
    assert isinstance(table, Table)
    assert [row[2] for row in table.rows] == [f"50.0{SPACE}%", "–"]
    assert [row[4] for row in table.rows] == ["", "variation uses all of the margin"]
    assert [table.right(i) for i in range(5)] == [False, False, True, True, False]


def test_a_fit_is_doubted_where_its_status_is_and_not_before():
    # The status accepts a fit whose chi² has a tail of 0.001 or more.
    assert "inadequate" not in _of_fit(0.005)
    assert "inadequate" in _of_fit(0.0005)
