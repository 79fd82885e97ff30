"""Short rate and inflation: the fit, published bond prices (P7), and affine formulas."""

import jax
import numpy as np
import pytest
from tests.domains.pension.market_cases import CASH, assets, case, curve, full, inflation, rates

from snapo.domains.pension.market.dynamics import move
from snapo.domains.pension.market.factors import (
    factors,
    moments,
    nominal,
    real,
    shape,
    shift,
    slope,
)
from snapo.domains.pension.market.shocks import covariance, factor, slots
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.problem.inputs import plain
from snapo.problem.problem import prepare
from snapo.problem.record.either import with_numpy

KAPPA, MEAN, START, SIGMA, PRICE = 0.15, 0.03, 0.02, 0.01, -0.20
# Closed form of O. Vasicek, Journal of Financial Economics 5, 1977.
PUBLISHED = {
    1: 0.9785819265,
    5: 0.8751515271,
    10: 0.7362066370,
    20: 0.4989862530,
    30: 0.3324054485,
}


def b(a, u):
    return (1 - np.exp(-a * u)) / a


def vasicek(rate, u):
    """ln of a Vasicek bond price with `u` years left at the short rate `rate`."""
    far = MEAN - PRICE * SIGMA / KAPPA - SIGMA**2 / (2 * KAPPA**2)
    return far * (b(KAPPA, u) - u) - SIGMA**2 * b(KAPPA, u) ** 2 / (4 * KAPPA) - rate * b(KAPPA, u)


@pytest.fixture(scope="module")
def long_case():
    steps = 360
    held = assets(steps, [CASH], weight=[1.0])
    return case(steps, held_assets=held, rates=rates(steps, KAPPA, SIGMA))


@with_numpy
def made_of(one, given):
    """Factors, nominal bonds and their moments by NumPy, which compiles nothing."""
    both, bond = factors(one, given), nominal(one)
    return both, bond, moments(one, both, bond, covariance(one, given))


@pytest.fixture(scope="module")
def found(long_case):
    return made_of(long_case, plain(pension_inputs(long_case)))


@pytest.mark.prove
def test_published_bond_prices_are_met_by_the_variance_of_the_rate(found):
    _, _, made = found
    for years, price in PUBLISHED.items():
        far = MEAN - PRICE * SIGMA / KAPPA
        expected = far * years + (START - far) * b(KAPPA, years)
        log_price = -expected + float(made.total[12 * years]) / 2
        assert np.exp(log_price) == pytest.approx(price, abs=1e-9)


@pytest.mark.prove
def test_later_bonds_are_those_of_the_affine_formula(found):
    both, bond, made = found
    years = np.array([1 / 12, 1.0, 10.0, 30.0])
    slopes = with_numpy(slope)(both, bond, years)
    shapes = with_numpy(shape)(slopes, made)
    far = MEAN - PRICE * SIGMA / KAPPA
    for t in (12, 120, 359):
        time = t / 12
        # Of the fitted factor x the short rate is x plus what makes the curve Vasicek's own.
        at_zero = far + (START - far) * np.exp(-KAPPA * time)
        for x in (-0.02, 0.03):
            ratio = vasicek(START, time + years) - vasicek(START, time)
            ours = ratio + shapes[t] - slopes @ [x, 0.0]
            assert ours == pytest.approx(vasicek(at_zero + x, years), abs=1e-13)


