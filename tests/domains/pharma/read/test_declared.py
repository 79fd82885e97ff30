"""A number is declared once: its table, range, message, input and position in the file follow."""

import copy
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import TEMPLATE

from snapo.case.error import CaseError
from snapo.domains.pharma.flowsheet.inputs import pharma_inputs
from snapo.domains.pharma.read.case import resolve
from snapo.domains.pharma.units.filter_dryer import FilterDryer
from snapo.domains.pharma.units.registry import read_units
from snapo.domains.pharma.units.wet_mill import WetMill
from snapo.study.positions import InputPositions
from snapo.study.positions.files import read_files

MILL = {
    "type": "wet-mill", "duration": "30 min", "speed": "1200 m/min", "rate": "1e-3 1/s",
    "reference_size": "100 um", "reference_speed": "20 m/s",
}  # fmt: skip


def mill(**changes) -> WetMill:
    """The unit [units.mill], with these keys changed."""
    (unit,) = read_units(Path("case.toml"), {"mill": MILL | changes}, (), [])
    assert isinstance(unit, WetMill)
    return unit


def test_a_declaration_says_all_of_a_number():
    speed = mill().speed.value
    assert speed.values == pytest.approx(20.0) and speed.unit == "m/s" and speed.low == 0.0
    assert (speed.name, speed.meaning) == ("mill.speed", "tip speed of the rotor")
    assert speed.display_unit == "m/min" and speed.display_factor == pytest.approx(60)
    (position,) = speed.positions
    assert position == (("units", "mill", "speed"), "m/s")
    assert mill().fragments.values == 2.0  # where the case does not say
    words = {key: field.description for key, field in WetMill.table.model_fields.items()}
    assert words["fragments"] == "a number from 2 to 100"
    start = "a quantity in quotation marks above 0, such as"
    assert words["reference_speed"] == f'{start} "20 m/s"'


def test_all_mistakes_of_a_unit_are_named_at_once():
    with pytest.raises(CaseError) as caught:
        mill(speed="-1 m/s", fragments=101, rate="1 kg")
    text = str(caught.value)
    assert "units.mill.speed: got '-1 m/s'; it must be a quantity of at least 0." in text
    assert "units.mill.fragments: got 101; it must be a number from 2 to 100." in text
    assert "units.mill.rate: got '1 kg'" in text


def test_mistakes_of_a_feed_are_named_with_their_keys():
    tables = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))
    tables["feeds"]["charge"] |= {"solvent": "4 kg/L", "duration": "-2 h"}
    with pytest.raises(CaseError) as caught:
        resolve(TEMPLATE, tables)
    text = str(caught.value)
    assert "feeds.charge.solvent: got '4 kg/L'; it must be a quantity from 0 to 3,000 kg/m3" in text
    assert "feeds.charge.duration: got '-2 h'; it must be a quantity above 0" in text


def test_keys_of_two_records_stand_in_one_table():
    keys = FilterDryer.table.model_fields
    assert {"filter_pressure", "pressure", "area", "heating_area", "washes", "liquid"} <= set(keys)
    assert keys["type"].annotation is not None and "kind" not in keys


def positions(tables: dict) -> tuple[InputPositions, list]:
    """Where the numbers of a case stand, and a list with an entry for each time it is read."""
    readings = []

    def read(file, data):
        readings.append(file)
        return resolve(file, data)

    case = resolve(TEMPLATE, copy.deepcopy(tables))
    files = read_files(TEMPLATE.parent, tables)
    return InputPositions(read, files, pharma_inputs(case), case=case), readings


def template() -> dict:
    return tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))


def test_every_number_of_the_template_is_written_and_read_once():
    places, readings = positions(template())
    for name, entry in places.inputs.items():
        wanted = entry.value * (1 - 1e-4) + 1e-9 * (entry.value == 0)
        moved = places.case_at({name: wanted})
        assert np.array_equal(pharma_inputs(moved.case)[name].value, wanted)
    assert len(readings) == len(places.inputs) == 43


def at(tables, path: Sequence):
    for key in path:
        tables = tables[key]
    return tables


