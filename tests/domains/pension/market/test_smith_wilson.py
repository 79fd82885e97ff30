"""The Smith-Wilson curve against EIOPA's published ones, the method's example and its equations.

Published figures: CEIOPS, QIS 5 Risk-free interest rates: Extrapolation method, 2010, example 1 with
swaps; EIOPA, Risk-free interest rate term structures of 28 February 2022, euro without volatility
adjustment (EIOPA_RFR_20220228_Term_Structures.xlsx, RFR_spot_no_VA: speed, ultimate forward rate,
last liquid point and rates to five decimals; EIOPA_RFR_20220228_Qb_SW.xlsx: the vector Q b).
The market rates behind it are not published with it; they follow from Q b, and come out as
multiples of half a basis point of a hundredth.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.market_cases import curve

from snapo.domains.pension.chapters.stress import from_zero_rates, zero_rates
from snapo.domains.pension.market.smith_wilson import fit, heart, log_bond
from snapo.problem.record.either import jacobian, with_numpy

# Par swap rates after the adjustment for credit risk, which Q b and the speed imply.
TENOR = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 15, 20]
SWAP = np.array(
    [-455, -54, 155.5, 271, 358, 425, 506.5, 604, 633.5, 686.5, 731, 766, 828.5, 818.5]
) / 1e5  # fmt: skip
SPEED, ULTIMATE = 0.130923, np.log(1.0345)
WEIGHTS = [
    9.71532263092349, -4.66762526731419, -0.782086289152524, 1.21722766415508, -1.67091668351047,
    -1.60420339591657, 11.8242048199888, -18.8967050697783, 14.7854200672507, -5.87733767462073,
    0.463726228132894, 1.01214888173529, -0.00255761248744592, -0.00247231753257218,
    -1.60920689796675, 0.0105583489449545, 0.0102062338762247, 0.00986586164932306,
    0.00953684064700151, 1.1355220680886,
]  # fmt: skip
# In thousandths of a per cent, at 1 to 60 and at 70, 80 … 150 years.
PUBLISHED = [
    -455, -54, 156, 272, 360, 428, 510, 610, 640, 695, 741, 777, 809, 832, 841, 836, 825, 816, 816,
    827, 853, 889, 933, 981, 1033, 1087, 1141, 1196, 1250, 1304, 1356, 1407, 1457, 1505, 1552,
    1597, 1641, 1683, 1723, 1762, 1800, 1836, 1871, 1904, 1937, 1968, 1998, 2027, 2055, 2082,
    2108, 2133, 2157, 2180, 2203, 2225, 2246, 2266, 2286, 2305,
]  # fmt: skip
LATE = {70: 2467, 80: 2589, 90: 2684, 100: 2761, 150: 2990}


def swaps(tenor, rates, speed=None, convergence=60.0):
    found = curve("swap_rate", [float(each) for each in tenor], rates, quote="swap")
    return replace(found, extrapolation="smith-wilson", speed=speed, convergence=convergence)


@partial(jax.jit, static_argnums=0)
def fitted(found, rates):
    known = fit(found, rates, jnp.asarray(ULTIMATE))
    return known.weights, known.speed


def prices(found, rates, ultimate, years):
    years = np.asarray(years)
    at = jax.jit(lambda rate, w: jnp.exp(log_bond(found, rate, w, years)))
    return at(jnp.asarray(rates), jnp.asarray(ultimate))


@pytest.fixture(autouse=True)
def wide():
    with jax.enable_x64(True):
        yield


def test_the_example_of_the_method():
    rates = [0.01, 0.02, 0.026, 0.034]
    found = swaps([1, 2, 3, 5], rates, 0.1)
    assert round(float(prices(found, rates, np.log(1.042), [4.0])[0]), 3) == 0.885


@pytest.mark.prove
def test_the_euro_curve_of_february_2022_to_its_printed_digits():
    found = swaps(TENOR, SWAP)
    # Its speed is rounded up to six decimals.
    assert np.ceil(1e6 * float(fitted(found, SWAP)[1])) / 1e6 == SPEED
    years = np.array([*range(1, 61), *LATE], float)
    given = swaps(TENOR, SWAP, SPEED)
    for case in (found, given):
        rate = np.asarray(prices(case, SWAP, ULTIMATE, years)) ** (-1 / years) - 1
        missed = np.abs(1e5 * rate - [*PUBLISHED, *LATE.values()])
        # Half a printed unit, and 1e-4 of one: the rates at 5 and 8 years end in a 5.
        assert missed.max() < 0.5001
    assert np.asarray(fitted(given, SWAP)[0]) == pytest.approx(WEIGHTS, abs=1e-10)


@pytest.mark.prove
def test_quotes_are_met_and_far_forward_rates_go_to_the_ultimate_one():
    zero = replace(swaps([0.5, 2.25, 10, 25], [0.01, 0.02, 0.03, 0.025], 0.12), quote="zero")
    rate = zero.rate.used()
    years = np.array([0.0, *zero.tenor])
    assert np.log(prices(zero, rate, 0.03, years)) == pytest.approx(-years * [0, *rate], abs=1e-13)
    found = swaps(TENOR, SWAP)
    paid = np.asarray(prices(found, SWAP, ULTIMATE, np.arange(1.0, 21)))
    par = [(1 - paid[n - 1]) / paid[:n].sum() for n in TENOR]
    assert par == pytest.approx(SWAP, abs=1e-14)

    def forward(years):
        return -jax.grad(lambda t: log_bond_at(found, t))(years)

    assert abs(float(forward(60.0)) - ULTIMATE) == pytest.approx(1e-4, rel=1e-9)
    assert abs(float(forward(150.0)) - ULTIMATE) < 1e-8


def log_bond_at(found, years):
    """ln P at a time that has a derivative and lies beyond all dates, from the definition."""
    weights, a = fitted(found, found.rate.used())
    u = np.arange(1.0, 21)
    return jnp.log1p((a * u - jnp.exp(-a * years) * jnp.sinh(a * u)) @ weights) - ULTIMATE * years


@pytest.mark.prove
@pytest.mark.parametrize("speed", [None, 0.2])
def test_derivatives_by_every_quote_follow_the_speed_that_is_found(speed):
    found = swaps(TENOR, SWAP, speed)
    years = np.array([0.5, 7.5, 30.0, 80.0])
    both = jax.jit(lambda rate, w: log_bond(found, rate, w, years))
    slope = jax.jit(jax.jacrev(lambda rate, w: log_bond(found, rate, w, years), (0, 1)))
    by_rate, by_ultimate = slope(jnp.asarray(SWAP), jnp.asarray(ULTIMATE))
    step = 1e-5
    for i in range(len(TENOR)):
        up, down = (SWAP + sign * step * (np.arange(len(TENOR)) == i) for sign in (1, -1))
        want = (both(up, ULTIMATE) - both(down, ULTIMATE)) / (2 * step)
        assert np.asarray(by_rate)[:, i] == pytest.approx(np.asarray(want), rel=1e-6, abs=1e-6)
    want = (both(SWAP, ULTIMATE + step) - both(SWAP, ULTIMATE - step)) / (2 * step)
    assert np.asarray(by_ultimate) == pytest.approx(np.asarray(want), rel=1e-6, abs=1e-6)


@pytest.mark.prove
def test_quotes_of_moved_zero_rates_give_these_zero_rates():
    found = replace(swaps(TENOR, SWAP), ultimate=curve("far", [1.0], [ULTIMATE]).rate)
    found = replace(found, ultimate=replace(found.ultimate, index=np.array(0)))
    zero = zero_rates(found)
    assert from_zero_rates(found, zero) == pytest.approx(SWAP, abs=1e-14)
    moved = replace(found, rate=replace(found.rate, values=from_zero_rates(found, zero + 0.01)))
    assert zero_rates(moved) == pytest.approx(zero + 0.01, abs=1e-13)


def test_the_heart_is_symmetric_and_zero_at_time_zero():
    times = np.array([0.0, 0.25, 1.0, 5.0, 49.5])
    found = np.asarray(heart(times, times, jnp.asarray(0.2)))
    assert found == pytest.approx(found.T, abs=1e-15)
    assert found[0] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("speed", [0.12, None])
@pytest.mark.parametrize("quote", ["zero", "swap"])
def test_numpy_evaluates_and_differentiates_the_curve_as_jax_does(quote, speed):
    """A check does so; by a computed speed too, whose search no derivative repeats."""
    rates, years = np.array([0.01, 0.02, 0.026, 0.034, 0.03]), np.array([0.5, 4.0, 40.0, 120.0])
    curve = replace(swaps([1, 2, 3, 5, 10], rates, speed), quote=quote)

    def function(rate):
        return log_bond(curve, rate, ULTIMATE, years)

    exact = jax.jit(lambda rate: (function(rate), jax.jacrev(function)(rate)))(rates)
    np.testing.assert_allclose(with_numpy(function)(rates), exact[0], rtol=1e-10)
    np.testing.assert_allclose(jacobian(function, rates), exact[1], rtol=1e-8, atol=1e-9)
