"""Crystals by finite volumes over size: closed forms, the moment model, mass, gradients."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import lognorm
from tests.domains.pharma.process_cases import (
    PARAMETERS,
    attribute,
    case,
    chain,
    constant,
    crystalliser,
    feed,
    number,
)

from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.derivatives.jacobian import matrix
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.time.dynamics import Numerics
from snapo.domains.pharma.units.crystals.population import (
    NUMBER,
    SIZE,
    by_finite_volumes,
    limited_steps,
    quantiles,
)
from snapo.domains.pharma.units.crystals.seed import Seed, seed_numbers

SPREAD, MEAN = 0.3, 60e-6


def seeded(size=MEAN, loading=1.0, name="crystalliser"):
    return Seed(
        loading=number(f"{name}.seed_loading", loading, "kg/m3"),
        size=number(f"{name}.seed_size", size, "m"),
        spread=number(f"{name}.seed_spread", SPREAD),
    )


def population(edges, seed=None):
    with jax.enable_x64(True):
        numbers = seed_numbers(seed or seeded(), {}, 0.5236, 1200.0, edges / SIZE)
        return by_finite_volumes(edges, numbers)


def after(crystals, growth, born, seconds, steps):
    """The cells after constant growth, m/s, and births, 1/m3/s."""
    with jax.enable_x64(True):
        rates = jnp.asarray(growth / SIZE), jnp.asarray(born / NUMBER)
        h = seconds / steps

        def step(y, _):
            k1 = crystals.slope(y, *rates)
            k2 = crystals.slope(y + h / 2 * k1, *rates)
            k3 = crystals.slope(y + h / 2 * k2, *rates)
            k4 = crystals.slope(y + h * k3, *rates)
            return y + h / 6 * (k1 + 2 * (k2 + k3) + k4), None

        return np.asarray(jax.jit(lambda y: jax.lax.scan(step, y, None, steps)[0])(crystals.start))


def seed_law():
    """SciPy's law of the seed's sizes by number, in m."""
    variance = np.log1p(SPREAD**2)
    return lognorm(np.sqrt(variance), scale=MEAN * np.exp(-variance / 2))


@pytest.mark.prove
@pytest.mark.parametrize("growth", [2e-8, -1e-8])
@pytest.mark.parametrize("spacing", ["equal", "geometric"])
def test_growth_moves_the_distribution(growth, spacing):
    """n(L, t) = n_0(L - G t). Of second order, less what the limiter takes off the maximum."""
    seconds, gaps = 2000.0, []
    for cells in (100, 200):
        if spacing == "equal":
            edges = np.linspace(0, 400e-6, cells + 1)
        else:
            edges = np.geomspace(4e-6, 400e-6, cells + 1)
        crystals = population(edges)
        found = after(crystals, growth, 0.0, seconds, 800)
        share = np.diff(seed_law().cdf(np.maximum(edges - growth * seconds, 0.0)))
        start = np.diff(seed_law().cdf(edges))
        exact = share * (np.asarray(crystals.start).sum() / start.sum())
        gaps.append(np.abs(found - exact).sum() / exact.sum())
    assert gaps[1] < 0.016
    assert np.log2(gaps[0] / gaps[1]) > 1.45


@pytest.mark.prove
def test_constant_growth_and_nucleation():
    """n = B / G up to G t: all births are counted, d50 by volume is G t / 2^(1/4). The jump at
    the front smears over a few cells, so moments are of order 4/3 at least."""
    growth, born, seconds = 5e-8, 2e5, 3000.0
    law = []
    for cells in (100, 200):
        edges = np.linspace(0, 400e-6, cells + 1)
        crystals = population(edges, seeded(loading=1e-9))
        y = after(crystals, growth, born, seconds, 800)
        with jax.enable_x64(True):
            moments = np.asarray(crystals.moments(jnp.asarray(y)))
            middle = float(crystals.measures(jnp.asarray(y))["d50"])
        reach = growth * seconds / SIZE
        k = np.arange(6)
        exact = born * seconds / NUMBER * reach**k / (k + 1)
        assert moments[0] == pytest.approx(exact[0], rel=1e-6)
        law.append(np.abs(moments / exact - 1)[1:])
        assert middle == pytest.approx(growth * seconds * 0.5**0.25, rel=8e-3)
    assert law[1][2] < 0.01 and np.all(np.log2(law[0] / law[1]) > 4 / 3)


def test_dissolution_removes_crystals():
    """As many as were larger than the distance that all shrank."""
    edges = np.linspace(0, 300e-6, 301)
    crystals = population(edges)
    left = after(crystals, -2e-8, 0.0, 2500.0, 800).sum()
    started = np.asarray(crystals.start).sum()
    assert left / started == pytest.approx(seed_law().sf(50e-6), rel=2e-3)


def test_limiter():
    """Exact for a line on any grid; faces between neighbours where n rises; finite gradients."""
    edges = np.geomspace(1.0, 40.0, 13)
    centre, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    with jax.enable_x64(True):
        limited = jax.jit(lambda n: limited_steps(n, edges))
        found = np.asarray(limited(jnp.asarray(3 - 0.5 * centre)))
        np.testing.assert_allclose(found[1:-1], -0.5 * width[1:-1], rtol=1e-12)
        n = np.sort(np.random.default_rng(4).exponential(size=12))
        half = np.asarray(limited(jnp.asarray(n)))[1:-1] / 2
        for face, other in ((n[1:-1] + half, n[2:]), (n[1:-1] - half, n[:-2])):
            assert np.all((face - n[1:-1]) * (face - other) <= 1e-14)
        slope = jax.jit(jax.jacrev(limited))
        for n in (np.zeros(12), np.ones(12), 1e-200 * np.arange(12.0), np.eye(12)[5]):
            assert np.all(np.isfinite(slope(jnp.asarray(n))))


@pytest.mark.prove
def test_quantiles_of_a_lognormal_seed():
    """By volume the median of a lognormal law is exp(3 s^2) times that by number."""
    crystals = population(np.linspace(0, 400e-6, 401))
    variance = np.log1p(SPREAD**2)
    middle = MEAN * np.exp(2.5 * variance)
    with jax.enable_x64(True):
        found = jax.jit(crystals.measures)(crystals.start)
        assert float(found["d50"]) == pytest.approx(middle, rel=1e-4)
        upper = middle * np.exp(1.2815515655 * np.sqrt(variance))
        assert float(found["d90"]) == pytest.approx(upper, rel=1e-4)
        assert float(found["at_largest"]) < 1e-6
        edges = np.linspace(0, 4, 5)
        volume = jnp.array([1.0, 3.0, 2.0, 0.0])
        half = jax.jit(lambda v: quantiles(v, edges, (0.5,))[0])
        gradient = jax.grad(half)(volume)
        for i in range(3):
            up, down = (half(volume.at[i].add(h)) for h in (1e-5, -1e-5))
            assert float(gradient[i]) == pytest.approx(float(up - down) / 2e-5, rel=1e-8)
        assert float(half(jnp.zeros(4))) == 0


MEASURES = ("d43", "d32", "concentration", "d50", "span")


def alone(edges, measures=MEASURES, **fields):
    """The crystalliser of the flagship chain without its reactor, with a wide seed."""
    name = "crystalliser"
    unit = crystalliser(seed=seeded(20e-6, 0.02), edges=edges)
    found = [attribute(each, f"{name}.{each}", "", 1e6 if each[0] == "d" else 1.0)
             for each in measures]  # fmt: skip
    charge = feed((0.0, 0.1, 0.125, 0.1))
    return case((charge,), (unit,), chain("charge", name), found, PARAMETERS[1:4], **fields)


@pytest.fixture(scope="module")
def exact():
    """By the moment model, which is exact here."""
    return matrix(PharmaProcess(alone(None, MEASURES[:3])))


@pytest.fixture(scope="module")
def hundred():
    """By a hundred cells."""
    return PharmaProcess(alone(np.linspace(0, 300e-6, 101)))


@pytest.mark.prove
def test_against_moments(exact, hundred):
    """What is left falls with the square of the cells' width."""
    gaps = []
    for process in (hundred, PharmaProcess(alone(np.linspace(0, 300e-6, 201)))):
        values = np.array(list(process.run().attributes.values()))[:3]
        gaps.append(np.abs(values / exact.values - 1))
        assert max(abs(row.relative) for row in balances(process)) < 1e-10
    assert np.all(gaps[1] < [2.5e-3, 2.5e-3, 5e-6])
    assert np.all(np.log2(gaps[0] / gaps[1]) > 2)


