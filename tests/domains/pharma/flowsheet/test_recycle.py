"""Loops of a flowsheet at their steady state, against closed forms of Randolph and Larson."""

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
from snapo.domains.pharma.chapters.attribution import split
from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.derivatives.jacobian import matrix, second
from snapo.domains.pharma.derivatives.local import local
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.read.case import resolve

# Fresh flow 120 L in 4 h into 30 L; what of the flow through the crystalliser comes back is the
# case's own: the slurry as it is, its clear liquor, or its crystals.
CASE = (
    """kind = "pharma"
[species]
P = { molar_mass = "150 g/mol" }
Q = { molar_mass = "50 g/mol" }
[units.mix]
type = "tank"
inlets = ["fresh", "back"]
[units.thick]
type = "thickener"
underflow = 0.6
[units.divide]
type = "splitter"
outlets = ["back", "on"]
share = 0.4
[units.cold]"""
    + COLD
    + feed("charge", "120 L", 'P = "0.2 mol/L", Q = "0.05 mol/L"', 'duration = "4 h"')
    + parameter("V", "cold.volume", ["20 L", "60 L"], ["28 L", "32 L"])
    + parameter("T", "cold.temperature", ["275 K", "290 K"], ["282 K", "285 K"])
    + parameter("k", "cold.growth", ["0.1 um/s", "0.4 um/s"], ["0.15 um/s", "0.25 um/s"])
    + parameter("R", "divide.share", ["0.1", "0.9"], ["0.3", "0.5"])
)
UNITS = {"d43": "m", "crystals": "kg/m^3", "supersaturation": "1", "growth": "m/s"}
FLOWS = {
    "slurry": (
        ("charge", "mix.fresh"), ("mix.product", "cold.feed"), ("cold.slurry", "divide.feed"),
        ("divide.back", "mix.back"),
    ),
    "liquor": (
        ("charge", "mix.fresh"), ("mix.product", "cold.feed"), ("cold.slurry", "thick.feed"),
        ("thick.liquor", "divide.feed"), ("divide.back", "mix.back"),
    ),
    "crystals": (
        ("charge", "mix.fresh"), ("mix.product", "cold.feed"), ("cold.slurry", "thick.feed"),
        ("thick.thick", "divide.feed"), ("divide.back", "mix.back"),
    ),
}  # fmt: skip


def data(flow, **cold) -> dict[str, Any]:
    rows = [attribute(each, f"cold.{each}", unit) for each, unit in UNITS.items()]
    found = tomllib.loads(CASE + connections(*FLOWS[flow]) + "".join(rows))
    if flow == "slurry":
        del found["units"]["thick"]
    found["units"]["cold"] |= cold
    return found


def made(flow, **cold) -> PharmaProcess:
    return PharmaProcess(resolve(TEMPLATE, data(flow, **cold)))


def exact(flow, by="", **given):
    """[4] d43, crystals, S and G, or their derivatives `by` a number.

    With n = n0 exp(-L / (G t)) t is how long crystals stay, and the crystals M leave at M V / t,
    which is all that comes out of solution. Slurry that comes back as it is changes nothing:
    t = V / F. Liquor that comes back makes crystals leave sooner: t = V / (F + back). Of crystals
    that come back only the share that does not leaves: t = V / (share of all that flows).
    """
    here = {"volume": 0.03, "temperature": 283.15, "rate": 2e-7, "back": 0.4} | given
    fresh, under, weight, born = 0.12 / 14400, 0.6, 6 * 1200 * 0.5236, 1e6 / (5e-8**2 * 20.0**0.7)

    def stay(volume, back, **_):
        if flow == "slurry":
            return volume / fresh
        if flow == "liquor":
            return volume / (fresh / (1 - (1 - under) * back))
        return volume / (fresh / (1 - under * back) * (1 - back))

    def held(g, t):
        return (weight * born * g**5 * t**4) ** (1 / 0.3)  # M = 6 rho kv B t (G t)^3

    def gap(g, volume, temperature, rate, back):
        t = stay(volume, back)
        saturated = 226.9 - 1.88 * temperature + 3.89e-3 * temperature**2
        c = saturated * (1 + (g / rate) ** (1 / 1.3))
        return fresh * (30.0 - c) - held(g, t) * volume / t

    def outcome(g, **at):
        t = stay(**at)
        return np.array([4 * g * t, held(g, t), (g / at["rate"]) ** (1 / 1.3), g])

    root: Any = brentq(lambda g: gap(g, **here) / 1e-4, 1e-12, here["rate"], xtol=1e-24, rtol=1e-15)
    if not by:
        return outcome(root, **here)
    step = 1e-30j  # complex arguments: derivatives without differences
    moved = here | {by: here[by] * (1 + step)}
    slope = np.imag(gap(root * (1 + step), **here)) / (root * 1e-30)
    turned = root - np.imag(gap(root, **moved)) / slope * 1j
    return np.imag(outcome(turned, **moved)) / 1e-30


