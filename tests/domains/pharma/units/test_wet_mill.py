"""The wet mill against the closed form of Ziff and McGrady, its mass, numbers and gradient."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pharma.process_cases import (
    attribute,
    case,
    chain,
    constant,
    crystalliser,
    feed,
    network,
    number,
    parameter,
)
from tests.domains.pharma.units.crystals.test_finite_volumes import seeded

from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.derivatives.jacobian import matrix
from snapo.domains.pharma.flowsheet.case import Connection
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.flowsheet.stream import Grid, clear
from snapo.domains.pharma.time.dynamics import Numerics
from snapo.domains.pharma.time.integrate import integrate
from snapo.domains.pharma.units.wet_mill import WetMill, shares

SHAPE, MEAN = 0.5236, (80e-6) ** 3  # mean of size^3 at the start
RATE, SECONDS = 2e-3, 1000.0  # of a crystal of the mean volume


def mill(**fields):
    def part(field, value, unit="1"):
        return number(f"mill.{field}", value, unit)

    found = {
        "name": "mill",
        "duration": part("duration", SECONDS, "s"),
        "speed": constant("mill.speed", 20.0, "m/s"),
        "rate": part("rate", RATE, "1/s"),
        "reference_size": part("reference_size", np.cbrt(MEAN), "m"),
        "reference_speed": part("reference_speed", 20.0, "m/s"),
        "size_power": part("size_power", 3.0),
        "speed_power": part("speed_power", 2.0),
        "fragments": part("fragments", 2.0),
    }
    return WetMill(**(found | fields))


def slurry(edges):
    """1 m3 with 1e10 crystals, exponential in volume, each of the mean volume of its cell."""
    below = -np.expm1(-(edges**3) / MEAN)
    numbers = 1e10 * np.diff(below)
    k = np.arange(6)[:, None]
    powers = np.diff(edges ** (k + 1), axis=1) / ((k + 1) * np.diff(edges))
    stream = clear(jnp.zeros(4), jnp.asarray(900.0), jnp.asarray(1.0), jnp.asarray(300.0))
    return stream.replace(
        moments=jnp.asarray(powers @ numbers),
        numbers=jnp.asarray(numbers),
        density=jnp.asarray(1200.0),
        shape=jnp.asarray(SHAPE),
        grid=Grid.of(edges),
    )


def milled(edges, unit=None, steps=400):
    with jax.enable_x64(True):
        given = slurry(edges)

        def after(given):
            problem = (unit or mill()).dynamics(network(), (given,), {})
            solved = integrate(problem, Numerics("mesh", steps, 1e-8, 10_000, False))
            return problem.finish(solved.final, *solved.controls).outlets[0]

        return given, jax.jit(after)(given)


@pytest.mark.prove
def test_uniform_binary_breakage():
    """n(v, t) = N0 / m (1 + T)^2 exp(-v (1 + T) / m), T = k m t (Ziff and McGrady 1985).

    Of second order in the cells' width: a fragment is shared between two cells.
    """
    gaps = []
    for cells in (60, 120):
        edges = np.geomspace(2e-6, 300e-6, cells + 1)
        given, found = milled(edges)
        longer = 1 + RATE * SECONDS
        exact = 1e10 * longer * np.diff(-np.expm1(-(edges**3) * longer / MEAN))
        gaps.append(np.abs(np.asarray(found.numbers) - exact).sum() / exact.sum())
        assert float(found.moments[3] / given.moments[3]) == pytest.approx(1, abs=1e-12)
    assert gaps[1] < 0.02 and np.log2(gaps[0] / gaps[1]) > 1.7


@pytest.mark.prove
def test_numbers_grow_with_the_volume_that_is_there():
    """N' = k V (p - 1) for a rate proportional to volume: N = N0 (1 + (p - 1) k m t)."""
    edges = np.geomspace(1e-6, 300e-6, 121)
    for fragments in (2.0, 3.0):
        unit = mill(fragments=number("mill.fragments", fragments))
        given, found = milled(edges, unit)
        mean = float(given.moments[3] / given.moments[0])
        grown = 1 + (fragments - 1) * RATE * SECONDS * mean / MEAN
        # What is finer than the first cell counts by its volume.
        lost = 1e-4 if fragments == 2 else 5e-3
        assert float(found.moments[0] / given.moments[0]) == pytest.approx(grown, rel=lost)


