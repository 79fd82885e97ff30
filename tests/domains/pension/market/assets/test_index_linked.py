"""Index-linked bonds: their price by the real curve, their return, and a liability they match."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.market_cases import (
    CASH,
    assets,
    case,
    cash_flows,
    curve,
    full,
    given,
    inflation,
    plan,
    rates,
)

from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.market.assets.asset_class import log_prices
from snapo.domains.pension.market.assets.bond import Bond, IndexLinked
from snapo.domains.pension.market.assets.swaps import swap_values
from snapo.domains.pension.market.curve import log_bond
from snapo.domains.pension.market.dynamics import move
from snapo.domains.pension.market.factors import factors, moments, real, shape, slope
from snapo.domains.pension.market.shocks import covariance
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.plan import Liability
from snapo.domains.pension.results.balance import held_now, inflation_ladder, ladder, slopes
from snapo.domains.pension.results.figures.human import human
from snapo.domains.pension.results.figures.reconcile import figures
from snapo.problem.inputs import plain
from snapo.problem.problem import prepare
from snapo.problem.record.either import with_numpy
from snapo.problem.smooth import Exact

MONTHS = 120
A, S, K, SP, SI = 0.05, 0.009, 0.3, 0.007, 0.011


def with_linked(measure="P"):
    """The full case with an index-linked bond in place of its government bond."""
    base = full(6, measure=measure)
    classes = list(base.assets.classes)
    classes[4] = IndexLinked("Linked", maturity=MONTHS, eligible=0.9)
    return replace(base, assets=replace(base.assets, classes=tuple(classes)))


def moved(one, t, noise):
    """A step of the market for a few paths, with the state before it."""
    simulator = PensionSimulator.of(one)
    with jax.enable_x64(True):
        schedule = prepare(simulator, pension_inputs(one))
        terms = schedule.constants.market
        now = jax.tree.map(lambda leaf: leaf[t], schedule.steps.market)
        one_path = jax.jit(jax.vmap(lambda z: move(one, terms, now, terms.start, z)))
        return jax.tree.map(np.asarray, one_path(jnp.asarray(noise)))


def draws(one, paths):
    simulator = PensionSimulator.of(one)
    return np.random.default_rng(3).standard_normal((paths, simulator.noise_size))


@pytest.mark.parametrize(
    "measure",
    [pytest.param("P", marks=pytest.mark.study), pytest.param("Q", marks=pytest.mark.prove)],
)
def test_it_earns_what_its_price_does(measure):
    """In money a bond is I(t) P_real(t, T), on every path and under both measures."""
    one = with_linked(measure)
    given_, d = plain(pension_inputs(one)), one.step
    after = moved(one, 0, draws(one, 16))

    @with_numpy
    def earned():
        both, bond = factors(one, given_), real(one, given_)
        made = moments(one, both, bond, covariance(one, given_))
        at = slope(both, bond, np.array([(MONTHS - 1) * d]))
        times = np.array([0.0, d, MONTHS * d])
        prices = log_bond(one.curve, given_, times)
        prices = prices - log_bond(one.inflation.break_even, given_, times)
        later = prices[2] - prices[1] + shape(at, made)[1] - after.market.factors @ at[0]
        return after.market.log_price + later - prices[2]

    assert np.log(after.gross[:, 4]) == pytest.approx(earned(), abs=1e-14)


def single(linked: bool, **changes):
    """One rate, inflation and prices, all independent; one payment after ten years, yearly."""
    held = (IndexLinked if linked else Bond)("Bond", maturity=10)
    tenor = [1.0, 5.0, 10.0, 30.0]
    usual = {
        "step": 1.0,
        "held_assets": assets(1, [CASH, held], weight=[0.0, 1.0]),
        "flows": cash_flows([100.0], [9]),
        "curve": curve("zero_rate", tenor, [0.02, 0.022, 0.025, 0.026]),
        "rates": rates(1, A, S, -0.1),
        "inflation": inflation(
            1,
            curve("break_even", tenor, [0.018, 0.02, 0.021, 0.022]),
            volatility=SP,
            index=SI,
            price=0.05,
        ),
        "plan": plan(indexation="full"),
        "liability": Liability("risk-free", given("liability_rate", 0.0), "full"),
    }
    return case(**{"steps": 1} | usual | changes)


@pytest.mark.prove
def test_its_variance_is_that_of_the_closed_form():
    """Under "Q" the log return over cash without shocks is minus half the variance of
    s_r int B_r dW_r - s_p int B_p dW_p - s_I dW_I, B over the years left (Jarrow and Yildirim)."""

    def squared(a, u):
        """Integral of B(w)^2 from 0 to u."""
        return (u - 2 * (1 - np.exp(-a * u)) / a + (1 - np.exp(-2 * a * u)) / (2 * a)) / a**2

    one = single(True, measure="Q")
    found = moved(one, 0, np.zeros((1, PensionSimulator.of(one).noise_size)))
    variance = S**2 * (squared(A, 10) - squared(A, 9))
    variance += SP**2 * (squared(K, 10) - squared(K, 9)) + SI**2
    over = np.log(found.gross[0, 1]) - found.cash[0]
    assert over == pytest.approx(-variance / 2, rel=1e-10)


def relative(one, inputs, noise):
    """ln(F' / F) after one step with all in the bond."""
    simulator = PensionSimulator.of(one)
    schedule = simulator.prepare(inputs)
    now = jax.tree.map(lambda leaf: leaf[0], schedule.steps)
    state = simulator.initial(schedule.constants, None)
    action = jnp.array([0.0, 1.0])
    after, _ = simulator.step(schedule.constants, now, state, action, noise, Exact())
    return simulator.terminal(schedule.constants, after, Exact())["log_relative"]


def change_and_gradients(one, noise):
    with jax.enable_x64(True):
        return jax.jit(jax.value_and_grad(lambda given_: relative(one, given_, noise)))(
            {name: jnp.asarray(each) for name, each in plain(pension_inputs(one)).items()}
        )


PRICES = ("break_even", "inflation", "index")


@pytest.mark.prove
def test_a_matched_index_linked_liability_feels_no_inflation():
    linked, nominal = single(True), single(False)
    (noise,) = draws(linked, 1)
    change, found = change_and_gradients(linked, noise)
    for name, slope_ in found.items():
        if name.startswith((*PRICES, "zero_rate", "rate")):
            assert np.abs(slope_).max() < 1e-13, name
    assert float(change) == pytest.approx(0.0, abs=1e-13)
    # Nominal bonds leave the shocks of prices and of their expectation to the fund.
    _, unmatched = change_and_gradients(nominal, noise)
    for name in ("inflation_volatility", "index_volatility"):
        assert np.abs(unmatched[name]).max() > 0.1, name


@pytest.mark.prove
def test_today_its_price_moves_with_both_curves_as_the_liability_does():
    """KR01 and IE01 at every node: assets scaled to the liability leave nothing."""
    one = single(True)
    inputs = plain(pension_inputs(one))
    for each, sign in ((one.curve, -1.0), (one.inflation.break_even, 1.0)):
        found = slopes(each, inputs, lambda moved_: log_prices(one, moved_))
        # A payment after ten years falls by ten times the zero rate, and rises with break-evens.
        assert held_now(one) @ found == pytest.approx(
            100.0 * sign * np.array([0, 0, 10, 0]), abs=1e-12
        )


@pytest.mark.prove
@pytest.mark.parametrize("measure", ["P", "Q"])
def test_its_derivatives_are_those_of_differences(measure):
    """Of returns of an index-linked bond and of a swap of inflation by every number, in float64."""
    one = with_linked(measure)
    assert one.overlay is not None
    one = replace(one, overlay=replace(one.overlay, inflation=1))
    start = plain(pension_inputs(one))
    (noise,) = draws(one, 1)
    simulator = PensionSimulator.of(one)

    def value(given_):
        schedule = simulator.prepare(given_)
        terms = schedule.constants.market
        now = jax.tree.map(lambda leaf: leaf[3], schedule.steps.market)
        found = move(one, terms, now, terms.start, noise)
        return jnp.log(found.gross[4]) + 0.7 * found.swaps[1]

    with jax.enable_x64(True):
        start = {name: np.asarray(each, np.float64) for name, each in start.items()}
        both_of = jax.jit(jax.value_and_grad(value))  # one program for values and derivatives
        found = both_of({name: jnp.asarray(v) for name, v in start.items()})[1]
        checked = 0
        for name in start:
            for place in np.flatnonzero(np.ravel(found[name]))[:3]:
                h = 1e-4 * max(abs(start[name].ravel()[place]), 0.01)
                both = []
                for sign in (1, -1):
                    bumped = start[name].copy()
                    bumped.ravel()[place] += sign * h
                    both.append(float(both_of(start | {name: bumped})[0]))
                central = (both[0] - both[1]) / (2 * h)
                # Round-off of a value of order one: 1e-16 / h.
                exact = float(np.ravel(found[name])[place])
                assert exact == pytest.approx(central, rel=1e-6, abs=1e-15 / h), name
                checked += 1
    assert checked >= 10


@pytest.mark.prove
def test_a_swap_of_inflation_earns_the_index_linked_bond_less_the_nominal_one():
    """On every path, and today it moves with break-evens alone."""
    one = with_linked("P")
    assert one.overlay is not None
    # The first is a zero-coupon swap of rates, the second of inflation.
    overlay = replace(one.overlay, maturities=np.array([MONTHS] * 2), inflation=1, zero_coupon=(0,))
    one = replace(one, overlay=overlay)
    after = moved(one, 0, draws(one, 16))
    nominal, swap = np.exp(after.swaps[:, 0]), np.expm1(after.swaps[:, 1])
    linked = after.gross[:, 4] / np.exp(after.cash)
    assert swap == pytest.approx(linked - nominal, abs=1e-14)
    inputs = plain(pension_inputs(one))
    by_rate = slopes(one.curve, inputs, lambda given_: swap_values(one, given_))
    # Both of its bonds move with the curve: the difference is round-off of ten years.
    assert np.abs(by_rate[1]).max() < 1e-14
    assert by_rate[0].sum() == pytest.approx(-MONTHS * one.step)
    by_price = slopes(one.inflation.break_even, inputs, lambda g: swap_values(one, g))
    assert by_price[1].sum() == pytest.approx(MONTHS * one.step)
    assert np.abs(by_price[0]).max() == 0


@pytest.mark.prove
def test_the_ladders_of_a_matched_index_linked_fund_cancel_at_every_node():
    """PV01 and IE01 of assets less liability, and the hedge ratios are one."""
    one = single(True, plan=plan(indexation="full"))
    inputs = plain(pension_inputs(one))
    found = figures(one, inputs)
    scaled = replace(one, assets=replace(one.assets, amount=given("assets", found.liability)))
    inputs = plain(pension_inputs(scaled))
    none = np.zeros(0)
    for made in (ladder, inflation_ladder):
        rows = made(scaled, inputs, found, none)
        assert rows.assets - rows.liability == pytest.approx(0.0, abs=1e-9)
        assert np.abs(rows.assets).max() > 0.01
    rates = ladder(scaled, inputs, found, none)
    assert rates.real_assets == pytest.approx(rates.assets)
    assert rates.real_liability == pytest.approx(rates.liability)
    seen = human(scaled, inputs, found)
    assert seen.hedge_ratio == pytest.approx(1.0, abs=1e-9)
    assert seen.inflation_hedge_ratio == pytest.approx(1.0, abs=1e-9)


def rolled(one, inputs, noise):
    """ln(F' / F) after some steps, in each of which all is in the bond that matches."""
    simulator = PensionSimulator.of(one)
    schedule = simulator.prepare(inputs)
    state = simulator.initial(schedule.constants, None)
    for t in range(one.steps):
        now = jax.tree.map(lambda leaf, t=t: leaf[t], schedule.steps)
        action = jnp.zeros(one.steps + 1).at[t + 1].set(1.0)
        state, _ = simulator.step(schedule.constants, now, state, action, noise[t], Exact())
    return simulator.terminal(schedule.constants, state, Exact())["log_relative"]


@pytest.mark.prove
def test_a_fund_that_rolls_matched_bonds_feels_nothing_over_several_steps():
    """Each year all moves into the index-linked bond with the years left: the funding ratio does
    not move on any path (its variance is zero), nor with any quote of either curve (PV01, IE01)."""
    years = 3
    held = [IndexLinked(f"Linked {10 - t}", maturity=10 - t) for t in range(years)]
    break_even = curve("break_even", [1.0, 5.0, 10.0, 30.0], [0.018, 0.02, 0.021, 0.022])
    one = single(
        True,
        steps=years,
        held_assets=assets(years, [CASH, *held], weight=[0.0, 1.0] + [0.0] * (years - 1)),
        rates=rates(years, A, S, -0.1),
        inflation=inflation(years, break_even, volatility=SP, index=SI, price=0.05),
    )
    simulator = PensionSimulator.of(one)
    noise = np.random.default_rng(5).standard_normal((8, years, simulator.noise_size))
    with jax.enable_x64(True):
        inputs = {name: jnp.asarray(each) for name, each in plain(pension_inputs(one)).items()}
        both = jax.jit(jax.vmap(jax.value_and_grad(lambda g, z: rolled(one, g, z)), (None, 0)))
        values, found = jax.tree.map(np.asarray, both(inputs, jnp.asarray(noise)))
    assert np.abs(values).max() < 1e-9
    assert np.var(np.exp(values)) < 1e-9
    for name, slope_ in found.items():
        if name.startswith((*PRICES, "zero_rate", "rate")):
            assert np.abs(slope_).max() < 1e-9, name