@pytest.mark.prove
@pytest.mark.parametrize("flow", FLOWS)
def test_a_steady_state_and_its_derivatives(flow):
    """Values, and relative derivatives by the implicit function theorem, by volume, temperature,
    growth and what comes back, against those of the closed form."""
    process = made(flow)
    found = matrix(process, mode="adjoint" if flow == "slurry" else "forward")
    np.testing.assert_allclose(found.values, exact(flow), rtol=1e-11)
    keys, here = ("volume", "temperature", "rate", "back"), (0.03, 283.15, 2e-7, 0.4)
    expected = np.array([exact(flow, key) for key in keys]).T
    size = np.abs(expected).max(1, keepdims=True)
    np.testing.assert_allclose(found.jacobian * here / size, expected / size, atol=1e-8)
    if flow == "crystals":
        run = process.run()
        ((change, rounds),) = run.loops.values()
        assert run.status == "ok" and change <= 1e-10 and 1 <= rounds <= 8
        assert max(abs(row.relative) for row in balances(process)) < 1e-12
        # Crystals that all come back have no outlet.
        open_ended = process.run({"divide.share": np.array([1.0])})
        words = "the loop mix -> cold -> thick -> divide has not reached a steady state after 50"
        assert open_ended.status.startswith(words) and "of divide.back changes" in open_ended.status
        assert np.isnan(open_ended.attributes["d43"])


@pytest.mark.prove
def test_both_engines_close_a_loop():
    """What leaves the loop is dried over time: many batches with derivatives, on both engines."""
    given = data("liquor")
    given["units"] |= {
        "cake": {
            "type": "filter", "area": "0.5 m^2", "pressure": "1 bar", "viscosity": "0.5 mPa*s",
            "medium_resistance": "1e10 1/m", "porosity": 0.4, "saturation": 0.2,
            "wash": "exponential", "wash_ratio": 1.0, "efficiency": 0.9,
        },
        "dry": {
            "type": "dryer", "duration": "1 h", "temperature": "320 K", "rate": "1e-3 1/s",
            "activation": "40 kJ/mol", "reference_temperature": "320 K", "reference_size": "100 um",
        },
    }  # fmt: skip
    given["connections"] += [
        {"from": "thick.thick", "to": "cake.slurry"},
        {"from": "cake.cake", "to": "dry.cake"},
    ]
    given["attributes"].append({"name": "solvent", "measure": "dry.solvent", "unit": "1"})
    given["numerics"] = {"method": "mesh", "steps": 16}
    process = PharmaProcess(resolve(TEMPLATE, given))
    entries = (("cold.volume", 0), ("divide.share", 0))
    rows = np.array([[0.03, 0.4], [0.025, 0.2], [0.05, 0.7]])
    by = entries[1:]
    native, plain = (process.batch(entries, rows, by, engine=each) for each in ("native", "xla"))
    assert native.ok.all() and plain.ok.all()
    np.testing.assert_allclose(native.values, plain.values, rtol=1e-11)
    size = np.abs(plain.jacobian).max((0, 2), keepdims=True)
    np.testing.assert_allclose(native.jacobian / size, plain.jacobian / size, atol=1e-10)
    assert np.abs(plain.jacobian[:, -1]).min() > 0  # the loop reaches through to the dryer


@pytest.mark.prove
def test_paths_add_up():
    """Of attribution the loop is one unit."""
    process = made("liquor")
    scaled = np.array([p.scale for p in process.case.parameters])
    raw = matrix(process, mode="forward").jacobian * scaled
    assert split(process.case, local(process), raw).closure.max() < 1e-10


@pytest.mark.study
def test_second_derivatives():
    process, back, h = made("liquor"), ("divide.share", 0), 1e-3
    slopes = [exact("liquor", "back", back=0.4 + s * h) / (0.4 + s * h) for s in (-2, -1, 1, 2)]
    expected = (8 * (slopes[2] - slopes[1]) - (slopes[3] - slopes[0])) / (12 * h)
    np.testing.assert_allclose(second(process, ((back, back),))[0], expected, rtol=1e-6)


def test_what_cannot_go_around():
    wrong = data("slurry")
    wrong["units"]["cold"] = {"type": "reactor", "duration": "1 h", "temperature": "300 K"}
    wrong["parameters"] = wrong["parameters"][-1:]
    wrong["attributes"] = [{"name": "T", "measure": "cold.temperature", "unit": "K"}]
    wrong["connections"][2]["from"] = "cold.product"
    with pytest.raises(CaseError, match="cold runs over time and is in a loop, mix -> cold"):
        resolve(TEMPLATE, wrong)
    batch = data("slurry")
    del batch["feeds"]["charge"]["duration"]
    with pytest.raises(CaseError, match="a batch reaches the loop mix -> cold -> divide"):
        resolve(TEMPLATE, batch)
