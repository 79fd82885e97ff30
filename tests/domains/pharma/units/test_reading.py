"""Finite volumes and the tray dryer in a case and in a report: numbers, mistakes, charts."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from tests.domains.pharma.filled import filled, folder, plain
from tests.domains.pharma.pharma_cases import TEMPLATE, template

from snapo.case.error import CaseError
from snapo.domains.pharma.chapters.batch import ONE_BATCH, BatchResult, drying
from snapo.domains.pharma.chapters.model import UnitStatement, number_text
from snapo.domains.pharma.units.crystalliser import Crystalliser
from snapo.domains.pharma.units.reactor import Reactor
from snapo.domains.pharma.units.registry import read_units
from snapo.domains.pharma.units.tray_dryer import TrayDryer
from snapo.report.page import Chart, Table
from snapo.study.positions.files import Files, with_numbers

SIZES = {"smallest": "1 um", "largest": "400 um", "cells": 100, "spacing": "geometric"}
GRID = {"method": "finite-volumes", "sizes": SIZES}
SPREAD = {"spread": 0.3}
TRAY = {
    "type": "dryer",
    "kind": "tray",
    "duration": "3 h",
    "temperature": "50 degC",
    "pressure": {"nodes": ["200 mbar", "50 mbar"], "at": [0, 1]},
    "area": "0.5 m^2",
    "heat_transfer": "20 W/m^2/K",
    "mass_transfer": "7e-10 kg/m^2/s/Pa",
    "critical": "30 g/kg",
    "heat_capacity": "1200 J/kg/K",
}
LIQUID = {
    "antoine": [4.23027, 1256.68, 232.621],
    "unit": "bar",
    "scale": "degC",
    "latent_heat": "448 kJ/kg",
    "heat_capacity": "1720 J/kg/K",
}


def with_crystalliser(seed=SPREAD, **keys):
    """The template with keys of its crystalliser, and of its seed, changed."""
    units = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))["units"]
    old = units["crystalliser"]
    changed = {**old, **GRID, **keys, "seed": {**old["seed"], **seed}}
    changed = {key: value for key, value in changed.items() if value is not None}
    return template(units={**units, "crystalliser": changed})


def with_dryer(liquid=LIQUID, **keys):
    units = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))["units"]
    changed = {**TRAY, "liquid": liquid, **keys}
    return template(units={**units, "dryer": {k: v for k, v in changed.items() if v is not None}})


def test_a_grid_of_sizes():
    case = with_crystalliser()
    unit = next(each for each in case.units if isinstance(each, Crystalliser))
    assert unit.edges is not None
    np.testing.assert_allclose(unit.edges, np.geomspace(1e-6, 4e-4, 101))
    assert case.numerics.method == "adaptive"
    assert unit.measures(("A",))["span"] == "1" and unit.states(("A",))["d50"] == "m"
    equal = with_crystalliser(sizes={"smallest": "0 um", "largest": "0.3 mm", "cells": 60})
    unit = next(each for each in equal.units if isinstance(each, Crystalliser))
    assert unit.edges is not None
    np.testing.assert_allclose(unit.edges, np.linspace(0, 3e-4, 61))


def test_a_tray_dryer():
    case = with_dryer()
    unit = next(each for each in case.units if isinstance(each, TrayDryer))
    np.testing.assert_allclose(unit.liquid.antoine.values, [9.23027, 1256.68, -40.529])
    np.testing.assert_allclose(unit.pressure.value.values, [20_000, 5000])
    assert unit.critical.values[0] == pytest.approx(0.03)
    assert case.numerics.method == "mesh"  # on steps chosen once, by error control


def test_antoines_numbers_are_written_for_pascal_and_kelvin():
    tables = {"dryer": TRAY | {"liquid": LIQUID}}
    (unit,) = read_units(Path("case.toml"), tables, (), [])
    assert isinstance(unit, TrayDryer)
    wanted = unit.liquid.antoine.values * 1.001
    files = with_numbers(Files(Path(), {"units": tables}), unit.liquid.antoine, wanted)
    written = files.tables["units"]["dryer"]["liquid"]
    assert (written["antoine"], written["unit"], written["scale"]) == (wanted.tolist(), "Pa", "K")
    (again,) = read_units(Path("case.toml"), files.tables["units"], (), [])
    assert isinstance(again, TrayDryer)
    assert np.array_equal(again.liquid.antoine.values, wanted)


def test_what_a_tube_is_filled_with():
    units = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))["units"]
    tube = {**units["reactor"], "kind": "plug-flow", "volume": "10 L", "filled": "solvent"}
    feeds = {"charge": tomllib.loads(TEMPLATE.read_text())["feeds"]["charge"]}
    feeds["charge"]["duration"] = "1 h"
    case = template(units={**units, "reactor": tube}, feeds=feeds)
    assert next(each for each in case.units if isinstance(each, Reactor)).filled == "solvent"


HERE = "units.crystalliser"
SHOWN = "{ smallest = '1 um', largest = '400 um', cells = 100, spa..."
MISTAKES = {
    "no grid": (
        lambda: with_crystalliser(sizes=None),
        f'{HERE}.sizes: method "finite-volumes" needs this key.',
    ),
    "a grid for moments": (
        lambda: with_crystalliser(method="moments"),
        f'{HERE}.sizes: got {SHOWN}; method "moments" has no such key; it belongs to '
        '"finite-volumes".',
    ),
    "seeds of one size": (
        lambda: with_crystalliser(seed={}),
        f'{HERE}.seed.spread: method "finite-volumes" needs a seed with loading, size and spread.',
    ),
    "moments apart": (
        lambda: with_crystalliser(separate=True),
        f'{HERE}.separate: got true; method "finite-volumes" has no separate moments and has no '
        "such key.",
    ),
    "nuclei of their own": (
        lambda: with_crystalliser(nuclei_size="1 um"),
        f"{HERE}.nuclei_size: got '1 um'; method \"finite-volumes\" has nuclei of the smallest "
        "size and has no such key.",
    ),
    "geometric from zero": (
        lambda: with_crystalliser(sizes={**SIZES, "smallest": "0 um"}),
        f"{HERE}.sizes.smallest: got '0 um'; spacing \"geometric\" needs a smallest size above 0.",
    ),
    "largest below smallest": (
        lambda: with_crystalliser(sizes={**SIZES, "largest": "1 um"}),
        f"{HERE}.sizes.largest: got '1 um'; it must be above `smallest`.",
    ),
    "a seed outside its grid": (
        lambda: with_crystalliser(sizes={**SIZES, "largest": "30 um"}),
        f"{HERE}.sizes.largest: got '30 um'; 25.9 % of the seed's volume lies outside "
        "`smallest` to `largest`.",
    ),
    "a key of the other dryer": (
        lambda: with_dryer(rate="1e-3 1/s"),
        "units.dryer.rate: got '1e-3 1/s'; kind \"tray\" has no such key; it belongs to "
        '"falling-rate".',
    ),
    "no pressure": (
        lambda: with_dryer(pressure=None),
        'units.dryer.pressure: kind "tray" needs this key.',
    ),
    "vapour pressure that falls": (
        lambda: with_dryer({**LIQUID, "antoine": [9.0, -1200.0, -40.0]}),
        "units.dryer.liquid.antoine: got [9, -1200, -40]; its second number, B, must be above 0: vapour "
        "pressure rises with temperature.",
    ),
    "vapour pressure in kilograms": (
        lambda: with_dryer({**LIQUID, "unit": "kg"}),
        "units.dryer.liquid.unit: got 'kg'; kg is [mass], but the quantity is [mass] / [length] / [time] ** 2, Pa.",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes(name):
    make, message = MISTAKES[name]
    with pytest.raises(CaseError) as found:
        make()
    assert str(found.value) == f"{TEMPLATE}, {message}"


def test_numbers_of_the_case_come_back_with_all_digits():
    shown = [number_text(x, "K") for x in (313.15, 4.46e10, 5e-6, -50.0, 0.0, 26540.0)]
    expected = ["313.15", "4.46 × 10¹⁰", "5 × 10⁻⁶", "−50", "0", "26,540"]
    assert shown == [f"{each}\u00a0K" for each in expected]
    assert number_text(2.0, "1") == "2"


def test_drying_is_drawn_for_every_kind_of_dryer():
    tray = {"time": [0, 60], "solvent": [0.1, 0.01], "temperature": [300, 320], "shelf": [323, 323]}
    rate = {"time": [0, 60], "solvent": [0.1, 0.01], "temperature": [323, 323]}
    batch = filled(BatchResult, trajectories={"first": tray, "second": rate})
    blocks = drying(folder((ONE_BATCH, batch))).blocks
    assert ["Shelf" in str(each.svg) for each in blocks if isinstance(each, Chart)] == [True, False]


def test_units_without_a_section_of_their_own_are_drawn():
    """A mill has a panel for each unit of measure of its states; every measure has a row."""
    course = {"time": [0, 60], "number": [1e9, 2e9], "d43": [1e-4, 5e-5], "d32": [9e-5, 4e-5]}
    measures, states = {"number": "1/m3", "d43": "m"}, {"number": "1/m3", "d43": "m", "d32": "m"}
    mill = filled(UnitStatement, name="mill", measures=measures, states=states)
    batch = filled(
        BatchResult,
        trajectories={"mill": course},
        measures={"mill.number": 2e9, "mill.d43": 5e-5},
    )
    table, chart = ONE_BATCH(folder((ONE_BATCH, batch), units=[plain(mill)])).blocks
    assert isinstance(table, Table) and [row[1] for row in table.rows] == ["number", "d43"]
    assert isinstance(chart, Chart) and "d32" in str(chart.svg)
