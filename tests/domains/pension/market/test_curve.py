"""Curves against their definitions, node by node."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from tests.domains.pension.market_cases import curve, given

from snapo.domains.pension.market.correlation import check_correlation, nearest
from snapo.domains.pension.market.curve import log_bond

TENOR = [1.0, 2.0, 5.0, 10.0]
RATES = np.array([0.01, 0.015, 0.02, 0.03])


def price(found, years, rates=RATES):
    with jax.enable_x64(True):
        return np.asarray(log_bond(found, {found.rate.name: rates}, np.asarray(years, float)))


def test_zero_rates_are_linear_between_nodes_and_flat_before_the_first():
    found = curve("zero_rate", TENOR, RATES)
    years = np.array([0.0, 0.5, 1.0, 1.5, 3.0, 10.0])
    zero = np.array([0.01, 0.01, 0.01, 0.0125, 0.015 + 0.005 / 3, 0.03])
    assert price(found, years) == pytest.approx(-zero * years, abs=1e-15)


def test_forward_rates_are_constant_in_the_interval_that_ends_at_the_node():
    found = curve("forward_rate", TENOR, RATES, quote="forward")
    want = -np.array([0.0, 0.005, 0.01, 0.0175, 0.045, 0.01 + 0.015 + 0.06 + 0.15])
    assert price(found, [0, 0.5, 1, 1.5, 3, 10]) == pytest.approx(want, abs=1e-15)


@pytest.mark.parametrize("quote", ["zero", "forward"])
def test_beyond_the_last_node_the_last_forward_rate_goes_on(quote):
    found = curve("zero_rate", TENOR, RATES, quote=quote)
    forward = (10 * 0.03 - 5 * 0.02) / 5 if quote == "zero" else 0.03
    at_node = price(found, [10.0])[0]
    assert price(found, [40.0])[0] == pytest.approx(at_node - 30 * forward, abs=1e-14)


def test_an_ultimate_rate_is_reached_at_the_given_speed():
    ultimate = given("ultimate_forward", 0.04)
    found = replace(curve("zero_rate", TENOR, RATES), extrapolation="ultimate", ultimate=ultimate)
    # The last forward rate is 4 % itself: nothing moves.
    assert price(found, [30.0])[0] == pytest.approx(-0.3 - 20 * 0.04, abs=1e-14)
    slow = replace(found, ultimate=given("ultimate_forward", 0.02))
    integral = 0.02 * 20 + (0.04 - 0.02) * (1 - np.exp(-2)) / 0.1
    assert price(slow, [30.0])[0] == pytest.approx(-0.3 - integral, abs=1e-14)


def test_a_price_at_a_node_depends_on_that_node_alone():
    found = curve("zero_rate", TENOR, RATES)
    with jax.enable_x64(True):
        slope = jax.jacobian(lambda z: log_bond(found, {"zero_rate": z}, np.array([5.0])))(RATES)
    assert np.asarray(slope)[0] == pytest.approx([0, 0, -5, 0], abs=0)


def test_the_nearest_correlation_matrix_is_the_published_one():
    """N. Higham's example (IMA J. Numer. Anal. 22, 2002): ones beside the diagonal, 0 apart."""
    given_matrix = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [0.0, 1.0, 1.0]])
    assert check_correlation(given_matrix) < 0
    found, change = nearest(given_matrix)
    assert found[0, 1] == pytest.approx(0.7607, abs=1e-4)
    assert found[0, 2] == pytest.approx(0.1573, abs=1e-4)
    assert change == pytest.approx(1 - 0.7607, abs=1e-4)
    assert check_correlation(found) > 0
    assert np.diag(found) == pytest.approx(np.ones(3), abs=1e-15)


def test_a_correlation_matrix_that_is_one_stays():
    good = np.array([[1.0, 0.5], [0.5, 1.0]])
    found, change = nearest(good)
    assert change < 1e-12 and found == pytest.approx(good)
