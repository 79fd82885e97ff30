"""The continuous crystalliser against the closed form of Randolph and Larson, and in a case."""

import tomllib
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.domains.pharma.pharma_cases import (
    COLD,
    TEMPLATE,
    attribute,
    connections,
    feed,
    parameter,
)

from snapo.case.error import CaseError
from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.derivatives.jacobian import matrix, second
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.read.case import resolve

CASE = (
    """
kind = "pharma"
[species]
P = { molar_mass = "150 g/mol" }
Q = { molar_mass = "50 g/mol" }
[units.cold]"""
    + COLD
    + """sizes = { smallest = "1 um", largest = "4 mm", cells = 120, spacing = "geometric" }
[units.mill]
type = "wet-mill"
duration = "10 min"
speed = "20 m/s"
rate = "1e-4 1/s"
reference_size = "100 um"
reference_speed = "20 m/s"
size_power = 1
[units.filter]
type = "filter"
area = "200 cm^2"
pressure = "1 bar"
viscosity = "0.46 mPa*s"
medium_resistance = "1e10 1/m"
porosity = 0.4
saturation = 0.2
wash_ratio = 2
efficiency = 0.9
[numerics]
method = "mesh"
steps = 64
"""
    + feed("charge", "120 L", 'P = "0.2 mol/L", Q = "0.05 mol/L"', 'duration = "4 h"')
    + connections(
        ("charge", "cold.feed"), ("cold.slurry", "mill.slurry"), ("mill.slurry", "filter.slurry")
    )
    + parameter("V", "cold.volume", ["20 L", "60 L"], ["28 L", "32 L"])
    + parameter("T", "cold.temperature", ["275 K", "290 K"], ["282 K", "285 K"])
    + parameter("k", "cold.growth", ["0.1 um/s", "0.4 um/s"], ["0.15 um/s", "0.25 um/s"])
    + parameter(
        "B", "cold.nucleation", ["1e5 1/m^3/s", "1e7 1/m^3/s"], ["9e5 1/m^3/s", "2e6 1/m^3/s"]
    )
)
MEASURES = ("d43", "crystals", "supersaturation", "growth", "nucleation")


UNITS = ("um", "kg/m^3", "1", "um/s", "1/m^3/s")


def with_attributes(text):
    """A case with an attribute for each of `MEASURES`."""
    rows = [attribute(each, f"cold.{each}", unit) for each, unit in zip(MEASURES, UNITS)]
    return text + "".join(rows)


def process(**keys):
    data = tomllib.loads(with_attributes(CASE))
    data["units"]["cold"] |= keys
    moved = [f"cold.{each}" for each in keys]
    data["parameters"] = [each for each in data["parameters"] if each["of"] not in moved]
    return PharmaProcess(resolve(TEMPLATE, data))


@pytest.fixture(scope="module")
def usual():
    """The process as it is, whose programs are compiled once."""
    return process()


TAU, ENTERING, RHO, KV = 14400 * 30 / 120, 30.0, 1200.0, 0.5236


def exact(power=0.7, nucleation=1e6, growth=2e-7, entering=ENTERING, taken=0.0):
    """G, B, M_T and S by SciPy's root of the mass balance, with G as Randolph and Larson give it:
    G = (M_T^(1 - j) / (6 rho kv kb tau^4))^(1 / (i + 3)), kb = B_r / (G_r^i M_r^j). `taken`: of
    their volume, what crystals take from that of the solution."""
    saturated = 226.9 - 1.88 * 283.15 + 3.89e-3 * 283.15**2
    constant = nucleation / (5e-8**2 * 20.0**power)

    def speed(crystals):
        return (crystals ** (1 - power) / (6 * RHO * KV * constant * TAU**4)) ** (1 / 5)

    def gap(crystals):
        level = (speed(crystals) / growth) ** (1 / 1.3)
        solution = 1 - taken * crystals / RHO
        return entering - saturated * (1 + level) * solution - crystals

    crystals: Any = brentq(gap, 1e-9, entering - saturated * (1 - taken), xtol=1e-14)
    g = speed(crystals)
    return g, constant * g**2 * crystals**power, crystals, (g / growth) ** (1 / 1.3)


