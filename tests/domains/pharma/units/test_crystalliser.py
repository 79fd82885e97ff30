"""The crystalliser against an independent code, its event, anti-solvent; the wash."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.special import erfcx
from tests.domains.pharma.process_cases import (
    PARAMETERS,
    Connection,
    attribute,
    case,
    chain,
    constant,
    crystalliser,
    feed,
    number,
    potassium_nitrate,
    series,
)

from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.derivatives.jacobian import matrix
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.time import integrate
from snapo.domains.pharma.time import mesh as meshes
from snapo.domains.pharma.time.profile import saturation_share
from snapo.domains.pharma.units.filter import displacement, scaled_erfc


def test_potassium_nitrate():
    """Seeded cooling, two independent codes agree to 1e-5 (volumes printed to five digits)."""
    c, seed, nuclei = PharmaProcess(potassium_nitrate()).values()
    assert c == pytest.approx(428.92507, rel=1e-5)
    assert seed == pytest.approx(8.9486e-4, rel=2e-5)
    assert nuclei == pytest.approx(2.94683e-2, rel=1e-5)


def alone(**fields):
    """The crystalliser of the flagship chain without its reactor."""
    unit = crystalliser(**fields)
    charge = feed((0.0, 0.1, 0.125, 0.1))
    found = (attribute("size", "crystalliser.d43", "um", 1e6),)
    cooled = PARAMETERS[1:4]
    return case((charge,), (unit,), chain("charge", "crystalliser"), found, cooled)


@pytest.mark.prove
def test_event_share_and_its_derivative():
    """Where c*(T(t)) meets c on a line, against the root of the quadratic and differences."""
    profile = crystalliser().temperature
    value = profile.value.used()

    @jax.jit
    def share(value):
        return saturation_share(
            lambda t: 226.9 - 1.88 * t + 3.89e-3 * t * t - 18.755, profile, value
        )

    with jax.enable_x64(True):
        found, slope = map(np.asarray, jax.jit(jax.value_and_grad(share))(value))
        moved = [float(share(value + np.eye(4)[1] * h)) for h in (1e-4, -1e-4)]
    a, b, c = 3.89e-3, -1.88, 226.9 - 18.755
    crossing = (-b + np.sqrt(b * b - 4 * a * c)) / (2 * a)
    assert found == pytest.approx((313.15 - crossing) / (313.15 - 308) / 3, rel=1e-12)
    assert slope[1] == pytest.approx((moved[0] - moved[1]) / 2e-4, rel=1e-6)
    assert slope[2] == 0.0 and slope[3] == 0.0


@pytest.mark.prove
def test_gradients_need_the_event(monkeypatch):
    """Halving the mesh: with the event as a break the gradient stands, without it it moves."""

    def halving_gap():
        found = []
        for steps in (320, 640):
            given = alone()
            given = replace(given, numerics=replace(given.numerics, steps=steps))
            found.append(matrix(PharmaProcess(given)).jacobian[0])
        return np.max(np.abs(found[1] - found[0])) / np.max(np.abs(found[1]))

    resolved = halving_gap()
    plain = meshes.make_mesh
    monkeypatch.setattr(integrate, "make_mesh", lambda edges, n, _: plain(edges, n, None))
    assert resolved < 1e-5 < halving_gap()


@pytest.mark.prove
def test_antisolvent_crystalliser_closes():
    """Anti-solvent lowers solubility: crystals form without cooling, and balances close."""
    name = "crystalliser"
    unit = crystalliser(
        temperature=constant(f"{name}.temperature", 300.0),
        dosing=constant(f"{name}.dosing", 1e-6, "m3/s"),
    )
    lower = replace(unit.solubility, antisolvent=series(f"{name}.antisolvent", [-3.0, 0.5]))
    unit = replace(unit, solubility=lower)
    feeds = feed((0.0, 0.1, 0.085, 0.1)), feed((0.0,) * 4, volume=0.0072, name="water")
    lines = (*chain("charge", name), Connection("water", "", name, "antisolvent"))
    measures = [
        attribute("crystals", f"{name}.crystals"),
        attribute("left", f"{name}.concentration"),
    ]
    process = PharmaProcess(case(feeds, (unit,), lines, measures))
    crystals, left = process.values()
    assert crystals > 1.0 and left < 0.085 * 150 * 0.06 / 0.0672 - 1.0
    assert max(abs(row.relative) for row in balances(process)) < 1e-10
    streams = process.run().streams
    assert streams[f"{name}.slurry"].antisolvent == pytest.approx(7200e-6 * 887.6, rel=1e-9)


def two_in_a_row(second, antisolvent):
    """An anti-solvent crystalliser, whose slurry a `second` one without dosing keeps as warm."""
    lower = series("first.antisolvent", antisolvent)
    first = crystalliser(
        "first",
        temperature=constant("first.temperature", 313.15),
        dosing=constant("first.dosing", 1e-6, "m3/s"),
    )
    first = replace(first, solubility=replace(first.solubility, antisolvent=lower))
    second = crystalliser("second", temperature=constant("second.temperature", 313.15), **second)
    lower = replace(lower, name="second.antisolvent")
    second = replace(second, solubility=replace(second.solubility, antisolvent=lower))
    water = replace(
        feed((0.0,) * 4, volume=0.0072, name="water"), solvent=number("water.solvent", 1000.0)
    )
    lines = [("charge", "", "first", "feed"), ("water", "", "first", "antisolvent")]
    lines = [Connection(*line) for line in (*lines, ("first", "slurry", "second", "feed"))]
    names = [f"{unit}.{name}" for unit in ("first", "second") for name in MEASURED]
    measures = [attribute(name, name) for name in names]
    charge = feed((0.0, 0.0, 0.2, 0.0))
    return PharmaProcess(case((charge, water), (first, second), tuple(lines), measures)).values()


MEASURED = ("supersaturation", "concentration")


def test_antisolvent_of_an_earlier_unit_lowers_the_solubility():
    """Where nothing grows the liquid stays as it came, and so does its supersaturation."""
    kinetics = crystalliser("second").kinetics
    at_rest = {
        name: replace(getattr(kinetics, name), values=np.zeros(1))
        for name in ("growth", "primary", "secondary")
    }
    still = {"kinetics": replace(kinetics, **at_rest)}
    s1, c1, s2, c2 = two_in_a_row(still, [-3.0, 0.5])
    w = 7.2 / (7.2 + 0.06 * 887.6)
    saturated = (226.9 - 1.88 * 313.15 + 3.89e-3 * 313.15**2) * np.exp(-3.0 * w + 0.5 * w**2)
    assert s1 == pytest.approx(c1 / saturated - 1, rel=1e-9) and s1 > 0
    assert (s2, c2) == pytest.approx((s1, c1), rel=1e-9)


@pytest.mark.prove
def test_antisolvent_without_a_key_dilutes_only():
    """Crystals of the first unit go on growing for a minute in the second one; without the key of
    the solubility the water only dilutes."""
    minute = {"duration": number("second.duration", 60.0, "s")}
    s1, c1, s2, c2 = two_in_a_row(minute, [-3.0, 0.5])
    assert 0 < s2 < s1 and c2 < c1
    s1, c1, s2, c2 = two_in_a_row(minute, [])
    saturated = 226.9 - 1.88 * 313.15 + 3.89e-3 * 313.15**2
    assert (s1, s2) == pytest.approx((c1 / saturated - 1, c2 / saturated - 1), rel=1e-9)


def test_displacement_wash():
    """erfcx against SciPy, and the limits: all without wash, almost nothing after a lot."""
    x = np.array([0.0, 0.5, 3.9, 4.1, 30.0])
    with jax.enable_x64(True):
        np.testing.assert_allclose(jax.jit(scaled_erfc)(x), erfcx(x), rtol=1e-12)
        left = jax.jit(jax.value_and_grad(displacement))
        assert left(0.0, 10.0)[0] == 1.0
        assert left(5.0, 10.0)[0] < 1e-2
        half, slope = left(1.0, 1e4)
        assert np.isfinite(slope) and abs(half - 0.5) < 0.01