@pytest.mark.prove
def test_too_long_steps_are_a_status():
    """The smallest cells of a geometric grid need short steps; a mesh without them says so."""
    process = PharmaProcess(alone(np.geomspace(1e-6, 400e-6, 101), MEASURES[:1]))
    status = process.run().status
    assert status.startswith("crystalliser: the time steps are too long from ")
    assert "adaptive" in status and "more steps" in status


@pytest.mark.prove
def test_gradients_against_differences(exact, hundred):
    """Each attribute by each temperature node: 1e-5 of the largest in its row."""
    found = matrix(hundred).jacobian
    columns = []
    for name, entry in hundred.entries:
        ends = []
        for sign in (1, -1):
            moved = hundred.inputs[name].copy()
            moved[entry] += sign * 1e-3
            ends.append(np.array(list(hundred.run({name: moved}).attributes.values())))
        columns.append((ends[0] - ends[1]) / 2e-3)
    gap = np.abs(np.array(columns).T - found).max(1) / np.abs(found).max(1)
    assert gap.max() < 1e-5
    near = np.abs(found[:3] - exact.jacobian).max(1) / np.abs(exact.jacobian).max(1)
    assert np.all(near < [0.05, 0.05, 1e-3])


@pytest.mark.prove
def test_error_control_finds_the_steps(exact):
    """On a geometric grid, where the mesh above gives up."""
    edges = np.geomspace(1e-6, 400e-6, 101)
    long = Numerics("adaptive", 320, 1e-7, 20_000, True)
    run = PharmaProcess(alone(edges, MEASURES[:1], numerics=long)).run()
    assert run.status == "ok" and run.measures["crystalliser.at_largest"] < 1e-6
    near = pytest.approx(exact.values[0], rel=0.016)  # the grid's own error
    assert run.attributes["d43"] == near


@pytest.mark.prove
def test_undersaturated_seed_dissolves_and_mass_closes():
    unit = crystalliser(
        seed=seeded(20e-6, 1.0),
        edges=np.linspace(0, 100e-6, 51),
        temperature=constant("crystalliser.temperature", 313.15),
        duration=number("crystalliser.duration", 600.0, "s"),
    )
    dissolution = number("crystalliser.dissolution", 1e-6, "m/s")
    unit = replace(unit, kinetics=replace(unit.kinetics, dissolution=dissolution))
    found = (attribute("crystals", "crystalliser.crystals"),)
    lines = chain("charge", "crystalliser")
    process = PharmaProcess(case((feed((0.0, 0.0, 0.1, 0.0)),), (unit,), lines, found))
    run = process.run()
    assert 0 < run.attributes["crystals"] < 0.1
    numbers = run.trajectories["crystalliser"]["mu0"]
    assert numbers[-1] < 0.2 * numbers[0]
    assert max(abs(row.relative) for row in balances(process)) < 1e-10