@pytest.mark.prove
def test_two_factors_are_those_of_g2():
    """D. Brigo, F. Mercurio, Interest Rate Models, section 4.2: V(t, T) of G2++."""
    steps, a, s, rho = 24, (0.05, 0.4), (0.009, 0.006), -0.5
    two = full(steps)
    correlation = np.zeros(28)
    correlation[0] = rho

    def v(u):
        def own(k, sigma):
            tail = 2 * np.exp(-k * u) / k - np.exp(-2 * k * u) / (2 * k) - 1.5 / k
            return (sigma / k) ** 2 * (u + tail)

        both = u - b(a[0], u) - b(a[1], u) + b(a[0] + a[1], u)
        return own(a[0], s[0]) + own(a[1], s[1]) + 2 * rho * s[0] * s[1] / (a[0] * a[1]) * both

    given = plain(pension_inputs(two)) | {"correlation": correlation}
    years = np.array([0.5, 10.0, 30.0])
    both, bond, made = made_of(two, given)
    shapes = with_numpy(shape)(with_numpy(slope)(both, bond, years), made)
    for t in (1, 12, 24):
        want = (v(years) - v(t / 12 + years) + v(t / 12)) / 2
        assert shapes[t] == pytest.approx(want, abs=1e-14)


@pytest.mark.prove
def test_the_shock_has_the_covariance_that_it_should():
    """Of the integrals over the step, in closed form, and a factor that reproduces it."""
    one = full(3)
    given, place = plain(pension_inputs(one)), slots(one)
    made = with_numpy(covariance)(one, given)
    triangle = with_numpy(factor)(made)
    assert triangle @ triangle.T == pytest.approx(made, abs=1e-16)
    a, d = 0.4, 1 / 12
    zeta, iota = place.zeta[1], place.iota[1]
    assert made[zeta, zeta] == pytest.approx(b(2 * a, d), rel=1e-13)
    assert made[zeta, iota] == pytest.approx(b(a, d) ** 2 / 2, rel=1e-10)
    assert made[iota, iota] == pytest.approx((d - 2 * b(a, d) + b(2 * a, d)) / a**2, rel=1e-8)
    assert made[place.index, place.index] == pytest.approx(d, rel=1e-13)


@pytest.mark.prove
def test_prices_follow_the_break_evens_and_cash_the_curve():
    """Without volatility the path IS the initial curves, step by step."""
    steps = 24
    be = curve("break_even", [1.0, 2.0, 5.0], [0.01, 0.02, 0.025])
    zero = curve("zero_rate", [1.0, 2.0, 5.0], [0.02, 0.03, 0.035])
    still = case(
        steps,
        held_assets=assets(steps, [CASH], weight=[1.0]),
        curve=zero,
        rates=rates(steps, s=0.0),
        inflation=inflation(steps, be),
    )
    from snapo.domains.pension.fund.simulator import PensionSimulator

    simulator = PensionSimulator.of(still)
    with jax.enable_x64(True):
        schedule = prepare(simulator, pension_inputs(still))
        terms, market = schedule.constants.market, schedule.constants.market.start
        roll = jax.jit(lambda now, market, z: move(still, terms, now, market, z).market)
        for t in range(steps):
            now = jax.tree.map(lambda leaf, t=t: leaf[t], schedule.steps.market)
            noise = np.ones(simulator.noise_size)
            market = roll(now, market, noise)
    assert float(market.log_discount) == pytest.approx(-0.06, abs=1e-14)
    assert float(market.log_price) == pytest.approx(0.04, abs=1e-14)


@pytest.mark.prove
def test_a_real_bond_loads_on_prices_too():
    """Real covariances: K has minus the index's own noise, whose variance grows with time."""
    one = full(12)
    given = plain(pension_inputs(one)) | {"correlation": np.zeros(28)}

    @with_numpy
    def totals_and_fits():
        together, both = covariance(one, given), factors(one, given)
        kinds = [moments(one, both, kind, together) for kind in (nominal(one), real(one, given))]
        return [kind.total for kind in kinds], [shift(np.zeros(13), kind) for kind in kinds]

    totals, fits = totals_and_fits()
    t, k, s = 1.0, 0.3, 0.007
    expected = (s / k) ** 2 * (t - 2 * b(k, t) + b(2 * k, t))
    assert totals[1][-1] - totals[0][-1] == pytest.approx(0.011**2 + expected, rel=1e-9)
    assert fits[0].sum() == pytest.approx(totals[0][-1] / 2, rel=1e-12)
