"""Compaction, strength, content and release of tablets; and a chain from a feed to tablets."""

import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
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
from snapo.domains.pharma.derivatives.jacobian import matrix
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.read.case import resolve
from snapo.domains.pharma.units.solids.release import gone, released
from snapo.domains.pharma.units.solids.tablet_press import TabletPress, acceptance

NAMES = {
    "porosity": "1", "strength": "MPa", "force": "N", "assay": "%", "acceptance": "%",
    "dissolved": "%",
}  # fmt: skip
CASE = (
    """kind = "pharma"
[species]
P = { molar_mass = "150 g/mol" }
Q = { molar_mass = "50 g/mol" }
L = { molar_mass = "342.3 g/mol" }
[units.cold]"""
    + COLD
    + """
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
[units.wet]
type = "granulation"
duration = "10 min"
speed = "8 m/s"
excipient = "L"
excipient_ratio = 2
excipient_density = "1540 kg/m^3"
liquid_ratio = 0.1
nuclei_size = "1 mm"
nuclei_spread = 0.2
liquid_density = "1000 kg/m^3"
coalescence = "0.01 1/s"
saturation_power = 1
consolidation = "0.003 1/s"
porosity = 0.5
least_porosity = 0.2
reference_speed = "8 m/s"
packing = 0.6
[units.dry]
type = "dryer"
duration = "3 h"
temperature = "323.15 K"
rate = "1e-3 1/s"
activation = "40 kJ/mol"
reference_temperature = "323.15 K"
reference_size = "1 mm"
[units.press]
type = "tablet-press"
drug = "P"
weight = "300 mg"
label = "100 mg"
diameter = "10 mm"
pressure = "150 MPa"
true_density = "1450 kg/m^3"
packing = 0.6
yield_pressure = "90 MPa"
rearrangement = 0.1
strength = "9 MPa"
bonding = 8
deviation = 0.02
disintegration = "4 min"
porosity_power = 1
diffusivity = "7e-10 m^2/s"
solubility = "0.5 kg/m^3"
film = "30 um"
time = "30 min"
[numerics]
method = "mesh"
steps = 64
"""
    + feed("charge", "120 L", 'P = "0.2 mol/L", Q = "0.05 mol/L"', 'duration = "4 h"')
    + connections(
        ("charge", "cold.feed"), ("cold.slurry", "filter.slurry"), ("filter.cake", "wet.crystals"),
        ("wet.granules", "dry.cake"), ("dry.product", "press.granules"),
    )
    + parameter("P", "press.pressure", ["80 MPa", "250 MPa"], ["140 MPa", "160 MPa"])
    + parameter("t", "wet.duration", ["5 min", "20 min"], ["9 min", "11 min"])
    + "".join(attribute(name, f"press.{name}", unit) for name, unit in NAMES.items())
)  # fmt: skip


def process(**press) -> PharmaProcess:
    data = tomllib.loads(CASE)
    changed = data["units"]["press"] | press
    data["units"]["press"] = {key: each for key, each in changed.items() if each is not None}
    return PharmaProcess(resolve(TEMPLATE, data))


@pytest.fixture(scope="module")
def given():
    return process()


@pytest.fixture(scope="module")
def run(given):
    return given.run()


def press(given) -> TabletPress:
    return next(each for each in given.case.units if isinstance(each, TabletPress))


@pytest.mark.prove
def test_compaction(given, run):
    """Heckel: dD/dP = (1 - D)/P_y from the packing and what rearranges. Kawakita: of
    its volume a bed has lost a/2 at P = 1/b, and a in the end."""
    granules = run.streams["dry.product"]
    start = 0.6 * float(granules.density) / 1450
    curve = solve_ivp(
        lambda p, d: (1 - d) / 90e6, (0, 150e6), [start + 0.1], rtol=1e-11, atol=1e-13
    )
    dense = 1 - run.measures["press.porosity"]
    assert dense == pytest.approx(curve.y[0, -1], rel=1e-9)
    keys = {"compaction": "kawakita", "yield_pressure": None, "rearrangement": None}
    other = press(process(**keys, kawakita_a=0.5, kawakita_b="0.05 1/MPa"))
    with jax.enable_x64(True):
        for pressure, lost in ((0.0, 0.0), (20e6, 0.25), (1e15, 0.5)):
            found = other.compacted(granules, {"press.pressure": jnp.array([pressure])})
            assert float(start / found) == pytest.approx(1 - lost, rel=1e-6)
    # A flat cylinder of that density has the weight, and breaks at F = pi d h sigma / 2.
    height = run.measures["press.thickness"]
    assert np.pi / 4 * 0.01**2 * height * dense * 1450 == pytest.approx(300e-6)
    strength = 9e6 * np.exp(-8 * (1 - dense))
    assert run.measures["press.strength"] == pytest.approx(strength)
    force = run.measures["press.force"]
    assert 2 * force / (np.pi * 0.01 * height) == pytest.approx(strength)


