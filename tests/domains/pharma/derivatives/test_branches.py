"""Convergence, second derivatives, recipes under uncertainty and a branch, by closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from tests.domains.pharma.process_cases import (
    Connection,
    Numerics,
    attribute,
    batch_reactor,
    case,
    chain,
    constant,
    feed,
    network,
    number,
    parameter,
    series,
)

from snapo.domains.pharma.chapters import attribution
from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.derivatives.convergence import convergence
from snapo.domains.pharma.derivatives.jacobian import matrix, second
from snapo.domains.pharma.derivatives.local import local
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.units.splitter import Splitter
from snapo.domains.pharma.units.tank import Tank

K, T = 1e-3, 2000.0  # 1/s, s
DURATION, PREFACTOR = ("reactor.duration", 0), ("kinetics.prefactor", 0)


def decay():
    """A -> B at K per s."""
    return network(
        species=("A", "B"),
        molar_mass=np.array([100.0, 100.0]),
        reactions=("main",),
        stoichiometry=np.array([[-1.0, 1.0]]),
        order=np.array([[1.0, 0.0]]),
        prefactor=series("kinetics.prefactor", [K], "1/s"),
        activation=series("kinetics.activation", [0.0], "J/mol"),
        heat=series("kinetics.heat", [0.0], "J/mol"),
    )


def tank(**fields):
    """One batch of it: A = exp(-K T)."""
    found = (attribute("A", "reactor.concentration.A"),)
    given = (parameter("t", "reactor.duration", 0, 1000.0, 3000.0),)
    return case(
        (feed((1.0, 0.0)),), (batch_reactor(T),), chain("charge", "reactor"), found, given,
        **{"network": decay()} | fields,
    )  # fmt: skip


def test_second_derivatives():
    process = PharmaProcess(tank())
    found = second(process, ((DURATION, DURATION), (PREFACTOR, DURATION), (PREFACTOR, PREFACTOR)))
    a = np.exp(-K * T)
    assert found[:, 0] == pytest.approx([K**2 * a, (K * T - 1) * a, T**2 * a], rel=1e-8)


@pytest.mark.study
def test_convergence():
    """Halving the mesh and an adaptive solution agree, in values and derivatives."""
    fine = convergence(PharmaProcess(tank()))
    assert fine.passed and [row.parameter for row in fine.rows] == ["value", "t"]
    assert fine.rows[0].adaptive == pytest.approx(np.exp(-K * T), rel=1e-8)
    assert fine.rows[1].finer == pytest.approx(-K * np.exp(-K * T), rel=1e-9)


@pytest.mark.prove
def test_what_has_not_converged_says_so():
    """Eight steps; order four: after halving, a fifteenth of what halving changed is left."""
    coarse = convergence(PharmaProcess(tank(numerics=Numerics("mesh", 8, 1e-8, 100_000, True))))
    assert not coarse.passed
    value = coarse.rows[0]
    left = abs(value.finer - value.adaptive) / abs(value.mesh - value.finer)
    assert left == pytest.approx(1 / 15, rel=0.2)


def branched():
    """charge -> split -> two reactors -> tank -> a third, whose product has both ways in it."""
    names, times = ("first", "second", "third"), (500.0, 1500.0, 300.0)
    reactors = [
        batch_reactor(
            name=name,
            temperature=constant(f"{name}.temperature", 313.15),
        )
        for name in names
    ]
    reactors = [
        replace(each, duration=number(f"{each.name}.duration", t, "s"))
        for each, t in zip(reactors, times)
    ]
    split = Splitter("split", ("left", "right"), series("split.share", [0.3], "1"))
    units = (split, *reactors[:2], Tank("tank", ("a", "b")), reactors[2])
    lines = (
        Connection("charge", "", "split", "feed"),
        Connection("split", "left", "first", "feed"),
        Connection("split", "right", "second", "feed"),
        Connection("first", "product", "tank", "a"),
        Connection("second", "product", "tank", "b"),
        Connection("tank", "product", "third", "feed"),
    )
    found = (attribute("A", "third.concentration.A"),)
    given = (
        parameter("share", "split.share", 0, 0.1, 0.5),
        parameter("k", "kinetics.prefactor", 0, 5e-4, 2e-3),
    )
    return case((feed((1.0, 0.0)),), units, lines, found, given, network=decay()), times


@pytest.mark.prove
def test_a_branch_joins_again():
    """A = (s exp(-K t1) + (1 - s) exp(-K t2)) exp(-K t3), its derivatives, paths and balances."""
    given, times = branched()
    process, share = PharmaProcess(given), 0.3
    first, second_, third = np.exp(-K * np.array(times))
    mix = share * first + (1 - share) * second_
    found = matrix(process)
    assert found.values == pytest.approx([mix * third], rel=1e-9)
    by_rate = -third * (share * times[0] * first + (1 - share) * times[1] * second_)
    by_rate -= times[2] * mix * third
    assert found.jacobian[0] == pytest.approx([(first - second_) * third, by_rate], rel=1e-8)
    assert max(abs(row.relative) for row in balances(process)) < 1e-10
    parts = attribution.split(given, local(process), found.jacobian)
    assert parts.closure.max() < 1e-10
    ways = {way.units: way.value for way in parts.paths["A", "k"]}
    assert len(ways) == 3 and sum(ways.values()) == pytest.approx(by_rate, rel=1e-8)