@pytest.mark.prove
def test_a_steady_state_per_volume_of_solution():
    """2 mol/L of 150 g/mol: a quarter of the suspension is crystals, which hold no solution."""
    given = process(basis="solution")
    many = given.run({"charge.concentration": np.array([2.0, 0.05])})
    g, born, crystals, level = exact(entering=300.0, taken=1.0)
    assert many.status == "ok" and crystals / RHO > 0.24
    found = {each: many.measures[f"cold.{each}"] for each in MEASURES}
    expected = [4 * g * TAU, crystals, level, g, born]
    assert list(found.values()) == pytest.approx(expected, rel=1e-9)
    stream = many.streams["cold.slurry"]
    assert stream.volume == pytest.approx(0.12 * (1 - crystals / RHO), rel=1e-9)
    assert stream.volume + stream.solids == pytest.approx(0.12, rel=1e-12)
    assert max(abs(row.relative) for row in balances(given)) < 1e-10


@pytest.mark.prove
def test_the_steady_state(usual):
    """Growth, nucleation, suspension and moments mu_k = k! n0 (G tau)^(k + 1)."""
    run = usual.run()
    g, born, crystals, level = exact()
    found = {each: run.measures[f"cold.{each}"] for each in MEASURES}
    assert found["growth"] == pytest.approx(g, rel=1e-10)
    assert found["nucleation"] == pytest.approx(born, rel=1e-10)
    assert found["crystals"] == pytest.approx(crystals, rel=1e-10)
    assert found["supersaturation"] == pytest.approx(level, rel=1e-10)
    assert found["d43"] == pytest.approx(4 * g * TAU, rel=1e-10)
    assert crystals == pytest.approx(6 * RHO * KV * born / g * (g * TAU) ** 4, rel=1e-10)
    stream = run.streams["cold.slurry"]
    factorials = np.array([1, 1, 2, 6, 24, 120])
    expected = factorials * born / g * (g * TAU) ** np.arange(1, 7) * 0.12
    np.testing.assert_allclose(np.asarray(stream.moments), expected, rtol=1e-10)
    assert max(abs(row.relative) for row in balances(usual)) < 1e-10


@pytest.mark.prove
def test_crystals_are_counted(usual):
    """n = n0 exp(-L / (G tau)) in each cell; the third moment is that of the closed form.

    For that all numbers are scaled by a factor which nears 1 with the square of the cells' width.
    """
    (g, born, *_), gaps = exact(), []
    sizes = tomllib.loads(CASE)["units"]["cold"]["sizes"]
    for run in (process(sizes=sizes | {"cells": 60}).run(), usual.run()):
        stream = run.streams["cold.slurry"]
        edges, numbers = stream.grid.array, np.asarray(stream.numbers)
        reach = edges / (g * TAU)
        share = np.exp(-reach[:-1]) * -np.expm1(-np.diff(reach))
        factor = numbers / (share * born * TAU * 0.12)
        np.testing.assert_allclose(factor, factor[0], rtol=1e-10)
        gaps.append(abs(factor[0] - 1))
        powers = np.diff(edges**4) / (4 * np.diff(edges))
        assert powers @ numbers == pytest.approx(float(stream.moments[3]), rel=1e-12)
        assert run.measures["mill.d43"] < run.measures["cold.d43"] and run.status == "ok"
    assert gaps[1] < 0.005 and np.log2(gaps[0] / gaps[1]) > 1.8


@pytest.mark.prove
def test_gradient_through_the_steady_state(usual):
    """Implicit function theorem against central differences, and a second derivative."""
    found, columns = matrix(usual).jacobian, []
    for name, entry in usual.entries:
        ends, step = [], 1e-5 * usual.inputs[name][entry]
        for sign in (1, -1):
            moved = usual.inputs[name].copy()
            moved[entry] += sign * step
            ends.append(np.array(list(usual.run({name: moved}).attributes.values())))
        columns.append((ends[0] - ends[1]) / (2 * step))
    sized = np.array([usual.inputs[name][entry] for name, entry in usual.entries])
    gap = np.abs((np.array(columns).T - found) * sized).max(1) / np.abs(found * sized).max(1)
    assert gap.max() < 1e-7
    rate = ("cold.nucleation", 0)
    bend = second(usual, ((rate, rate),))[0, 0]
    h = 1e3
    sizes = [4e6 * exact(nucleation=1e6 + s * h)[0] * TAU for s in (1, 0, -1)]
    assert bend == pytest.approx((sizes[0] - 2 * sizes[1] + sizes[2]) / h**2, rel=1e-3)


