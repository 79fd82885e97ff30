"""Crystals that dissolve whole: moments keep them, and the status asks for finite volumes."""

from dataclasses import replace

import numpy as np
import pytest
from tests.domains.pharma.process_cases import (
    attribute,
    case,
    chain,
    crystalliser,
    feed,
    linear,
    number,
)
from tests.domains.pharma.units.crystals.test_finite_volumes import seeded

from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.time.dynamics import Numerics
from snapo.domains.pharma.units.crystals.kinetics import Rates
from snapo.domains.pharma.units.crystals.population import disappeared

ERROR = Numerics("adaptive", 100, 1e-7, 20_000, True)
TIME = np.linspace(0, 100.0, 401)


def moments(sizes, numbers):
    return {f"mu{k}": np.full(len(TIME), np.sum(numbers * sizes**k)) for k in range(3)}


@pytest.mark.parametrize(("shrunk", "gone"), [(19e-6, False), (21e-6, True)])
def test_a_seed_of_one_size(shrunk, gone):
    """20 um, which shrink by less or more of it and grow again."""
    track = {"time": TIME} | moments(np.array([20e-6]), np.array([1e9]))
    growth = np.where(TIME < 50, -shrunk / 50, 1e-6)
    said = disappeared(track, Rates(growth, np.zeros_like(TIME)), 0.0)
    assert bool(said) == gone
    if gone:
        assert (
            "shrink by 2" in said and "the smallest ones at the start have a size of 20 um" in said
        )
        assert said.endswith('use method = "finite-volumes"')


@pytest.mark.parametrize(("shrunk", "gone"), [(0.4e-6, False), (30e-6, True)])
def test_nuclei_that_go_and_come_back(shrunk, gone):
    """Born for 40 s while crystals grow by 40 um; then all shrink, and grow by 60 um.

    Of 0.4 um those born in the last 0.4 s are gone, of 30 um three quarters, and of the surface of all
    (of 1e12 per m3, evenly from 60 um on at the end) as much.
    """
    growth = np.select([TIME < 40, TIME < 50], [1e-6, -shrunk / 10], 60e-6 / 50)
    born = np.where(TIME < 40, 1e12 / 40, 0.0)
    sizes = np.linspace(60e-6 - shrunk, 100e-6 - shrunk, 1001)
    track = {"time": TIME} | moments(sizes, np.full(1001, 1e12 / 1001))
    track["mu0"] = np.where(TIME > 0, track["mu0"], 0.0)
    said = disappeared(track, Rates(growth, born), 0.0)
    assert bool(said) == gone
    if gone:
        lost = sizes[: int(shrunk / 40e-6 * 1000)]
        share = np.sum(lost**2) / np.sum(sizes**2)
        assert float(said.split(" of the surface")[0].split()[-1]) == pytest.approx(share, rel=0.03)


def cycled(edges=None):
    """Seed of 20 um that is cooled, warmed up and cooled again; all may dissolve."""
    name = "crystalliser"
    kinetics = replace(
        crystalliser().kinetics, dissolution=number(f"{name}.dissolution", 1e-6, "m/s")
    )
    unit = crystalliser(
        kinetics=kinetics,
        temperature=linear(f"{name}.temperature", [308.0, 295.0, 296.0, 285.0]),
        seed=seeded(20e-6, 0.1),
        edges=edges,
    )
    found = (attribute("d32", f"{name}.d32", "um", 1e6),)
    charge = feed((0.0, 0.0, 0.125, 0.0))
    return PharmaProcess(case((charge,), (unit,), chain("charge", name), found, numerics=ERROR))


@pytest.fixture(scope="module")
def cycles():
    """By moments and by finite volumes."""
    return cycled(), cycled(np.linspace(0, 300e-6, 121))


@pytest.mark.prove
@pytest.mark.parametrize(("top", "within"), [(296.0, 0.02), (312.0, None)])
def test_a_temperature_cycle_against_finite_volumes(cycles, top, within):
    """Warmed up to `top` K: where the status is in order d32 is that of finite volumes; else it is
    far from it."""
    warmed = {"crystalliser.temperature": np.array([308.0, 295.0, top, 285.0])}
    run, exact = (process.run(warmed) for process in cycles)
    assert exact.status == "ok"
    gap = abs(run.attributes["d32"] / exact.attributes["d32"] - 1)
    if within is None:
        assert "finite-volumes" in run.status and gap > 0.05
    else:
        assert run.status == "ok" and gap < within
