"""Recipes as tables of setpoints."""

import tomllib

import numpy as np
import pytest
from tests.domains.pharma.filled import filled
from tests.domains.pharma.pharma_cases import CASE, LOOP, TEMPLATE, small, template
from tests.domains.pharma.process_cases import (
    Connection,
    attribute,
    batch_reactor,
    case,
    chain,
    feed,
    linear,
)

from snapo.domains.pharma.chapters.closed_loop import ControlCourse, decided
from snapo.domains.pharma.chapters.optimum import optimal
from snapo.domains.pharma.read.case import resolve
from snapo.domains.pharma.setpoints import HEADER, setpoints


def test_every_node_and_every_number_that_may_be_chosen():
    """The template: the crystalliser's nodes in seconds, the wash ratio, and no kinetics."""
    case = template()
    rows = list(setpoints(case))
    assert all(len(row) == len(HEADER) for row in rows)
    unit = next(each for each in case.units if each.name == "crystalliser")
    seconds = float(unit.duration.used())
    cooling = [row for row in rows if row[1] == "crystalliser.temperature"]
    assert [row[3] for row in cooling] == pytest.approx(unit.temperature.share * seconds)
    assert [row[4] for row in cooling] == unit.temperature.value.values.tolist()
    assert {row[1] for row in rows if row[0] == "filter"} == {
        each.input for each in case.parameters if each.input.startswith("filter.")
    }
    assert not any("kinetics" in row[1] for row in rows)


def test_the_best_recipe_and_the_closed_loop():
    """A longer batch moves the seconds too; of the closed loop the time at the end of a decision."""
    case = resolve(TEMPLATE, tomllib.loads(small(CASE + LOOP)))
    assert case.optimise is not None
    changed = optimal(case.optimise, [45.0, 90.0])
    rows = {row[1]: row for row in setpoints(case, changed)}
    assert rows["reactor.duration"][4] == pytest.approx(5400)
    assert rows["reactor.temperature"][4] == pytest.approx(318.15)
    course = filled(
        ControlCourse,
        input="reactor.temperature",
        unit="K",
        time=np.array([600.0, 1200.0]),
        values=np.array([310.0, 305.0]),
    )
    assert list(decided([course])) == [
        ("reactor", "reactor.temperature", "linear", 600.0, 310.0, "K"),
        ("reactor", "reactor.temperature", "linear", 1200.0, 305.0, "K"),
    ]


def test_a_dose_is_a_setpoint_as_the_flow_that_adds_up_to_its_feed():
    """0.5 L of which the recipe asks for twice as much, in half the time: 1 L over 1800 s."""
    unit = batch_reactor(
        3600.0, kind="semi-batch", dosing=linear("reactor.dosing", [0.0, 2.5e-4 / 900], "m3/s")
    )
    feeds = feed(volume=0.001), feed(volume=0.0005, name="drops")
    ports = (*chain("charge", "reactor"), Connection("drops", "", "reactor", "dose"))
    wanted = (attribute("T", "reactor.temperature", "K"),)
    changed = {("reactor.duration", 0): 1800.0, ("drops.volume", 0): 0.001}
    rows = setpoints(case(feeds, (unit,), ports, wanted), changed)
    found = [(row[3], row[4]) for row in rows if row[1] == "reactor.dosing"]
    assert found == [(0.0, 0.0), (1800.0, pytest.approx(2 * 0.001 / 1800))]
