"""Plug flow along a tube, against closed forms; and as tanks in series where it is asked for."""

import numpy as np
import pytest
from tests.domains.pharma.process_cases import (
    attribute,
    batch_reactor,
    case,
    chain,
    feed,
    network,
    number,
    series,
    steps,
)

from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.units.reactors.length import Along


def tube(order=1.0, constant=1.0, seconds=3.0, start=1.0, temperature=None, **fields):
    """A -> B at `constant` c^order, of 1 s of residence."""
    found = network(
        species=("A", "B"),
        molar_mass=np.array([100.0, 100.0]),
        reactions=("main",),
        stoichiometry=np.array([[-1.0, 1.0]]),
        order=np.array([[order, 0.0]]),
        prefactor=series("kinetics.prefactor", [constant], "1/s"),
        activation=series("kinetics.activation", [8314.0 if temperature else 0.0], "J/mol"),
        heat=series("kinetics.heat", [0.0], "J/mol"),
    )
    named = {"kind": "plug-flow", "volume": number("reactor.volume", 0.01, "m3"), "cells": None}
    unit = batch_reactor(seconds, temperature, **(named | fields))
    charge = feed((start, 0.0), volume=0.01 * seconds, duration=seconds)
    wanted = (attribute("A", "reactor.concentration.A"),)
    return PharmaProcess(
        case((charge,), (unit,), chain("charge", "reactor"), wanted, network=found)
    )


@pytest.mark.prove
@pytest.mark.parametrize("constant", [3.0, 7.0])
def test_first_order(constant):
    """exp(-k tau), which 50 tanks in series miss by 9 % and 57 %; and what left the tube.

    Full of feed, the outlet is exp(-k t) until a residence time has passed.
    """
    process = tube(constant=constant)
    left = np.exp(-constant)
    assert process.values()[0] == pytest.approx(left, rel=1e-5)
    run = process.run()
    assert run.status == "ok"
    delivered = 0.01 * ((1 - left) / constant + 2 * left)
    assert run.streams["reactor.product"].species[0] == pytest.approx(delivered, rel=1e-4)
    assert max(abs(row.relative) for row in balances(process)) < 1e-10
    series = tube(constant=constant, cells=50).values()[0]
    assert series == pytest.approx((1 + constant / 50) ** -50, rel=1e-6)


def test_second_order():
    """1 / (1 + k c0 tau), at k c0 tau = 20."""
    assert tube(2.0, 20.0).values()[0] == pytest.approx(1 / 21, rel=2e-5)


def test_a_temperature_that_changes_while_it_flows():
    """A jump bends c along the tube, and that bend travels: within 0.2 %, and 0.05 % on twice the cells."""
    profile = steps("reactor.temperature", [300.0, 320.0, 340.0])
    share = 8 / 9  # s that a piece of the profile lasts; what leaves has had 1/9 s of the second
    hot = 60 * np.exp(-1000 / 340) * share + 60 * np.exp(-1000 / 320) * (1 - share)
    for elements, within in ((8, 2e-3), (16, 5e-4)):
        process = tube(constant=60.0, temperature=profile, elements=elements)
        found = process.values({"reactor.duration": np.array([8 / 3])})[0]
        assert found == pytest.approx(np.exp(-hot), rel=within)


def test_a_front_of_solvent():
    """Full of solvent: nothing leaves for a residence time, then all that was fed before."""
    process = tube(constant=0.5, filled="solvent", seconds=3.0)
    run = process.run()
    assert run.measures["reactor.concentration.A"] == pytest.approx(np.exp(-0.5), rel=1e-3)
    delivered = run.streams["reactor.product"].species[0]
    assert delivered == pytest.approx(0.02 * np.exp(-0.5), rel=1e-3)


@pytest.mark.parametrize(("elements", "points"), [(1, 4), (8, 4), (3, 1)])
def test_elements_are_exact_for_polynomials_and_conserve(elements, points):
    """u' = -du/dz of a polynomial of the points' degree, and sum of weights u' = inflow - outflow."""
    along = Along.of(elements, points)
    nodes = along.positions
    for degree in range(points):
        u = (1 + nodes) ** degree
        slope = degree * (1 + nodes) ** max(degree - 1, 0)
        np.testing.assert_allclose(
            np.asarray(along.carried(u[:, None], np.ones(1)))[:, 0], -slope, atol=1e-4
        )
    u = np.random.default_rng(1).random(len(nodes))
    change = np.asarray(along.carried(u[:, None], np.full(1, 0.3)))[:, 0]
    assert along.weights @ change == pytest.approx(0.3 - u[-1], abs=1e-5)
