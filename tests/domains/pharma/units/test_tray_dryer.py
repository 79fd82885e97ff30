"""The tray dryer under vacuum: closed forms of its two periods, its balances, its gradients."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from tests.domains.pharma.process_cases import (
    attribute,
    cake_filter,
    case,
    chain,
    constant,
    crystalliser,
    feed,
    linear,
    network,
    number,
    series,
)

from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.derivatives.jacobian import matrix
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.flowsheet.stream import clear
from snapo.domains.pharma.quality.records import Parameter
from snapo.domains.pharma.time.dynamics import Numerics
from snapo.domains.pharma.time.integrate import integrate
from snapo.domains.pharma.units.tray_dryer import (
    Liquid,
    TrayDryer,
    evaporating,
    vapour_pressure,
    wetness,
)

LATENT, CAPACITY = 4.48e5, 1720.0  # tetrahydrofuran


def dryer(**fields):
    def part(field, value, unit="1"):
        return number(f"dryer.{field}", value, unit)

    found = {
        "name": "dryer",
        "duration": part("duration", 7200, "s"),
        "temperature": constant("dryer.temperature", 323.15),
        "pressure": constant("dryer.pressure", 5000.0, "Pa"),
        "area": part("area", 0.5, "m2"),
        "heat_transfer": part("heat_transfer", 20.0, "W/m2/K"),
        "mass_transfer": part("mass_transfer", 2e-11, "kg/m2/s/Pa"),
        "critical": part("critical", 0.03),
        "heat_capacity": part("heat_capacity", 1200.0, "J/kg/K"),
        "liquid": Liquid(
            series("dryer.antoine", [9.23027, 1256.68, -40.529]),
            part("latent_heat", LATENT, "J/kg"),
            part("liquid_heat_capacity", CAPACITY, "J/kg/K"),
        ),
    }
    return TrayDryer(**(found | fields))


def cake(moisture=0.1, crystals=1.0, size=80e-6, temperature=300.0):
    """`crystals` kg of one size with `moisture` kg/kg of solvent."""
    number_of = crystals / (1200 * 0.5236 * size**3)
    liquid = clear(jnp.zeros(1), moisture * crystals, jnp.asarray(1e-3), jnp.asarray(temperature))
    return liquid.replace(
        moments=jnp.asarray(number_of * size ** np.arange(6)),
        density=jnp.asarray(1200.0),
        shape=jnp.asarray(0.5236),
    )


def dried(unit, wet=None, steps=3000):
    """{state: [n + 1]} over time, and the times."""
    with jax.enable_x64(True):

        def over_time(wet):
            problem = unit.dynamics(network(), (wet,), {})
            track = integrate(problem, Numerics("mesh", steps, 1e-8, 10_000, True), True).track
            assert track is not None
            rows = jax.vmap(lambda y, c: problem.states(y, *c))(track.state, track.controls)
            return rows, track.time

        return jax.tree.map(np.asarray, jax.jit(over_time)(wet or cake()))


def pressure(temperature):
    return 10 ** (9.23027 - 1256.68 / (temperature - 40.529))


def surface_rate(size=80e-6, transfer=2e-11):
    return transfer * 6 / (1200 * size)


@pytest.mark.prove
def test_constant_rate_is_the_wet_bulb_balance():
    """Wet cake settles where the shelf's heat is what evaporation takes; then X falls in line."""
    unit = dryer(
        critical=number("dryer.critical", 1e-3),
        heat_transfer=number("dryer.heat_transfer", 200.0, "W/m2/K"),
        mass_transfer=number("dryer.mass_transfer", 1e-10, "kg/m2/s/Pa"),
        duration=number("dryer.duration", 3600.0, "s"),
    )
    found, time = dried(unit, cake(moisture=3.0))
    rate = surface_rate(transfer=1e-10)

    def gap(t):
        return 0.5 * 200.0 * (323.15 - t) - rate * (pressure(t) - 5000.0) * LATENT

    bulb = brentq(gap, 250.0, 323.0)
    speed = rate * (pressure(bulb) - 5000.0)
    last = found["solvent"][-1]
    assert last > 1.0  # still far above critical
    assert found["temperature"][-1] == pytest.approx(bulb, abs=1e-6)
    assert found["rate"][-1] == pytest.approx(speed, rel=1e-7)
    middle = len(time) // 2
    taken = found["solvent"][middle] - last
    assert taken == pytest.approx(speed * (time[-1] - time[middle]), rel=1e-6)


