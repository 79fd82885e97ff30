"""The check of convergence judges the method of the case, and every method passes it."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import CASE, attribute, connections, parameter
from tests.domains.pharma.units import test_filter_dryer, test_hydrogenation
from tests.domains.pharma.units.solids import test_tablet_press

from snapo.domains.pharma.derivatives.convergence import VALUES, convergence
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.read.case import resolve

METHODS = ("auto", "mesh", "stiff", "adaptive")
COOL = test_filter_dryer.CASE.split("[units.fd]")[0].replace('"2 h"', '"11 h"')
COOL = COOL.replace('{ nodes = ["313.15 K", "278.15 K"] }', '"295.15 K"')
FEED = "[feeds.charge]" + test_filter_dryer.CASE.split("[feeds.charge]")[1].split("[[conn")[0]
SLOW = CASE[: CASE.index("[[parameters]]")].replace('"3600 s"', '"11 h"')
# Eleven hours in a crystalliser, and in a reactor whose reactions are over after two.
HOLDS = {
    "crystals": COOL
    + FEED
    + connections(("charge", "cool.feed"))
    + parameter("T", "cool.temperature", ["290 K", "300 K"], ["294 K", "296 K"])
    + attribute("size", "cool.d43", "um"),
    "reactor": SLOW
    + parameter("T", "reactor.temperature", ["303 K", "323 K"], ["312 K", "314 K"])
    + attribute("product", "reactor.concentration.C", "mol/L"),
}
UNITS = {
    "reactor": CASE[: CASE.index("[design_space]")],
    "hydrogenation": test_hydrogenation.CASE,
    "filter-dryer": test_filter_dryer.CASE,
    "tablets": test_tablet_press.CASE,
}


def process(text: str, method: str, **numerics) -> PharmaProcess:
    data = {name: each for name, each in tomllib.loads(text).items() if name != "pairs"}
    return PharmaProcess(
        resolve(Path("case.toml"), data | {"numerics": {"method": method, **numerics}})
    )


@pytest.mark.parametrize(
    "methods",
    [
        pytest.param(("auto", "stiff"), marks=pytest.mark.prove),
        pytest.param(("adaptive",), marks=pytest.mark.study),
    ],
)
@pytest.mark.parametrize("name", HOLDS)
def test_a_long_hold(name, methods):
    tight = process(HOLDS[name], "adaptive", tolerance=1e-12).values()
    for method in methods:
        found = convergence(process(HOLDS[name], method))
        assert found.passed
        assert found.rows[0].mesh == pytest.approx(tight[0], rel=VALUES)


@pytest.mark.prove
def test_a_mesh_of_its_own_length_is_judged_as_it_is():
    """Steps that a case asks for are not doubled: of the same hold they are too long."""
    coarse = process(HOLDS["crystals"], "auto", steps=320)
    assert coarse.case.numerics.steps == 320
    free = process(HOLDS["crystals"], "auto")
    assert free.case.numerics.steps == 1280
    right = free.values()
    assert abs(coarse.values()[0] / right[0] - 1) > VALUES


@pytest.mark.parametrize(
    "name",
    [  # The filter with its dryer takes as long as all others together.
        pytest.param(name, marks=getattr(pytest.mark, "study" if "filter" in name else "prove"))
        for name in UNITS
    ],
)
def test_every_method_agrees_with_itself_and_with_the_others(name):
    """Values on the steps of the method, on its finer ones, and by the other methods; or fixed steps
    are too long for the crystals, which is a status."""
    values = []
    for method in METHODS:
        here = process(UNITS[name], method)
        case = here.case
        if (name, method) == ("filter-dryer", "mesh"):
            assert here.run().status.startswith("cool: the time steps are too long from ")
            continue
        finer = PharmaProcess(replace(case, numerics=case.numerics.finer()))
        values += [here.values(), finer.values()]
    scale = np.maximum(np.abs(values[0]), [each.margin for each in case.attributes])
    assert (np.ptp(values, axis=0) <= VALUES * scale).all()
