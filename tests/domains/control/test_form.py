"""A second plant of the same form is the same program: nothing is traced or compiled for it."""

from importlib import resources
from pathlib import Path

import jax
import numpy as np
import pytest
from tests.compilations import compilations
from tests.domains.same_form import PAIRS, same_programs

from snapo.case.load import load
from snapo.domains.control import SIZES
from snapo.domains.control.read import read_case
from snapo.domains.control.study import make_setup, objective_of, plant_at, setup_at
from snapo.engine.native.call import _runners
from snapo.problem.problem import Problem

QUICK = {
    "training": {"steps": 2, "paths": 64, "validation_paths": 64},
    "evaluation": {"paths": 128, "sensitivity_paths": 64, "judge_paths": 0, "search_paths": 0},
}


def plant(size: str, by: float = 1.0, horizon: int = 4, **tables):
    """A template with other numbers of `[cost]` and `[plant]`, and a short horizon."""
    file, data = load(Path(str(resources.files("snapo.domains.control"))) / "template" / size)
    group = data.setdefault("plant", {})
    group["horizon"] = horizon
    for key, value in group.items():
        if isinstance(value, float) and key != "target":
            group[key] = value * by
    for key, value in data.get("cost", {}).items():
        data["cost"][key] = (by * np.asarray(value)).tolist()
    return read_case(file, data | QUICK | tables)


def drawn(seed: int) -> Problem:
    """A template whose numbers are drawn, and its rules of a few."""
    draw = np.random.default_rng(seed)
    tables = {}
    size = SIZES[seed % len(SIZES)]
    if size == "pendulum":
        mean = float(draw.uniform(2.0, 3.0))
        starts = ({"at": mean}, {"low": -mean, "high": mean}, {"mean": mean, "deviation": 0.1})
        tables["start"] = {"angle": starts[draw.integers(3)]}
        tables["noise"] = {"speed": float(draw.uniform(0, 0.1))} if draw.integers(2) else {}
        tables["measurement"] = {"angle": 0.01 * mean} if draw.integers(2) else {}
    case = plant(size, float(draw.uniform(1.0, 1.1)), int(draw.integers(3, 5)), **tables)
    return Problem(plant_at(case), case.inputs, objective_of(case))


def test_equal_forms_are_equal_programs():
    assert same_programs(map(drawn, range(64)), enough=16) >= 16


@PAIRS
def test_equal_forms_are_equal_programs_in_many_pairs(enough):
    assert same_programs(map(drawn, range(800)), enough) >= enough


@pytest.mark.parametrize("size", SIZES)
def test_a_plant_has_no_numbers(size):
    assert jax.tree.leaves(plant_at(plant(size))) == []


@pytest.mark.prove
@pytest.mark.parametrize("size", ["pendulum", "measured"])
def test_a_second_plant_compiles_nothing_and_has_its_own_bits(size):
    setup = make_setup(plant(size), "native")
    first = setup.solve()
    with compilations() as compiled:
        second = setup_at(setup, plant(size, 1.05)).solve()
    assert compiled == []
    jax.clear_caches()
    _runners.clear()
    again = make_setup(plant(size, 1.05), "native").solve()
    assert second.value == again.value != first.value
    assert jax.tree.all(jax.tree.map(np.array_equal, second.policy, again.policy))