REACTOR, NODES = ("units", "reactor"), ("units", "crystalliser", "temperature", "nodes")
OTHER_UNITS = {  # table, key, what stands there, input, its entry, another value, what is written
    "celsius": (REACTOR, "temperature", "40 degC", "reactor.temperature", 0, 312.4, "312.4 K"),
    "minutes": (REACTOR, "duration", "60 min", "reactor.duration", 0, 3601.5, "3601.5 s"),
    "a node": (NODES, 1, "35 degC", "crystalliser.temperature", 1, 307.3, "307.3 K"),
    "a percentage": (
        ("units", "filter"), "porosity", "40 %", "filter.porosity", 0, 0.41, 0.41),
    "a concentration": (
        ("feeds", "charge", "concentration"), "A", "330 mol/m^3", "charge.concentration", 0,
        0.34, "0.34 kmol/m3"),
    "a rate constant": (
        ("reactions", 0), "prefactor", "2.654e7 mL/mol/s", "kinetics.prefactor", 0, 26541.7,
        "26541.7 m3/kmol/s"),
}  # fmt: skip


@pytest.mark.parametrize("example", OTHER_UNITS)
def test_a_number_is_written_back_in_another_unit(example):
    path, key, stands, name, entry, number, written = OTHER_UNITS[example]
    tables = template()
    at(tables, path)[key] = stands
    places, readings = positions(tables)
    wanted = np.array(places.inputs[name].value)
    wanted.ravel()[entry] = number
    moved = places.case_at({name: wanted})
    assert at(moved.files.tables, path)[key] == written and len(readings) == 1
    assert np.array_equal(pharma_inputs(moved.case)[name].value, wanted)


def test_orders_give_every_rate_constant_its_own_unit():
    tables = template()
    tables["reactions"][0] |= {"order": {"A": 1.5}, "prefactor": "2.654e4 (m^3/kmol)^1.5/s"}
    places, _ = positions(tables)
    wanted = places.inputs["kinetics.prefactor"].value * 1.01
    moved = places.case_at({"kinetics.prefactor": wanted})
    assert np.array_equal(pharma_inputs(moved.case)["kinetics.prefactor"].value, wanted)


@pytest.mark.parametrize("unit", ["K", "degC"])
def test_a_list_with_one_unit_is_written_with_its_unit(unit):
    tables = template()
    numbers = [313.15, 308.0, 295.0, 278.15] if unit == "K" else [40, 35, 22, 5]
    at(tables, NODES[:-1])["nodes"] = {"value": numbers, "unit": unit}
    wanted = [312.65, 307.5, 294.5, 277.65]
    moved = moved_to(tables, "crystalliser.temperature", wanted)
    assert at(moved, NODES) == {"value": wanted, "unit": "K"}


def moved_to(tables: dict, name: str, numbers: list[float]) -> dict:
    """The tables with other numbers of an input, which are read again with exactly these."""
    places, _ = positions(tables)
    moved = places.case_at({name: np.array(numbers)})
    found = pharma_inputs(moved.case)
    assert np.array_equal(found[name].value, numbers)
    others = [key for key in found if key != name]
    assert all(np.array_equal(found[key].value, places.inputs[key].value) for key in others)
    return moved.files.tables


@pytest.mark.parametrize(
    ("changes", "written"),
    [({}, None), ({"unit": "g/mL"}, "kg/m^3"),
     ({"kind": "exponential", "unit": "g/mL", "coefficients": [-6.0, 0.02]}, "kg/m^3")],
)  # fmt: skip
def test_coefficients_of_a_solubility_are_written_in_one_unit(changes, written):
    tables = template()
    table = at(tables, ("units", "crystalliser", "solubility"))
    if "coefficients" not in changes:
        table["coefficients"] = [x / (1000 if changes else 1) for x in table["coefficients"]]
    table |= changes
    places, _ = positions(tables)
    name = "crystalliser.solubility"
    wanted = (places.inputs[name].value * 1.001).tolist()
    moved = at(moved_to(tables, name, wanted), ("units", "crystalliser", "solubility"))
    assert moved["coefficients"] == wanted
    assert moved.get("unit") == (written or table.get("unit"))
