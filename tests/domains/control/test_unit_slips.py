"""Slips of units of a plant: one note each, with the key and the number."""

import pytest

from snapo.case.load import load
from snapo.domains.control import DOMAIN

SLIPS = {
    "degrees": (
        ("start", "angle", {"mean": 180.0, "deviation": 0.1}),
        "start.angle.mean: start.angle.mean is 180 rad, outside 0 to 25.2 rad: an angle is in radians",
    ),
    "gravity in cm/s2": (
        ("plant", "gravity", 982.0), "plant.gravity: plant.gravity is 982 m/s2, outside 0.5 to 30",
    ),
    "a step in hours": (
        ("plant", "step", 1e-7), "plant.step: plant.step is 1e-07 s, outside 1e-06 to 10,000 s",
    ),
    "a length in micrometres": (
        ("plant", "length", 6e5), "plant.length: plant.length is 600,000 m, outside 0.0001 to",
    ),
    "a mass in milligrams": (
        ("plant", "pole", 5e-7), "plant.pole: plant.pole is 5e-07 kg, outside 0.0001 to 1,000,000 kg",
    ),
}  # fmt: skip


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_of_units_has_one_note(slip):
    (table, key, value), start = SLIPS[slip]
    file, data = load(DOMAIN.templates["cart-pole"] / "case.toml")
    assert not DOMAIN.read(file, data).notes
    data[table][key] = value
    (note,) = DOMAIN.read(file, data).notes
    assert note.startswith(start)
