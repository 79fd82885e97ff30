"""Cells along a length and over sizes: twice as many, and a grid of sizes that ends too early."""

from dataclasses import replace

import numpy as np
import pytest
from tests.domains.pharma.filled import folder
from tests.domains.pharma.process_cases import flagship
from tests.domains.pharma.test_sound import GOOD
from tests.domains.pharma.units.crystals.test_finite_volumes import alone
from tests.domains.pharma.units.test_tube import tube

from snapo.domains.pharma.chapters.headline import checks, status
from snapo.domains.pharma.chapters.verification import CONVERGENCE
from snapo.domains.pharma.derivatives.convergence import (
    Cells,
    Convergence,
    finer_cells,
    on_finer_cells,
)
from snapo.domains.pharma.flowsheet.possible import impossible
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.time.dynamics import Numerics
from snapo.domains.pharma.units.crystals.sizes import halved

LONG = Numerics("adaptive", 80, 1e-6, 20_000, True)


def test_a_tube_on_twice_its_elements():
    """exp(-3) does not move by a hundred-thousandth of itself; exp(-12) moves by 1e-4."""
    (row,) = on_finer_cells(tube(constant=3.0))
    assert row.passed and row.margins < 1e-3
    steep = tube(constant=12.0).case
    limited = replace(steep.attributes[0], high=1.0, margin=1e-5 * np.exp(-12))
    (row,) = on_finer_cells(PharmaProcess(replace(steep, attributes=(limited,))))
    assert not row.passed and row.finer == pytest.approx(np.exp(-12), rel=1e-5)


def test_what_has_no_cells_is_not_repeated():
    """Tanks in series are a model of their own, and moments have no grid."""
    assert finer_cells(tube(cells=5)) is None
    assert on_finer_cells(PharmaProcess(flagship())) == ()


def test_cells_are_halved_as_they_are_spaced():
    equal = np.linspace(0, 4e-4, 5)
    np.testing.assert_allclose(halved(equal), np.linspace(0, 4e-4, 9), atol=1e-18)
    geometric = np.geomspace(1e-6, 4e-4, 6)
    np.testing.assert_allclose(halved(geometric), np.geomspace(1e-6, 4e-4, 11), rtol=1e-12)


def test_cells_that_move_an_attribute_are_a_status():
    rows = Cells("yield", 1.0, 1.0, 0.1, True), Cells("size", 1.0, np.nan, np.nan, False)

    def run(cells):
        return folder(*(GOOD | {CONVERGENCE: Convergence((), True, cells)}).items())

    assert ("twice as many cells", False, " (size)") in checks(run(rows))
    assert status(run(rows)) == "a check fails: twice as many cells (size)"
    assert status(run(rows[:1])) == "ok"


def test_a_grid_of_sizes_that_ends_too_early_is_a_status():
    """All crystals in the largest cell, out of which none grows: 6.6 kg/m3 were found for 20.5."""
    given = alone(np.linspace(0, 60e-6, 7))
    said = impossible(given, {"crystalliser.at_largest": 1.0})
    assert said.startswith("crystalliser.at_largest is 1: the grid of sizes ends too early")
    assert impossible(given, {"crystalliser.at_largest": 0.005}) == ""


@pytest.mark.prove
def test_a_coarse_grid_of_sizes():
    """35 geometric cells to 1500 um put d43 13 % too high, and twice as many find out."""
    edges = np.geomspace(1e-6, 1500e-6, 36)
    rows = on_finer_cells(PharmaProcess(alone(edges, ("d43",), numerics=LONG)))
    exact = PharmaProcess(alone(None, ("d43",))).values()[0]
    assert rows[0].value > 1.05 * exact
    assert not rows[0].passed and abs(rows[0].finer - exact) < abs(rows[0].value - exact) / 2
    short = PharmaProcess(alone(np.linspace(0, 60e-6, 61), ("d43",), numerics=LONG)).run()
    assert "ends too early" in short.status
