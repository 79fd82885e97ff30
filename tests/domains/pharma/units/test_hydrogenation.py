"""A liquid under a gas: films in series, absorption alone, balances, derivatives, both engines."""

import tomllib

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.domains.pharma.pharma_cases import TEMPLATE, attribute, connections, feed, parameter

from snapo.case.error import CaseError
from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.derivatives.jacobian import matrix
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.read.case import resolve

# Hydrogen in water at 298.15 K: 7.8e-6 mol/m3/Pa (Sander, Atmos. Chem. Phys. 23, 10901, 2023; on
# henrys-law.org), so that He is 1000 / 7.8e-6 Pa L/mol and c* at 5 bar 3.9 mmol/L.
HENRY, TRANSFER, PRESSURE = 1000 / 7.8e-6, 0.02, 5e5
SATURATED = PRESSURE / HENRY  # mol/L
CASE = (
    """kind = "pharma"
[species]
N = { molar_mass = "98 g/mol" }
H = { molar_mass = "2 g/mol" }
P = { molar_mass = "100 g/mol" }
[[reactions]]
name = "main"
equation = "N + H -> P"
prefactor = "0.5 L/mol/s"
activation = "0 J/mol"
[units.vessel]
type = "hydrogenation"
duration = "30 min"
temperature = "298.15 K"
gas = "H"
pressure = "5 bar"
transfer = "0.02 1/s"
henry = "128205128.2051282 Pa*L/mol"
enthalpy = "-4 kJ/mol"
"""
    + feed("charge", "100 L", 'N = "0.4 mol/L"')
    + connections(("charge", "vessel.feed"))
    + parameter("p", "vessel.pressure", ["1 bar", "9 bar"], ["4 bar", "6 bar"])
    + parameter("kLa", "vessel.transfer", ["0.01 1/s", "0.1 1/s"], ["0.015 1/s", "0.025 1/s"])
    + parameter("T", "vessel.temperature", ["280 K", "330 K"], ["297 K", "299 K"])
    + attribute("product", "vessel.concentration.P", "mol/L")
    + attribute("gas", "vessel.concentration.H", "mol/L")
    + attribute("uptake", "vessel.uptake", "mol/L")
    + attribute("saturation", "vessel.saturation", "1")
)


def process(prefactor="0.5 L/mol/s", order=None, **vessel) -> PharmaProcess:
    data = tomllib.loads(CASE)
    data["units"]["vessel"] |= vessel
    data["reactions"][0] |= {"prefactor": prefactor, "order": order or {}}
    return PharmaProcess(resolve(TEMPLATE, data | {"numerics": {"method": "mesh"}}))


@pytest.mark.prove
def test_resistances_in_series():
    """Zero order in the substrate, first in the gas: the rate is c* / (1 / kLa + 1 / k).

    The film's resistance and that of the reaction add up, kLa (c* - c) = k c. After 1800 s of it,
    from no gas dissolved at first where that is followed.
    """
    k = 0.01
    speed = SATURATED / (1 / TRANSFER + 1 / k)
    steady = process(order={"N": 0, "H": 1}, prefactor="0.01 1/s", dissolved="pseudo-steady")
    product, gas, uptake, share = steady.values()
    assert product == pytest.approx(speed * 1800, rel=1e-9)
    assert gas == pytest.approx(SATURATED * TRANSFER / (TRANSFER + k), rel=1e-9)
    assert share == pytest.approx(2 / 3, rel=1e-9) and uptake == pytest.approx(product + gas)
    followed = process(order={"N": 0, "H": 1}, prefactor="0.01 1/s").values()
    both = TRANSFER + k
    # c = c* kLa / (kLa + k) (1 - exp(-(kLa + k) t)), and P its integral times k.
    level, fade = SATURATED * TRANSFER / both, np.exp(-both * 1800)
    assert followed[0] == pytest.approx(k * level * (1800 - (1 - fade) / both), rel=1e-8)
    assert followed[1] == pytest.approx(level * (1 - fade), rel=1e-8)


@pytest.mark.prove
def test_an_order_that_needs_newtons_steps():
    """Second order in the gas: kLa (c* - c) = k c^2 is a quadratic equation."""
    k = 10.0
    steady = process(order={"N": 0, "H": 2}, prefactor="10 L/mol/s", dissolved="pseudo-steady")
    c = (-TRANSFER + np.sqrt(TRANSFER**2 + 4 * k * TRANSFER * SATURATED)) / (2 * k)
    product, gas, *_ = steady.values()
    assert gas == pytest.approx(c, rel=1e-12)
    assert product == pytest.approx(k * c**2 * 1800, rel=1e-9)


@pytest.mark.prove
def test_an_order_of_zero_in_the_gas_stops_without_it():
    """0.01 1/s of the substrate could use fifty times the gas that comes: all of it reacts."""
    steady = process(order={"N": 1, "H": 0}, prefactor="0.01 1/s", dissolved="pseudo-steady")
    product, gas, *_ = steady.values()
    assert product == pytest.approx(TRANSFER * SATURATED * 1800, rel=1e-5)
    assert 0 <= gas < 1e-6


@pytest.mark.prove
def test_balances_derivatives_and_both_engines():
    """Gas that came in is added; adjoint against central differences; batches on both engines."""
    given = process()
    assert given.run().status == "ok"
    assert max(abs(row.relative) for row in balances(given)) < 1e-12
    names = ("vessel.pressure", "vessel.transfer", "vessel.temperature", "vessel.henry")
    entries = tuple((name, 0) for name in names)
    found = matrix(given, entries=entries).jacobian
    here = np.array([given.inputs[name].ravel()[0] for name in names])
    rows = np.concatenate([here * (1 + s * 1e-4 * np.eye(4)) for s in (1, -1)])
    native = given.batch(entries, rows, engine="native")
    plain = given.batch(entries, rows, engine="xla")
    assert native.ok.all() and plain.ok.all()
    np.testing.assert_allclose(native.values, plain.values, rtol=1e-11)
    slopes = (plain.values[:4] - plain.values[4:]).T / (2e-4 * here)
    size = np.abs(slopes * here).max(1, keepdims=True)
    np.testing.assert_allclose(found * here / size, slopes * here / size, atol=1e-6)


@pytest.mark.prove
def test_held_steps_are_those_of_error_control():
    """By default steps are chosen once, and held: at the nominal batch and away from it the result
    is that of error control in every batch (SciPy's LSODA), within 1e-7 at 1e-8 a step."""
    held = PharmaProcess(resolve(TEMPLATE, tomllib.loads(CASE)))
    assert held.case.numerics.method == "mesh" and len(held.case.numerics.held["vessel"]) < 200
    entries = (("vessel.pressure", 0), ("vessel.transfer", 0))
    rows = held.at(entries) * np.array([[1.0, 1.0], [1.1, 0.8], [0.9, 1.2]])
    found = held.batch(entries, rows, chunk=3, engine="native")
    assert found.ok.all()
    for (pressure, transfer), values in zip(rows, found.values):

        def slope(_, y, most=pressure / HENRY, transfer=transfer):
            gas = y[1] - y[0]
            return [0.5 * (0.4 - y[0]) * gas, transfer * (most - gas)]

        known = solve_ivp(slope, (0, 1800), [0, 0], "LSODA", rtol=1e-12, atol=1e-15).y[:, -1]
        np.testing.assert_allclose(values[[0, 2]], known, rtol=1e-7)


def test_the_gas_is_a_species():
    with pytest.raises(CaseError, match="there is no such species"):
        process(gas="H2")