@pytest.mark.prove
def test_falling_rate_is_exponential():
    """Below critical, at the shelf's temperature and in vacuum: X = X_0 exp(-k a p_v t / X_c)."""
    hot = dryer(
        heat_transfer=number("dryer.heat_transfer", 1e5, "W/m2/K"),
        mass_transfer=number("dryer.mass_transfer", 1e-14, "kg/m2/s/Pa"),
        pressure=constant("dryer.pressure", 0.0, "Pa"),
        duration=number("dryer.duration", 200.0, "s"),
    )
    wet = cake(moisture=1e-3, temperature=323.15)
    found, time = dried(hot, wet, 10_000)
    k = surface_rate(transfer=1e-14) * pressure(323.15) / 0.03
    np.testing.assert_allclose(found["solvent"], 1e-3 * np.exp(-k * time), rtol=1e-7)
    slower = dried(hot, cake(moisture=1e-3, size=160e-6, temperature=323.15), 10_000)[0]
    assert slower["rate"][0] == pytest.approx(found["rate"][0] / 2, rel=1e-12)


@pytest.mark.prove
def test_it_ends_in_equilibrium_with_the_vacuum():
    """f p_v = p: what cannot leave is X_c p / p_v."""
    found, _ = dried(dryer(), cake(moisture=0.05), 6000)
    assert found["temperature"][-1] == pytest.approx(323.15, abs=1e-2)
    assert found["solvent"][-1] == pytest.approx(0.03 * 5000 / pressure(323.15), rel=1e-3)


def test_passages_are_smooth_and_near_their_branches():
    with jax.enable_x64(True):
        ratio = np.array([0.0, 0.1, 0.6, 1.0, 1.7, 10.0])
        f = np.asarray(wetness(ratio))
        np.testing.assert_allclose(f[[0, 1, 2]], ratio[:3], rtol=3e-3)
        np.testing.assert_allclose(f[4:], 1.0, rtol=3e-3)
        assert f[3] == pytest.approx(2 ** (-1 / 8))
        x = np.array([-2000.0, 0.0, 2000.0])
        np.testing.assert_allclose(evaporating(x, 1000.0), [0.0, 0.1, 2000.0], atol=1e-5)
        for excess, p in ((0.0, 0.0), (-5.0, 0.0), (0.0, 1e3)):
            assert np.isfinite(jax.grad(evaporating)(excess, p))
        assert np.isfinite(jax.grad(wetness)(0.0))
        boiling = vapour_pressure(dryer().liquid, {}, 339.1)
    # Tetrahydrofuran boils at 66 degC; these numbers of Antoine's say one kelvin less.
    assert float(boiling) == pytest.approx(101325, rel=0.04)


def process(unit, numerics=None):
    charge = feed((0.0, 0.1, 0.125, 0.1))
    units = (crystalliser(), cake_filter(), unit)
    lines = chain("charge", "crystalliser", "filter", "dryer")
    found = (
        attribute("solvent", "dryer.solvent", "ppm", 1e6),
        attribute("temperature", "dryer.temperature", "K"),
    )
    moved = [
        Parameter(name, name, 0, "", 1.0, 0.0, 0.0, 1e9, 0.0, 1e9, None, True, "test")
        for name in ("dryer.temperature", "dryer.pressure", "filter.saturation", "dryer.critical")
    ]
    fields = {} if numerics is None else {"numerics": numerics}
    return PharmaProcess(case((charge,), units, lines, found, moved, **fields))


def test_mass_and_energy_close_in_the_chain():
    shelf = linear("dryer.temperature", [300.0, 330.0])
    vacuum = linear("dryer.pressure", [20_000.0, 2000.0], "Pa")
    found = balances(process(dryer(temperature=shelf, pressure=vacuum)))
    rows = {row.quantity: row for row in found if row.unit == "dryer"}
    assert {"mass", "solvent", "energy"} <= set(rows)
    assert rows["energy"].inflow > 1e4
    assert max(abs(row.relative) for row in found) < 1e-10


@pytest.mark.prove
def test_gradients_against_differences():
    """By shelf, pressure, what the filter left and critical moisture; on the falling branch."""
    short = dryer(duration=number("dryer.duration", 1500.0, "s"))
    chain_of = process(short)
    found = matrix(chain_of).jacobian
    columns = []
    for name, entry in chain_of.entries:
        ends, step = [], 1e-5 * chain_of.inputs[name][entry]
        for sign in (1, -1):
            moved = chain_of.inputs[name].copy()
            moved[entry] += sign * step
            ends.append(chain_of.values({name: moved}))
        columns.append((ends[0] - ends[1]) / (2 * step))
    sized = np.array([chain_of.inputs[name][entry] for name, entry in chain_of.entries])
    gap = np.abs((np.array(columns).T - found) * sized).max(1) / np.abs(found * sized).max(1)
    assert gap.max() < 1e-6 and np.all(found[0] != 0)


@pytest.mark.prove
def test_fast_transfer_needs_the_implicit_solver():
    """Evaporation within seconds over hours: error control reaches the same end as fine steps."""
    quick = dryer(mass_transfer=number("dryer.mass_transfer", 7e-10, "kg/m2/s/Pa"))
    values = process(quick, Numerics("adaptive", 320, 1e-9, 20_000, True)).values()
    fine = process(replace(quick), Numerics("mesh", 20_000, 1e-8, 10_000, True)).values()
    np.testing.assert_allclose(values, fine, rtol=1e-6)