def test_fragments_keep_number_and_volume():
    volumes, shared = np.geomspace(1.0, 1e4, 30), jax.jit(shares)
    with jax.enable_x64(True):
        for fragments in (2.0, 2.5, 4.0):
            found = np.asarray(shared(jnp.asarray(volumes), fragments))
            np.testing.assert_allclose(volumes @ found, volumes, rtol=1e-13)
            assert np.all(found >= -1e-13) and np.all(np.abs(np.tril(found, -1)) < 1e-13)
            below = fragments * (volumes[0] / volumes) ** (1 / (fragments - 1))
            assert np.all(np.abs(found.sum(0) - fragments) <= below + 1e-12)


@pytest.mark.prove
def test_a_mill_that_stands_still_breaks_nothing():
    edges = np.geomspace(2e-6, 300e-6, 31)
    given, found = milled(edges, mill(speed=constant("mill.speed", 0.0, "m/s")), 10)
    np.testing.assert_allclose(given.numbers, found.numbers, rtol=1e-14)


def in_a_chain():
    """A crystalliser by finite volumes, the mill, and a second crystalliser on the same grid."""
    edges = np.linspace(0, 300e-6, 61)
    names = "crystalliser", "second"
    units = [crystalliser(name, seed=seeded(20e-6, 0.02, name), edges=edges) for name in names]
    lines = (
        *chain("charge", "crystalliser"),
        Connection("crystalliser", "slurry", "mill", "slurry"),
        Connection("mill", "slurry", "second", "feed"),
    )
    found = (
        attribute("mean size", "mill.d43", "um", 1e6),
        attribute("number", "mill.number", "1/m3", 1e-9),
        attribute("second", "second.d43", "um", 1e6),
    )
    names = ("mill.speed", "mill.rate", "mill.fragments", "mill.size_power", "crystalliser.growth")
    given = tuple(parameter(each, each, 0, 0.0, 1e9) for each in names)
    short = mill(rate=number("mill.rate", 2e-4, "1/s"))
    return case(
        (feed((0.0, 0.1, 0.125, 0.1)),), (units[0], short, units[1]), lines, found, given,
        held=frozenset(
            f"{each}.{name}" for each in ("crystalliser", "second")
            for name in ("dissolution", "nuclei_size")
        ),
        numerics=Numerics("mesh", 160, 1e-8, 10_000, False),
    )  # fmt: skip


@pytest.mark.study
def test_in_a_chain_mass_closes_and_the_gradient_is_that_of_differences():
    process = PharmaProcess(in_a_chain())
    run = process.run()
    assert run.status == "ok"
    before, after = (run.streams[f"{each}.slurry"] for each in ("crystalliser", "mill"))
    assert after.grid == before.grid
    assert float(after.moments[3]) == pytest.approx(float(before.moments[3]), rel=1e-12)
    assert float(after.moments[0]) > float(before.moments[0])
    assert max(abs(row.relative) for row in balances(process)) < 1e-10
    found, columns = matrix(process).jacobian, []
    for name, entry in process.entries:
        ends, step = [], 1e-4 * process.inputs[name][entry]
        for sign in (1, -1):
            moved = process.inputs[name].copy()
            moved[entry] += sign * step
            ends.append(process.values({name: moved}))
        columns.append((ends[0] - ends[1]) / (2 * step))
    sized = np.array([process.inputs[name][entry] for name, entry in process.entries])
    gap = np.abs((np.array(columns).T - found) * sized).max(1) / np.abs(found * sized).max(1)
    assert gap.max() < 1e-5 and np.all(found[:2, :4] != 0)