@pytest.mark.prove
def test_content(run):
    """The drug of 300 mg of the dry granules, and USP <905>: 2.4 s within 98.5 to 101.5 %, and
    what the mean is off beyond."""
    tablets = run.streams["press.tablets"]
    mass = np.array([150, 50, 342.3])
    amounts = mass * np.asarray(tablets.species + tablets.solid)
    share = amounts[0] / (amounts.sum() + float(tablets.solvent + tablets.antisolvent))
    assert run.measures["press.assay"] == pytest.approx(3 * share)
    assert run.measures["press.tablets"] * 300e-6 == pytest.approx(
        amounts.sum() + float(tablets.solvent + tablets.antisolvent)
    )
    found = [float(acceptance(mean, 0.02)) for mean in (0.985, 1.0, 1.015, 0.965, 1.035)]
    assert found == pytest.approx([0.048, 0.048, 0.048, 0.068, 0.068], rel=1e-6)


@pytest.mark.prove
def test_release_is_the_integral_over_the_times_of_disintegration():
    """Before and after the last crystal is gone; at once where nothing holds the tablet together."""
    with jax.enable_x64(True):
        for time, whole, mean in ((1800, 3000, 240), (1800, 900, 240), (300, 900, 2000.0)):
            known, _ = quad(
                lambda s, time=time, whole=whole, mean=mean: (
                    np.exp(-s / mean) / mean * (1 - max(0, 1 - (time - s) / whole) ** 3)
                ),
                0, time, epsabs=1e-13, epsrel=1e-12, points=[max(0, time - whole)],
            )  # fmt: skip
            assert float(released(1.0 * time, whole, mean)) == pytest.approx(known, rel=1e-9)
        quick = float(released(1800.0, 3000.0, 1e-3))
        assert quick == pytest.approx(float(gone(1800.0, 3000.0)), rel=1e-5)


@pytest.mark.prove
def test_the_size_of_the_crystals_reaches_the_tablets(given, run):
    """Through granules, whose own size is another: dissolved is that of the crystals' d32."""
    assert run.status == "ok"
    size = run.measures["cold.d32"]
    assert float(run.streams["press.tablets"].inner_size) == pytest.approx(size)
    assert run.measures["wet.d32"] > 2 * size
    whole = 1200 * 30e-6 * size / 2 / (7e-10 * 0.5)
    mean = 240 * 0.1 / run.measures["press.porosity"]
    with jax.enable_x64(True):
        known = float(released(1800.0, whole, mean))
    assert run.measures["press.dissolved"] == pytest.approx(known, rel=1e-9)


@pytest.mark.prove
def test_balances_derivatives_and_both_engines(given):
    """Excipient and granulation liquid are added; derivatives against central differences."""
    rows = balances(given)
    assert max(abs(row.relative) for row in rows) < 1e-10
    names = ("press.pressure", "wet.duration", "wet.liquid_ratio", "cold.growth", "wet.porosity")
    entries = tuple((name, 0) for name in names)
    found = matrix(given, entries=entries)
    here = given.at(entries)
    moved = np.concatenate([here * (1 + s * 1e-4 * np.eye(5)) for s in (1, -1)])
    native = given.batch(entries, moved, engine="native")
    assert native.ok.all()
    slopes = (native.values[:5] - native.values[5:]).T / (2e-4 * here)
    size = np.abs(slopes * here).max(1, keepdims=True)
    np.testing.assert_allclose(found.jacobian * here / size, slopes * here / size, atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"yield_pressure": None}, 'compaction "heckel" needs this key'),
        ({"kawakita_a": 0.5}, 'compaction "heckel" has no such key'),
        ({"drug": "X"}, "there is no such species"),
        ({"packing": 1.0}, "between 0 and 1"),
    ],
)
def test_keys_that_do_not_fit(changes, words):
    with pytest.raises(CaseError, match=words):
        process(**changes)
