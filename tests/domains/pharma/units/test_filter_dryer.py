"""The agitated filter-dryer: measured filtration, washing, drying, balances, derivatives."""

import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import (
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
from snapo.domains.pharma.flowsheet.stream import Stream, clear
from snapo.domains.pharma.read.case import resolve
from snapo.domains.pharma.units.filter_dryer import FilterDryer

CASE = (
    """kind = "pharma"
[species]
C = { molar_mass = "150 g/mol" }
D = { molar_mass = "250 g/mol" }
[units.cool]
type = "crystalliser"
solute = "C"
duration = "2 h"
temperature = { nodes = ["313.15 K", "278.15 K"] }
shape = 0.5236
density = "1200 kg/m^3"
solubility = { coefficients = [226.9, -1.88, 3.89e-3] }
kinetics = { growth = "5 um/s", growth_order = 1.32 }
seed = { loading = "0.2 kg/m^3", size = "30 um" }
[units.fd]
type = "filter-dryer"
area = "0.05 m^2"
filter_pressure = "1 bar"
viscosity = "0.46 mPa*s"
medium_resistance = "1e10 1/m"
porosity = 0.4
saturation = 0.3
wash_ratio = 1.5
washes = 2
duration = "25 min"
temperature = "323.15 K"
pressure = "50 mbar"
heating_area = "0.3 m^2"
heat_transfer = "60 W/m^2/K"
mass_transfer = "2e-11 kg/m^2/s/Pa"
critical = "0.03 kg/kg"
heat_capacity = "1200 J/kg/K"
[units.fd.liquid]
antoine = [9.23027, 1256.68, -40.529]
latent_heat = "448 kJ/kg"
heat_capacity = "1720 J/kg/K"
"""
    + feed("charge", "60 L", 'C = "0.2 mol/L", D = "0.01 mol/L"')
    + connections(("charge", "cool.feed"), ("cool.slurry", "fd.slurry"))
    + parameter("A", "fd.area", ["0.01 m^2", "20 m^2"], ["0.04 m^2", "18 m^2"])
    + attribute("time", "fd.time", "s")
    + attribute("wash time", "fd.wash_time", "s")
    + attribute("impurity", "fd.impurity.D", "1")
    + attribute("solvent", "fd.solvent", "1")
)


def process(**changes) -> PharmaProcess:
    data = tomllib.loads(CASE)
    for key, each in changes.items():
        if each is None:
            del data["units"]["fd"][key]
        else:
            data["units"]["fd"][key] = each
    numerics = {"method": "mesh", "steps": 160}  # quicker to compile than error control
    return PharmaProcess(resolve(TEMPLATE, data | {"numerics": numerics}))


def vessel(**changes) -> FilterDryer:
    found = process(**changes).case.units[1]
    assert isinstance(found, FilterDryer)
    return found


def slurry(crystals: float, filtrate: float) -> Stream:
    """`crystals` kg of 100 um, and as much liquor as gives `filtrate` m3 at a porosity of 0.4."""
    volume = filtrate + crystals / 1200 / 0.6
    many = crystals / (1200 * 0.5236 * 1e-12)
    liquid = clear(jnp.zeros(2), jnp.asarray(880 * volume), jnp.asarray(volume), jnp.asarray(300.0))
    return liquid.replace(
        moments=jnp.asarray(many * 1e-4 ** np.arange(6)),
        density=jnp.asarray(1200.0),
        shape=jnp.asarray(0.5236),
    )


LITRES, SECONDS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0), (17.3, 41.3, 72.0, 108.3, 152.0, 201.7)


@pytest.mark.prove
def test_filtration_of_calcium_carbonate():
    """Geankoplis, Transport Processes and Unit Operations, problem 14.2-1 (data of Ruth): times of
    the table, with the constants that are its answer.

    0.0439 m2, 46.2 kPa, 23.47 kg of crystals per m3 of filtrate, water at 298.2 K; alpha 1.106e11
    m/kg and R_m 6.40e10 1/m, a fit to within 0.6 % of every row.
    """
    press = vessel(
        area="0.0439 m^2",
        filter_pressure="46.2 kPa",
        viscosity="8.937e-4 Pa*s",
        medium_resistance="6.40e10 1/m",
        resistance="1.106e11 m/kg",
    )
    network, found = process().case.network, []
    with jax.enable_x64(True):
        for litres in LITRES:
            fed = slurry(23.47e-3 * litres, 1e-3 * litres)
            (_, filtrate, _), measures, _ = press.nutsche.deliver(network, (fed,), {})
            slow = press.slowness(fed, filtrate, measures, {})
            found.append((float(measures["time"]), float(slow)))
    times, slowness = np.transpose(found)
    np.testing.assert_allclose(times, SECONDS, rtol=6e-3)
    # The time is a parabola of the volume, so that differences over it are slopes in the middle.
    middle = (slowness[1:] + slowness[:-1]) / 2
    np.testing.assert_allclose(np.diff(times) / 0.5e-3, middle, rtol=1e-5)


@pytest.mark.prove
def test_reslurry_washes_thin_the_liquor():
    """(s / (s + W))^n of a solute stays; the wash liquid is all there, in cake or washings."""
    unit = vessel()
    assert float(unit.nutsche.remaining({})) == pytest.approx((0.3 / 1.8) ** 2, rel=1e-6)
    thorough = vessel(wash="dispersion", peclet=1e4, washes=None, wash_ratio=0.9)
    assert float(thorough.nutsche.remaining({})) == pytest.approx(1.0, abs=1e-6)  # plug flow
    thorough = vessel(wash="dispersion", peclet=1e4, washes=None, wash_ratio=1.1)
    assert float(thorough.nutsche.remaining({})) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"wash": "dispersion"}, 'wash "dispersion" needs this key'),
        ({"peclet": 10}, 'wash "reslurry" has no such key; it belongs to "dispersion"'),
        ({"wash": "exponential", "efficiency": 1}, 'it belongs to "reslurry"'),
        ({"porosity": 0.99}, "porosity"),
    ],
)
def test_keys_that_do_not_fit(changes, words):
    with pytest.raises(CaseError, match=words):
        process(**changes)


@pytest.mark.prove
def test_balances_and_derivatives():
    """Mass, solvent and heat close; the adjoint against central differences."""
    given = process()
    rows = balances(given)
    assert {"mass", "solvent", "energy"} <= {row.quantity for row in rows if row.unit == "fd"}
    assert max(abs(row.relative) for row in rows) < 1e-10
    names = ("fd.wash_ratio", "fd.porosity", "fd.saturation", "fd.heat_transfer")
    entries = tuple((name, 0) for name in names)
    found = matrix(given, entries=entries)
    here = np.array([given.inputs[name].ravel()[0] for name in names])
    rows = np.concatenate([here * (1 + s * 1e-4 * np.eye(4)) for s in (1, -1)])
    values = given.batch(entries, rows).values
    slopes = (values[:4] - values[4:]).T / (2e-4 * here)
    size = np.abs(slopes * here).max(1, keepdims=True)
    np.testing.assert_allclose(found.jacobian * here / size, slopes * here / size, atol=1e-6)
    time, wash_time, impurity, solvent = found.values
    # Less than the wet cake has: solvent per volume of what the crystals leave of the solution.
    made = (30 - 4.937) / (1 - 4.937 / 1200)
    wet = 0.3 * 0.4 / (0.6 * 1200) * 880 / (1 - made / 1200)
    assert time > 0 and wash_time > 0 and 0 < impurity < 0.01 and 0 < solvent < 0.75 * wet
