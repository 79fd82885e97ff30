"""The functions of the price factors: their expectations are exact, and increments have mean 0."""

import numpy as np
import pytest
from tests.domains.gas_storage.references.reference_schedules import (
    Factor,
    date,
    flagship,
    price_factors,
    slow_storage,
)

from snapo.domains.gas_storage.bounds.basis import gaussian_basis
from snapo.domains.gas_storage.bounds.regression import Regression
from snapo.domains.gas_storage.prices.process import GaussianFactors

DATES = [date(f"2021-05-0{day}") for day in range(2, 8)]


def correlated() -> GaussianFactors:
    """Three correlated factors from the valuation date on, 1 May 2021."""
    rows = [[1.0, 0.4, -0.2], [0.4, 1.0, 0.3], [-0.2, 0.3, 1.0]]
    factors = [
        Factor(60.0, lambda day: 0.9),
        Factor(4.0, lambda day: 0.4),
        Factor(0.0, lambda day: 0.2),
    ]
    return price_factors("2021-05-01", DATES, factors, rows)


def paths(of: GaussianFactors, count: int, seed: int = 0) -> np.ndarray:
    """[T + 1, F, count] factors, in antithetic halves."""
    random, state, found = np.random.default_rng(seed), np.zeros((of.decay.shape[1], count)), []
    for decay, shock in zip(of.decay, of.shock, strict=True):
        half = random.standard_normal((len(state), count // 2))
        state = decay[:, None] * state + shock @ np.concatenate([half, -half], axis=1)
        found.append(state)
    return np.array(found)


def quadrature(of: GaussianFactors, into: int):
    """Shocks [F, nodes] of one day and their probabilities, exact for polynomials of degree 15."""
    size = of.decay.shape[1]
    points, weights = np.polynomial.hermite_e.hermegauss(8 if size == 3 else 12)
    axes = np.meshgrid(*[points] * size, indexing="ij")
    mass = np.prod(np.meshgrid(*[weights / weights.sum()] * size, indexing="ij"), axis=0)
    return of.shock[into] @ np.stack([axis.ravel() for axis in axes]), mass.ravel()


@pytest.mark.parametrize("of", [correlated(), flagship().factors], ids=["correlated", "flagship"])
def test_the_expectation_of_a_polynomial_is_that_of_quadrature(of):
    basis = gaussian_basis(of, priced=False)
    random, t = np.random.default_rng(0), 3
    state = np.sqrt(np.abs(of.shock[t]).max()) * random.standard_normal((of.decay.shape[1], 1))
    shocks, mass = quadrature(of, t + 1)
    after = of.decay[t + 1][:, None] * state + shocks
    known = basis.expected(state[None], first=t)[0, :, 0]
    found = basis.functions(after[None], first=t + 1)[0] @ mass
    chosen = np.r_[: len(basis.powers), len(basis.powers) + len(basis.hinges) : basis.size]
    np.testing.assert_allclose(known[chosen], found[chosen], rtol=1e-9, atol=1e-9)


def test_the_expectation_of_a_hinge_is_that_of_a_fine_sum():
    of, t = slow_storage().factors, 3
    basis = gaussian_basis(of, priced=False)
    state, fine = np.array([[0.02]]), np.linspace(-8, 8, 20001)
    after = of.decay[t + 1] * state + of.shock[t + 1] * fine[None, :]
    mass = np.exp(-(fine**2) / 2)
    found = basis.functions(after[None], first=t + 1)[0] @ mass / mass.sum()
    np.testing.assert_allclose(basis.expected(state[None], first=t)[0, :, 0], found, atol=1e-6)


def test_on_the_first_day_every_polynomial_but_the_constant_has_mean_zero():
    of = correlated()
    basis = gaussian_basis(of, priced=False)
    shocks, mass = quadrature(of, 0)
    polynomials = slice(0, len(basis.powers))
    found = basis.functions(shocks[None])[0] @ mass
    np.testing.assert_allclose(found[polynomials], basis.first[polynomials], atol=1e-12)


def test_on_the_valuation_date_nothing_moves():
    of = flagship().factors
    basis = gaussian_basis(of, priced=False)
    states = np.zeros((len(of.decay), 3, 2))
    assert not basis.increments(states)[0].any()


def test_increments_have_mean_zero():
    of = correlated()
    basis = gaussian_basis(of, priced=False)
    moved = basis.increments(paths(of, 4096))
    error = moved.std(axis=2) / np.sqrt(moved.shape[2])
    # 6 days x 45 functions: the largest of 270 normals is below 4.5.
    assert np.all(np.abs(moved.mean(axis=2)) <= 4.5 * error + 1e-12)


def test_days_that_count_as_the_same_have_the_same_regression():
    """A factor that reverts within hours: its functions differ on the first days only."""
    dates, decay = 1000, float(np.exp(-0.06))
    shape = (dates, 1, 1)
    shock = np.full(shape, 0.1)
    shock[0] = 0.0
    of = GaussianFactors(np.ones(shape[:2]), np.ones(dates), np.full(shape[:2], decay), shock)
    basis = gaussian_basis(of, priced=False)
    same = basis.same_days()
    assert np.all(same <= np.arange(dates)) and np.all(same[same] == same)
    assert len(np.unique(same)) < 400 and same[-1] == dates - 1
    shared, alone = Regression(basis), Regression(basis)
    alone._same = alone._different = np.arange(dates)
    for t in (0, 1, 2, 50, 500, dates - 2, dates - 1):
        for one, other in zip(shared.day(t), alone.day(t)):
            np.testing.assert_allclose(
                one, other, rtol=1e-9, atol=1e-9 * np.abs(other).max(initial=0.0)
            )
    # Where a factor moves all prices in proportion, its deviation grows from day to day.
    flags = gaussian_basis(flagship().factors, priced=False).same_days()
    assert np.array_equal(flags, np.arange(len(flags)))


def test_days_made_together_have_the_bits_of_days_made_one_by_one():
    basis = gaussian_basis(flagship().factors, priced=False)
    together, alone = Regression(basis), Regression(basis)
    alone._block = 1
    last = len(basis.of.decay) - 1
    assert together._block > 1
    for t in (0, 1, together._block, last - 1, last):
        for one, other in zip(together.day(t), alone.day(t)):
            np.testing.assert_array_equal(one, other)
