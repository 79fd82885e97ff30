"""Wet granulation against the closed forms of coalescence and consolidation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pharma.process_cases import constant, network, number

from snapo.domains.pharma.flowsheet.stream import Stream, clear
from snapo.domains.pharma.time.dynamics import Numerics
from snapo.domains.pharma.time.integrate import integrate
from snapo.domains.pharma.units.solids.granulation import Granulation, lognormal

SECONDS, MEETS, FALLS, SPREAD = 600.0, 0.012, 0.004, 0.15
MESH = Numerics("mesh", 200, 1e-10, 20_000, True)


def granulator(**changes) -> Granulation:
    """A granulator at its reference speed."""
    values = {
        "duration": (SECONDS, "s"), "excipient_ratio": (3.0, "1"),
        "excipient_density": (1540.0, "kg/m3"), "liquid_ratio": (0.25, "1"),
        "liquid_density": (1000.0, "kg/m3"), "nuclei_size": (150e-6, "m"),
        "nuclei_spread": (SPREAD, "1"), "coalescence": (MEETS, "1/s"),
        "saturation_power": (0.0, "1"), "consolidation": (FALLS, "1/s"), "porosity": (0.5, "1"),
        "least_porosity": (0.2, "1"), "reference_speed": (8.0, "m/s"), "speed_power": (1.0, "1"),
        "packing": (0.6, "1"),
    }  # fmt: skip
    found = {
        key: number(f"wet.{key}", changes.get(key, value), unit)
        for key, (value, unit) in values.items()
    }
    speed = constant("wet.speed", changes.get("speed", 8.0), "m/s")
    return Granulation(name="wet", speed=speed, excipient=1, **found)


def crystals(mass: float = 10.0) -> Stream:
    """kg of crystals of 80 um by surface, without liquor."""
    many = mass / (1250 * 0.5236 * 80e-6**3)
    nothing = clear(jnp.zeros(4), jnp.zeros(()), jnp.zeros(()), jnp.asarray(298.0))
    return nothing.replace(
        solid=jnp.zeros(4).at[0].set(mass / 100),
        moments=jnp.asarray(many * 80e-6 ** np.arange(6)),
        density=jnp.asarray(1250.0),
        shape=jnp.asarray(0.5236),
    )


def granulated(unit: Granulation):
    """Outlet, measures and ledger."""

    def finish(fed):
        problem = unit.dynamics(network(), (fed,), {})
        solved = integrate(problem, MESH)
        return problem.finish(solved.final, *solved.controls)

    with jax.enable_x64(True):
        return jax.tree.map(np.asarray, jax.jit(finish)(crystals()))


@pytest.mark.prove
def test_coalescence_and_consolidation_in_closed_form():
    """N = N0 e^(-bt/2), M2 = M2(0) + 2 V^2/N0 (e^(bt/2) - 1), porosity e^(-kt) towards its least."""
    (granules,), measures, book = granulated(granulator())
    gain = np.exp(MEETS * SECONDS / 2)
    porosity = 0.2 + 0.3 * np.exp(-FALLS * SECONDS)
    assert float(measures["porosity"]) == pytest.approx(porosity, rel=1e-9)
    solids = 10 / 1250 + 30 / 1540  # m3
    first = solids / 0.5 / (np.pi / 6 * 150e-6**3)
    assert float(granules.moments[0]) == pytest.approx(first / gain, rel=1e-9)
    ratio = (np.exp(9 * SPREAD**2) + 2 * (gain - 1)) / gain
    assert float(measures["spread"]) == pytest.approx(np.sqrt(np.log(ratio) / 9), rel=1e-8)
    assert float(granules.shape * granules.moments[3]) == pytest.approx(solids / (1 - porosity))
    # As particles they weigh what their solids do, with the drug's crystals remembered.
    assert float(granules.crystals()) == pytest.approx(40.0)
    assert float(network().molar_mass @ granules.solid) == pytest.approx(40.0)
    assert float(granules.inner_size) == pytest.approx(80e-6)
    assert float(granules.inner_density) == 1250
    assert float(granules.solvent) == pytest.approx(10.0) == float(book.solvent_added)
    bulk = 0.6 * 40 / solids * (1 - porosity)
    assert float(measures["bulk_density"]) == pytest.approx(bulk)
    assert float(measures["loss_on_drying"]) == pytest.approx(0.2)
    pores = solids * porosity / (1 - porosity)
    assert float(measures["saturation"]) == pytest.approx(0.01 / pores)


@pytest.mark.prove
def test_many_meetings_make_an_exponential_distribution_of_volumes():
    """Whose second moment is twice the square of the first, so that spread^2 = ln 2 / 9; at rest
    nothing happens, and granules of one size stay so."""
    _, measures, _ = granulated(granulator(coalescence=0.05))
    assert float(measures["spread"]) == pytest.approx(np.sqrt(np.log(2) / 9), rel=1e-5)
    _, still, _ = granulated(granulator(speed=0.0, nuclei_spread=0.0))
    assert float(still["spread"]) == 0 and float(still["d43"]) == pytest.approx(150e-6)
    assert float(still["porosity"]) == 0.5


@pytest.mark.prove
def test_moments_of_a_lognormal_distribution():
    """Against drawn sizes, within 5 standard errors."""
    rng, sigma = np.random.default_rng(0), 0.3
    sizes = 2.0 * np.exp(sigma * rng.normal(size=200_000))
    third = 8 * np.exp(4.5 * sigma**2)
    found = np.asarray(lognormal(1.0, third, np.exp(9 * sigma**2)))
    for k in range(6):
        drawn = sizes**k
        assert abs(drawn.mean() - found[k]) <= 5 * drawn.std() / np.sqrt(len(sizes)) + 1e-5
