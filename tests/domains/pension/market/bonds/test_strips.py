"""Coupon bonds and par swaps against a calculation of their own with Hull and White's bond prices."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from hypothesis import given as given_numbers
from hypothesis.extra.numpy import arrays
from hypothesis.strategies import floats
from tests.domains.pension.market_cases import CASH, assets, case, cash_flows, curve, given, rates

from snapo.domains.pension.chapters.stress import Stressed, stressed
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.market.assets.asset_class import log_prices
from snapo.domains.pension.market.assets.bond import Bond, CouponBond
from snapo.domains.pension.market.assets.swaps import swap_values
from snapo.domains.pension.market.bonds.payments import AT_PAR, payments
from snapo.domains.pension.market.bonds.strips import gain, shares
from snapo.domains.pension.market.dynamics import move
from snapo.domains.pension.records.assets import Overlay
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.results.balance import BASIS_POINT, ladder, slopes
from snapo.domains.pension.results.figures.human import human
from snapo.domains.pension.results.figures.reconcile import figures
from snapo.problem.inputs import plain
from snapo.problem.problem import prepare

A, S, D = 0.05, 0.011, 1 / 12
TENOR = np.array([1.0, 5.0, 10.0, 20.0, 30.0])
ZERO = np.array([0.015, 0.02, 0.025, 0.024, 0.023])


def fund(measure="Q"):
    """Bonds of 10 years at par, of 7.5 years at 6 %, and a zero-coupon one; three swaps."""
    classes = [
        CASH,
        CouponBond("Par", maturity=120, coupon=AT_PAR),
        CouponBond("Six", maturity=90, coupon=0.06),
        Bond("Zero", maturity=120),
    ]
    swaps = Overlay(
        maturities=np.array([60, 120, 240]),
        notional=given("overlay_notional", [30.0, 20.0, 10.0]),
        low=np.zeros(3),
        high=np.ones(3),
        unit="assets",
        leverage=given("overlay_leverage", 2.0),
        cost=given("overlay_cost", [0.0] * 3),
        collateral_stress=given("overlay_collateral_stress", 0.035),
        zero_coupon=(1,),
    )
    return case(
        3,
        measure=measure,
        held_assets=assets(3, classes, weight=[0.1, 0.4, 0.3, 0.2]),
        flows=cash_flows([100.0], [119]),
        curve=curve("zero_rate", TENOR, ZERO),
        rates=rates(3, A, S),
        overlay=swaps,
    )


def today(years, bump=0.0):
    """Discount factors; `bump` of the quotes at `TENOR`."""
    return np.exp(-np.interp(years, TENOR, ZERO + bump) * years)


def dates(years):
    """Payment times and the years for which each pays a coupon, the last one with the principal."""
    times = years - np.arange(np.ceil(years))[::-1]
    return times, np.diff(times, prepend=0.0)


def due(years, coupon, price):
    """Times and amounts; `coupon` None: at par of `price` (times)."""
    times, periods = dates(years)
    last = times == years
    if coupon is None:
        coupon = (1 - price(years)) / (periods @ price(times))
    return times, coupon * periods + last


HELD = ((10.0, None), (7.5, 0.06), (10.0, 0.0))
SWAPS = ((5.0, None), (10.0, 0.0), (20.0, None))


def variance(u):
    """Var of the integral of the short rate over u years."""
    return S**2 / A**2 * (u + 2 * np.exp(-A * u) / A - np.exp(-2 * A * u) / (2 * A) - 1.5 / A)


def price(t, x):
    """P(t, t + u) by Hull and White at the short rate's deviation x from its forward rate's path."""

    def at(u):
        reach = (1 - np.exp(-A * u)) / A
        convex = (variance(u) - variance(t + u) + variance(t)) / 2
        return today(t + u) / today(t) * np.exp(-reach * x + convex)

    return at


def test_payments_are_yearly_and_the_first_in_proportion():
    found = payments([120, 90, 24], [AT_PAR, 0.06, 0.0], D)
    assert found.steps.tolist() == [*range(6, 91, 6), 96, 108, 120]
    assert found.period.sum(1) == pytest.approx([10.0, 7.5, 0.0])
    assert found.period[1, 0] == pytest.approx(0.5)
    assert found.principal @ found.steps == pytest.approx([120, 90, 24])


def grown(years, coupon, before, after):
    """The value after a step over that before it, a month's payments later."""
    times, amount = due(years, coupon, before)
    return amount @ after(times - D) / (amount @ before(times))


