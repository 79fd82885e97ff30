"""Dissolution of crystals of many sizes: the sum over their sizes, by quadrature over a density."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import lognorm
from tests.domains.pharma.process_cases import dissolution, network
from tests.domains.pharma.units.solids.test_granulation import crystals, granulator

from snapo.domains.pharma.flowsheet.stream import Grid
from snapo.domains.pharma.units.solids.release import gone, lasting, over_sizes, released

EDGES = np.linspace(0.0, 400e-6, 201)
SIZES = lognorm(0.45, scale=70e-6)  # by number
CRITICAL = 2 * 7e-10 * 0.5 * 1800 / (1250 * 30e-6)  # m: what half an hour dissolves


def counted():
    """Crystals of these sizes, by number in each cell."""
    numbers = np.diff(SIZES.cdf(EDGES)) * 1e10
    k = np.arange(1, 7)[:, None]
    powers = np.diff(EDGES**k, axis=1) / (k * np.diff(EDGES))
    return crystals().replace(
        numbers=jnp.asarray(numbers), moments=jnp.asarray(powers @ numbers), grid=Grid.of(EDGES)
    )


def share(of_size) -> float:
    """The mean of a share that dissolves, by volume over the lognormal density."""
    ends = {"limit": 400, "points": [CRITICAL, 50e-6, 150e-6]}
    whole, part = (
        quad(lambda x, f=f: SIZES.pdf(x) * x**3 * f(x), 0, 400e-6, **ends)[0]
        for f in (lambda x: 1.0, of_size)
    )
    return part / whole


def test_the_test_of_loose_crystals_is_the_sum_over_their_sizes():
    known = share(lambda x: 1 - max(0.0, 1 - CRITICAL / x) ** 3)
    with jax.enable_x64(True):
        product = counted()
        found = float(dissolution().dissolved(product, {}))
        alone = float(dissolution().dissolved(product.replace(grid=None, numbers=jnp.zeros(0)), {}))
    # In each cell the density is constant: the integral of (L - a)^3 is in closed form.
    low, high = (np.maximum(each - CRITICAL, 0) for each in (EDGES[:-1], EDGES[1:]))
    density = np.asarray(product.numbers) / np.diff(EDGES)
    cells = density @ (high**4 - low**4) / (density @ (EDGES[1:] ** 4 - EDGES[:-1] ** 4))
    assert found == pytest.approx(1 - cells, abs=1e-8)
    assert found == pytest.approx(known, abs=1e-4)  # cells of 2 um; it falls with their square
    assert alone > known + 0.02  # by d32 alone it is too good


def test_tablets_release_the_sum_over_their_sizes():
    """Crystals that leave a tablet at random times of 240 s on average."""
    mean, time = 240.0, 1800.0

    def freed(size):
        """A crystal that leaves at z has dissolved for the rest of the time."""
        lasts = time * size / CRITICAL

        def rate(z):
            return np.exp(-z / mean) / mean * (1 - max(0.0, 1 - (time - z) / lasts) ** 3)

        return quad(rate, 0, time, points=[max(0.0, time - lasts)])[0]

    sizes = np.linspace(1e-6, 400e-6, 400)
    weight = SIZES.pdf(sizes) * sizes**3
    known = weight @ [freed(x) for x in sizes] / weight.sum()
    with jax.enable_x64(True):
        found = over_sizes(
            lambda whole: released(time, whole, mean), lasting(dissolution(), counted(), {})
        )
    assert float(found) == pytest.approx(known, abs=5e-5)


def test_granules_keep_the_sizes_of_the_crystals_inside():
    with jax.enable_x64(True):
        fed = counted()
        unit = granulator()
        problem = unit.dynamics(network(), (fed,), {})
        controls = [jnp.asarray(8.0)]
        (granules,) = problem.finish(problem.start, *controls).outlets
        assert granules.grid is None and float(granules.inner_size) > 0
        through, loose = (float(dissolution().dissolved(each, {})) for each in (granules, fed))
    assert through == pytest.approx(loose, rel=1e-12)


def test_moments_alone_are_spheres_of_their_mean_size():
    with jax.enable_x64(True):
        found = float(dissolution().dissolved(crystals(), {}))
        assert found == pytest.approx(float(gone(1800.0, 1800.0 * 80e-6 / CRITICAL)), rel=1e-12)
