"""Reactors against published values and closed forms; best temperature profiles."""

from dataclasses import replace

import numpy as np
import pytest
from tests.domains.pharma.process_cases import (
    attribute,
    batch_reactor,
    case,
    chain,
    constant,
    feed,
    network,
    number,
    reactor_alone,
    series,
    temperature_profile,
)

from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.flowsheet.case import Connection
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.recipe.optimum import best
from snapo.domains.pharma.units.reactor import Jacket

END = {"A": 0.002312084, "B": 0.103639153, "C": 0.125033777, "D": 0.101327069}
MIDDLE = {"A": 0.022330171, "B": 0.113279266, "C": 0.125771639, "D": 0.090949095}


def closes(process, tolerance=1e-10):
    rows = balances(process)
    assert max(abs(row.relative) for row in rows) < tolerance
    return rows


def test_batch_reactor():
    process = PharmaProcess(reactor_alone())
    np.testing.assert_allclose(process.values(), list(END.values()), atol=1e-7)
    found = process.values({"reactor.duration": np.array([1800.0])})
    np.testing.assert_allclose(found, list(MIDDLE.values()), atol=1e-7)


@pytest.mark.prove
@pytest.mark.parametrize(("pieces", "value"), [(20, 0.610454), (80, 0.610776)])
def test_best_temperature_profile(pieces, value):
    """A classic: the best value with this many pieces, to the digits published."""
    process = PharmaProcess(temperature_profile(pieces))
    fixed = process.nominal_inputs()
    found = best(
        lambda t: process.attributes({**fixed, "reactor.temperature": t})[0],
        np.full(pieces, 335.0),
        np.full(pieces, 298.0),
        np.full(pieces, 398.0),
    )
    assert found.value == pytest.approx(value, abs=1e-6)
    assert found.converged and found.residual < 1e-6


def first_order_network(**fields):
    """A -> B at 1e-3 per s."""
    return network(
        species=("A", "B"),
        molar_mass=np.array([100.0, 100.0]),
        reactions=("main",),
        stoichiometry=np.array([[-1.0, 1.0]]),
        order=np.array([[1.0, 0.0]]),
        prefactor=series("kinetics.prefactor", [1e-3], "1/s"),
        activation=series("kinetics.activation", [0.0], "J/mol"),
        heat=series("kinetics.heat", [-5e4], "J/mol"),
        **fields,
    )


def test_stirred_tank_by_closed_form():
    """Started full of feed: c = c_s + (c_0 - c_s) exp(-(k + 1/tau) t), c_s = c_0 / (1 + k tau)."""
    tank = batch_reactor(2000.0, kind="stirred", volume=number("reactor.volume", 0.01, "m3"))
    charge = feed((1.0, 0.0), volume=0.02, duration=2000.0)
    found = (attribute("A", "reactor.concentration.A"),)
    process = PharmaProcess(
        case((charge,), (tank,), chain("charge", "reactor"), found, network=first_order_network())
    )
    steady = 1 / (1 + 1e-3 * 1000)
    expected = steady + (1 - steady) * np.exp(-(1e-3 + 1e-3) * 2000)
    assert process.values()[0] == pytest.approx(expected, rel=1e-9)
    closes(process)


def test_plug_flow_is_tanks_in_series():
    """Settled, N cells of residence time tau / N: c_0 / (1 + k tau / N)^N; what left balances."""
    tube = batch_reactor(
        6000.0, kind="plug-flow", cells=50, volume=number("reactor.volume", 0.01, "m3")
    )
    charge = feed((1.0, 0.0), volume=0.06, duration=6000.0)
    found = (attribute("A", "reactor.concentration.A"),)
    process = PharmaProcess(
        case((charge,), (tube,), chain("charge", "reactor"), found, network=first_order_network())
    )
    assert process.values()[0] == pytest.approx((1 + 1e-3 * 1000 / 50) ** -50, rel=1e-9)
    closes(process)


