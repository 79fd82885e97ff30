"""Cases of control: all templates are read, and mistakes come out in words."""

import copy

import numpy as np
import pytest

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.domains.control import DOMAIN, SIZES
from snapo.domains.control.plants import TYPES
from snapo.domains.control.study import plant_at
from snapo.study.domain import Domain


def template(size: str):
    return load(DOMAIN.templates[size] / "case.toml")


def test_the_domain_fits_its_protocol():
    assert isinstance(DOMAIN, Domain)
    assert set(SIZES) == {*TYPES, "measured"}


@pytest.mark.parametrize("size", SIZES)
def test_a_template_has_the_numbers_of_its_plant(size):
    """A case that says all numbers is the one that says none, but where they must be said."""
    file, data = template(size)
    case = DOMAIN.read(file, data)
    plant = TYPES[data["plant"]["type"]]
    assert type(plant_at(case)) is plant
    assert plant_at(case).horizon == (40 if size == "measured" else plant.steps)
    for group, known in (("plant", plant.parameters), ("cost", plant.weights)):
        for name, each in known.items():
            if each.value is not None and np.isfinite(each.value):
                assert case.inputs[group][name].value == each.value
    assert DOMAIN.check(case)


WRONG = [
    ("pendulum", ("plant", "type"), "pendulm", "the nearest known key is pendulum"),
    ("pendulum", ("plant", "mass"), -1.0, "a number above 0 (mass of the rod, kg; by default 1)"),
    ("pendulum", ("plant", "gravty"), 10.0, "the nearest known key is gravity"),
    ("pendulum", ("start", "angle"), {"low": 2.0, "high": 1.0}, "a number above 2"),
    ("pendulum", ("start", "angel"), {"at": 1.0}, "the nearest known key is angle"),
    ("pendulum", ("start", "speed"), {"at": [1.0, 2.0]}, "this state is one number"),
    ("pendulum", ("start", "speed"), 1.0, "{ at = 1 }"),
    ("pendulum", ("start", "speed"), {"mean": 0.0, "deviation": 0.0}, "numbers must be above 0"),
    ("pendulum", ("noise", "speed"), -0.1, "at least 0"),
    ("pendulum", ("policy", "hidden"), [], "a list of widths"),
    ("mountain-car", ("plant", "goal"), -0.6, "the bottom of the valley"),
    ("two-tanks", ("plant", "target"), 31.0, "at a higher target a tank would overflow"),
    ("two-tanks", ("plant", "flow"), 5.0, "the flow that holds the target"),
    ("linear-quadratic", ("plant", "A"), [[1.0, 1.0]], "1 rows of 1 numbers"),
    ("linear-quadratic", ("cost", "R"), [[-1.0]], "eigenvalues above 0"),
    ("linear-quadratic", ("cost", "Q"), [[1.0, 2.0], [0.0, 1.0]], "symmetric"),
    ("linear-quadratic", ("start", "x"), {"at": [1.0, 2.0, 3.0]}, "2 numbers"),
    ("linear-quadratic", ("noise", "x"), [[1.0, 2.0], [3.0]], "the same length"),
    ("pendulum", ("measurement", "angel"), 0.1, "the nearest known key is angle"),
    ("pendulum", ("measurement", "angle"), -0.1, "at least 0"),
    ("pendulum", ("measurement", "angle"), [0.1, 0.1], "this state is one number"),
    ("pendulum", ("measurement", "angle"), "much", "must be a number, a list"),
    ("measured", ("measurement", "x"), 0.1, "must be 2 numbers"),
    ("measured", ("measurement", "x"), [[0.1, 0.0], [0.0, 0.1]], "with one for each number"),
    ("measured", ("policy", "memory"), "LSTM", '"GRU" (a recurrent network)'),
    ("measured", ("policy", "hidden"), [16, 16], "a list of one width"),
    ("measured", ("policy", "steps"), 4, 'only memory = "Recent"'),
]


@pytest.mark.parametrize("size, way, value, words", WRONG, ids=lambda each: str(each)[:30])
def test_a_mistake_is_told(size, way, value, words):
    file, data = template(size)
    data = copy.deepcopy(data)
    data.setdefault(way[0], {})[way[1]] = value
    with pytest.raises(CaseError) as error:
        DOMAIN.read(file, data)
    assert words in str(error.value) and way[1] in str(error.value)


def test_a_state_that_must_be_given():
    file, data = template("linear-quadratic")
    del data["start"]["x"]
    with pytest.raises(CaseError, match=r"start\.x.*missing"):
        DOMAIN.read(file, data)