@pytest.mark.prove
def test_a_cascade():
    """A second one, colder, grows what the first made: with s = G tau of each its crystals are
    n02 exp(-L/s2) + n01 s1/(s1 - s2) (exp(-L/s1) - exp(-L/s2)), and mu_k = mu_k,in + k s2 mu_(k-1).
    Crystals that come below saturation are a status."""
    data = tomllib.loads(with_attributes(CASE))
    for each in data["attributes"]:
        each["measure"] = each["measure"].replace("cold", "second")
    data["units"]["second"] = data["units"]["cold"] | {"temperature": "276.15 K"}
    data["connections"][1:] = [
        {"from": "cold.slurry", "to": "second.feed"}, {"from": "second.slurry", "to": "mill.slurry"},
        {"from": "mill.slurry", "to": "filter.slurry"},
    ]  # fmt: skip
    given = PharmaProcess(resolve(TEMPLATE, data))
    run = given.run()
    assert run.status == "ok" and max(abs(row.relative) for row in balances(given)) < 1e-10
    (g1, born1, crystals1, level1), factorials = exact(), np.array([1, 1, 2, 6, 24, 120])
    first = factorials * born1 * TAU * (g1 * TAU) ** np.arange(6)
    saturated = [226.9 - 1.88 * t + 3.89e-3 * t**2 for t in (283.15, 276.15)]
    total = crystals1 + saturated[0] * (1 + level1)

    def second(level):
        g, crystals = 2e-7 * level**1.3, total - saturated[1] * (1 + level)
        born = 1e6 * (g / 5e-8) ** 2 * (crystals / 20) ** 0.7
        moments = [first[0] + born * TAU]
        for k in range(1, 6):
            moments.append(first[k] + k * g * TAU * moments[-1])
        return g, born, crystals, np.array(moments)

    def gap(level):
        *_, crystals, moments = second(level)
        return RHO * KV * moments[3] - crystals

    level: Any = brentq(gap, 1e-9, (total - crystals1) / saturated[1] - 1, xtol=1e-15)
    g2, born2, crystals2, moments = second(level)
    assert run.measures["second.supersaturation"] == pytest.approx(level, rel=1e-9)
    assert run.measures["second.crystals"] == pytest.approx(crystals2, rel=1e-10)
    stream = run.streams["second.slurry"]
    np.testing.assert_allclose(np.asarray(stream.moments), moments * 0.12, rtol=1e-9)
    s1, s2 = g1 * TAU, g2 * TAU
    edges = stream.grid.array
    fall1, fall2 = (s * -np.diff(np.exp(-edges / s)) for s in (s1, s2))
    old = born1 / g1 * s1 / (s1 - s2)
    expected = 0.12 * (born2 / g2 * fall2 + old * (fall1 - fall2))
    # Within a cell crystals that are fed count as evenly spread: 120 cells, 7 % wide each.
    np.testing.assert_allclose(np.asarray(stream.numbers), expected, atol=0.01 * expected.max())
    warm = given.run({"second.temperature": np.array([330.0])})
    assert warm.status != "ok" and np.isnan(warm.attributes["d43"])


@pytest.mark.prove
def test_nuclei_are_washed_out(usual):
    """With j = 1 and slow growth no crystals stay, nor in a feed below saturation."""
    given = process(suspension_power=1.0, nucleation="1 1/m^3/s", growth="1e-3 um/s")
    run = given.run()
    assert run.measures["cold.crystals"] == 0 and run.measures["cold.d43"] == 0
    assert run.measures["cold.concentration"] == pytest.approx(ENTERING)
    assert np.all(np.isfinite(matrix(given).jacobian))
    warm = usual.run({"cold.temperature": np.array([335.0])})
    assert warm.measures["cold.supersaturation"] < 0 and warm.measures["cold.crystals"] == 0


ANTISOLVENT = {"antisolvent": [-3.0, 0.5]}


def test_mistakes():
    with pytest.raises(CaseError) as found:
        process(suspension_power=1.5)
    assert "units.cold.suspension_power: got 1.5; it must be a share from 0 to 1" in str(
        found.value
    )
    with pytest.raises(CaseError) as found:
        process(solubility=tomllib.loads(CASE)["units"]["cold"]["solubility"] | ANTISOLVENT)
    assert "units.cold.solubility.antisolvent: got [-3, 0.5]; no anti-solvent can reach" in str(
        found.value
    )
    data = tomllib.loads(CASE)
    del data["units"]["cold"]["sizes"]
    data["attributes"] = [{"name": "d", "measure": "mill.d43", "unit": "um"}]
    with pytest.raises(CaseError) as found:
        resolve(TEMPLATE, data)
    assert "units.mill: the crystals that reach this unit are not counted" in str(found.value)
