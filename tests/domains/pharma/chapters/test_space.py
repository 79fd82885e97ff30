"""The report's section of the design space: the table of its boundary, with rows and without."""

import csv
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.domains.pharma.filled import filled
from tests.domains.pharma.pharma_cases import CASE, attribute, solve
from tests.domains.pharma.quality.test_boundary import linear

from snapo.domains.pharma.chapters.design_space import SpaceMap, _contours, boundary, space_map
from snapo.report.page import Table, Text
from snapo.report.quantity import SPACE

NAMES = ["first", "second"]


def ending(samples=400) -> SpaceMap:
    """The map of a space that ends towards low T2 and high T_f."""
    process: Any = linear(samples)
    return space_map(process, 7)


def test_every_end_next_to_the_set_point_has_a_row():
    table, words = boundary(ending(), NAMES)
    assert isinstance(table, Table) and isinstance(words, Text)
    assert [row[:4] for row in table.rows] == [
        ("T2, K", f"T_f 278.15{SPACE}K", "below", "first"),
        ("T_f, K", f"T2 295{SPACE}K", "above", "first"),
    ]
    assert "400 batches per point" in words.text
    for row in table.rows:
        low, high = (float(each) for each in row[5].split(" – "))
        assert low < float(row[4]) < high


def test_an_unknown_end_of_the_interval_stands_on_its_own_side():
    """Few batches do not tell how far inside one has to stay: above, where the space ends below."""
    table = boundary(ending(samples=24), NAMES)[0]
    assert isinstance(table, Table)
    sides = {row[2]: row[5].split(" – ") for row in table.rows}
    assert sides["below"][1] == "beyond" and sides["above"][0] == "beyond"
    assert float(sides["below"][0]) > 0 and float(sides["above"][1]) > 0


def test_a_space_without_an_end_says_so():
    (words,) = boundary(replace(ending(), ends=()), NAMES)
    assert isinstance(words, Text) and "does not cross" in words.text
    assert not boundary(replace(ending(), ends=None), NAMES)


@pytest.mark.prove
def test_the_report_of_a_run_shows_the_boundary(tmp_path):
    """A reactor whose reagent is used up neither in the cold nor in a short time."""
    left = attribute("A left", "reactor.concentration.A", "mol/L", 'high = "0.006 mol/L"')
    text = CASE[: CASE.index("[estimation]")].replace("[[uncertainty]]", f"{left}[[uncertainty]]")
    for old, new in (
        ('pairs = [["T", "t"]]\n', ""),
        ('low = "0.11 mol/L"', 'low = "0.1 mol/L"'),
        ("spread = 0.1 }", "spread = 0.02 }"),
        ("samples = 32", "samples = 64\nrequired = 0.9"),
    ):
        assert old in text
        text = text.replace(old, new)
    folder, out = tmp_path / "case", tmp_path / "run"
    folder.mkdir()
    text += '[evaluation]\npaths = 128\n[report]\nparts = ["design space"]\n'
    (folder / "case.toml").write_text(text)
    result, found = solve(folder, out)
    assert result["status"] == "ok"
    with (out / "design_space_boundary.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    near = [
        row for row in rows if row["along"] == "t [min]" and abs(float(row["T [degC]"]) - 40) < 1
    ]
    assert len(near) == 1 and near[0]["ends"] == "below" and near[0]["binding"] == "A left"
    page = (out / "report.html").read_text(encoding="utf-8")
    section = page[page.index('<section id="design-space"') :]
    section = section[: section.index("</section>")]
    assert "Where the design space ends" in section
    body = re.findall(r"<tr>.*?</tr>", section, re.S)
    assert len(body) == 3  # the head, and an end along either axis
    shown = found.details["design_space"]["ends"]
    assert len(shown) == len(rows) and np.isfinite([each["position"] for each in shown]).all()
    assert f"{float(near[0]['boundary']):.4g}" in body[2]


@pytest.mark.parametrize(
    ("levels", "required"), [([0.3, 0.95], 0.9), ([0.5], 0.5), ([0.85], 0.2), ([0.01, 0.99], 0.01)]
)
def test_contours_of_every_level_are_drawn(levels, required):
    """A level is a probability between 0 and 1; the colours part at these and at one half."""
    from matplotlib.figure import Figure

    grid = np.linspace(0.0, 1.0, 5)
    probability = np.outer(grid, np.ones(5))
    found = filled(
        SpaceMap, grid=(grid, grid), levels=levels, required=required, axes=("a", "b"),
        units=("K", "K"), normal=((0.4, 0.6), (0.4, 0.6)), nominal=(0.5, 0.5),
    )  # fmt: skip
    axes = Figure().add_subplot()
    _contours(axes, found, probability, (probability - 0.1, probability + 0.1))
    shades = next(each for each in axes.collections if getattr(each, "filled", False))
    inner = sorted({0.5, *levels, required})
    np.testing.assert_allclose(shades.levels, [-0.001, *inner, 1.001])