@pytest.mark.prove
def test_a_step_earns_what_the_prices_of_all_payments_do():
    """Two steps, so that the second one begins on a path's own curve."""
    one = fund()
    simulator = PensionSimulator.of(one)
    noise = 3 * np.random.default_rng(2).standard_normal((2, simulator.noise_size))
    with jax.enable_x64(True):
        schedule = prepare(simulator, pension_inputs(one))
        terms, market = schedule.constants.market, schedule.constants.market.start
        roll = eqx.filter_jit(lambda now, market, z: move(one, terms, now, market, z))
        for t in range(2):
            now = jax.tree.map(lambda leaf, t=t: leaf[t], schedule.steps.market)
            moved = roll(now, market, noise[t])
            states = (t, market), (t + 1, moved.market)
            curves = [price(s * D, float(each.factors[0])) for s, each in states]
            want = [grown(*each, *curves) for each in HELD]
            assert np.asarray(moved.gross[1:]) == pytest.approx(want, rel=1e-12)
            gains = np.exp(moved.cash) * np.expm1(moved.swaps)
            want = [grown(*each, *curves) - np.exp(moved.cash) for each in SWAPS]
            assert gains == pytest.approx(np.array(want), abs=1e-13)
            market = moved.market


@pytest.mark.prove
def test_key_rates_and_durations_are_those_of_bumped_curves():
    """DV01 of the whole and by node, and a stress in full, from NumPy's own discount factors."""
    one = fund()
    inputs = plain(pension_inputs(one))
    known = figures(one, inputs)
    notional = np.array([30.0, 20.0, 10.0])
    found = ladder(one, inputs, known, notional)

    def worth(bump):
        held = swaps = 0.0
        for share, each in zip((40.0, 30.0, 20.0), HELD):
            times, amount = due(*each, today)
            held += share * (amount @ today(times, bump) / (amount @ today(times)))
        for money, each in zip(notional, SWAPS):
            times, amount = due(*each, today)
            swaps += money * (amount @ today(times, bump) / (amount @ today(times)) - 1)
        return np.array([held, swaps])

    h = 1e-6
    for place, node in enumerate(np.eye(len(TENOR))):
        slope = (worth(h * node) - worth(-h * node)) / (2 * h) * BASIS_POINT
        assert found.assets[place] == pytest.approx(slope[0], abs=1e-9)
        assert found.swaps[place] == pytest.approx(slope[1], abs=1e-9)
    parallel = (worth(h) - worth(-h)).sum() / (2 * h)
    assert human(one, inputs, known).asset_duration == pytest.approx(-parallel / 100, rel=1e-7)
    risen = Stressed("rise", {"zero_rate": ZERO + 0.01}, np.ones(4))
    assert stressed(one, inputs, risen, notional).assets == pytest.approx(
        10 + worth(0.01).sum(), rel=1e-12
    )
    with jax.enable_x64(True):
        assert np.asarray(log_prices(one, inputs)) == pytest.approx(np.zeros(4), abs=1e-15)


@pytest.mark.prove
def test_a_zero_coupon_swap_moves_by_more_than_a_par_swap():
    """On 3 % a year, by 14 % at 10 years and 49 % at 30."""
    for years, more in ((10, 0.138), (30, 0.486)):
        one = fund()
        assert one.overlay is not None
        moved = []
        for zero_coupon in ((), (0,)):
            swaps = replace(
                one.overlay,
                maturities=np.array([12 * years]),
                notional=given("overlay_notional", [1.0]),
                zero_coupon=zero_coupon,
            )
            flat = replace(
                one, overlay=swaps, curve=curve("zero_rate", [1.0, 30.0], [np.log(1.03)] * 2)
            )
            worth = slopes(flat.curve, {}, lambda given_, flat=flat: swap_values(flat, given_))
            moved.append(worth.sum())
        assert moved[1] / moved[0] - 1 == pytest.approx(more, abs=5e-4)


@given_numbers(rise=arrays(np.float64, 12, elements=floats(-0.4, 0.6)), rate=floats(-0.03, 0.09))
def test_gains_are_those_of_the_shares_of_all_payments(rise, rate):
    """At par, of a coupon and of none; the first coupon is due for two thirds of a year."""
    of = payments([144, 140, 12, 7, 60], [AT_PAR, 0.04, AT_PAR, 0.03, 0.0], 1 / 12)
    price, growth = np.exp(-rate * of.steps / 12), rise[np.arange(len(of.steps)) % len(rise)]
    expected = np.asarray(shares(of, price)) @ growth
    np.testing.assert_allclose(gain(of, price, growth), expected, rtol=1e-5, atol=1e-6)
    assert np.all(np.asarray(gain(of, price, 0 * growth)) == 0)