def test_plug_flow_against_published_run():
    """PharmaPy's regression test of a tube (its tests/integration): 50 cells full of solvent at
    298.15 K, water of 300 K around it, A + B -> C with k = 40/60 exp(-2000 / RT) L/mol/s.

    Published with a solver's tolerance: the last digits of neighbouring times differ by 1e-4. The
    coefficient of heat transfer is not stated; that of the first cell's settled concentration,
    0.0804502 mol/L, is UA / (rho cp V) = 0.05454 per s, and the rest follows.
    """
    time = 2908.760618886899465
    found = network(
        species=("A", "B", "C"),
        molar_mass=np.array([105.0, 99.0, 204.0]),
        reactions=("main",),
        stoichiometry=np.array([[-1.0, -1, 1]]),
        order=np.array([[1.0, 1, 0]]),
        prefactor=series("kinetics.prefactor", [40 / 60], "m3/kmol/s"),
        activation=series("kinetics.activation", [2000.0], "J/mol"),
        heat=series("kinetics.heat", [0.0], "J/mol"),
    )
    tube = batch_reactor(
        time,
        constant("reactor.temperature", 298.15),
        kind="plug-flow",
        cells=50,
        volume=number("reactor.volume", 0.002, "m3"),
        filled="solvent",
        jacket=Jacket(
            number("reactor.heat_capacity", 1e6, "J/m3/K"),
            number("reactor.conductance", 0.05454 * 1e6 * 0.002, "W/K"),
            constant("reactor.jacket_temperature", 300.0),
        ),
    )
    charge = feed((0.15, 0.15, 0.0), volume=0.002 / 1800 * time, duration=time)
    cold = number("charge.temperature", 298.15, "K")
    wanted = [attribute(s, f"reactor.concentration.{s}") for s in "ABC"]
    lines = chain("charge", "reactor")
    process = PharmaProcess(
        case((replace(charge, temperature=cold),), (tube,), lines, wanted, network=found)
    )
    published = [1.98765e-3, 1.98765e-3, 0.148005]
    np.testing.assert_allclose(process.values(), published, rtol=1e-4)
    closes(process)


@pytest.mark.parametrize("kind", ["batch", "semi-batch", "stirred", "plug-flow"])
def test_jacketed_reactors_close_their_heat(kind):
    jacket = Jacket(
        number("reactor.heat_capacity", 2e6, "J/m3/K"),
        number("reactor.conductance", 50.0, "W/K"),
        constant("reactor.jacket_temperature", 310.0),
    )
    fields = {"jacket": jacket, "kind": kind}
    feeds, lines = [feed((1.0, 0.0), duration=2000.0)], chain("charge", "reactor")
    if kind in ("stirred", "plug-flow"):
        fields["volume"] = number("reactor.volume", 0.03, "m3")
        fields["cells"] = 10
    if kind == "semi-batch":
        feeds.append(feed((0.5, 0.0), volume=0.02, name="drops"))
        lines += (Connection("drops", "", "reactor", "dose"),)
        fields["dosing"] = constant("reactor.dosing", 1e-5, "m3/s")
    unit = batch_reactor(2000.0, constant("reactor.temperature", 320.0), **fields)
    found = (attribute("T", "reactor.temperature", "K"),)
    process = PharmaProcess(
        case(tuple(feeds), (unit,), lines, found, network=first_order_network())
    )
    rows = closes(process)
    assert "energy" in {row.quantity for row in rows}
    if kind == "batch":
        # u = T - 310: u' = 1e-3 q e^(-t/1000) - u / tau, q = 25 K, tau = rho cp V / UA.
        decay = 50.0 / (2e6 * 0.06)
        forced = 1e-3 * 25 / (decay - 1e-3)
        u = forced * np.exp(-2.0) + (10 - forced) * np.exp(-decay * 2000)
        assert process.values()[0] == pytest.approx(310 + u, abs=1e-8)
