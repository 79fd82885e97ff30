"""Asset returns: bonds against prices of the curve model, martingales, means as given."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.market_cases import full

from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.market.dynamics import move
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.problem.inputs import plain
from snapo.problem.problem import prepare

STEPS, PATHS = 6, 2**16


def step(case, t, noise, market=None):
    """One step of the market for many paths: `noise` [N, Z]."""
    simulator = PensionSimulator.of(case)
    with jax.enable_x64(True):
        schedule = prepare(simulator, pension_inputs(case))
        terms = schedule.constants.market
        now = jax.tree.map(lambda leaf: leaf[t], schedule.steps.market)
        start = terms.start if market is None else market
        one = eqx.filter_jit(eqx.filter_vmap(lambda z: move(case, terms, now, start, z)))
        return jax.tree.map(np.asarray, one(jnp.asarray(noise))), schedule


def draws(case, paths=PATHS, seed=0):
    size = PensionSimulator.of(case).noise_size
    half = np.random.default_rng(seed).standard_normal((paths // 2, size))
    return np.concatenate([half, -half])


@pytest.mark.study
def test_bonds_and_swaps_earn_what_their_prices_do():
    """Over the first step under "Q": ln P(d, m d) - ln P(0, m d), whatever happens."""
    two = full(STEPS, measure="Q")
    two = replace(two, credit=replace(two.credit), observation=("time",))
    moved, schedule = step(two, 0, draws(two, 8))
    terms = schedule.constants.market
    from snapo.domains.pension.market.curve import log_bond
    from snapo.domains.pension.market.factors import factors, moments, nominal, shape, slope
    from snapo.domains.pension.market.shocks import covariance

    given, d = plain(pension_inputs(two)), two.step
    assert two.overlay is not None
    with jax.enable_x64(True):
        both, bond = factors(two, given), nominal(two)
        made = moments(two, both, bond, covariance(two, given))
        for months, got in ((120, np.log(moved.gross[:, 4])), (240, moved.swaps[:, 1])):
            left = np.array([(months - 1) * d])
            slopes = slope(both, bond, left)
            prices = log_bond(two.curve, given, np.array([0.0, d, months * d]))
            after = prices[2] - prices[1] + shape(slopes, made)[1]
            after = after - moved.market.factors @ slopes[0]
            want = np.asarray(after - prices[2])
            want = want - (moved.cash if months == 240 else 0.0)
            assert got == pytest.approx(want, abs=1e-14)
    assert terms.swap_slope is None


@pytest.mark.prove
@pytest.mark.parametrize("start", [0.0, 0.4])
def test_every_class_earns_cash_on_average_under_q(start):
    """Whatever the spread stands at; hedging is free here, and appraisals are off."""
    two = full(
        STEPS, measure="Q", held_assets=replace(full(STEPS).assets, smoothed=np.zeros(0, int))
    )
    free = replace(
        two.currencies, hedge_cost=replace(two.currencies.hedge_cost, values=np.zeros(1))
    )
    two = replace(two, currencies=free)
    _, schedule = step(two, 3, draws(two, 4))
    market = schedule.constants.market.start
    market = market._replace(spread=np.array([start, -start]))
    moved, _ = step(two, 3, draws(two), market)
    over = moved.gross / np.exp(moved.cash)[:, None] - 1
    swaps = np.expm1(moved.swaps)
    for values in (*over.T[1:], *swaps.T):
        pairs = values.reshape(2, -1).mean(0)
        assert abs(pairs.mean()) < 4 * pairs.std() / np.sqrt(pairs.size) + 1e-15


@pytest.mark.prove
def test_means_are_what_the_case_says():
    """Arithmetic: 1 + mean is the expected gross return of a year; geometric and log: of the log."""
    base = full(STEPS, held_assets=replace(full(STEPS).assets, smoothed=np.zeros(0, int)))
    noise = draws(base)
    logs = {}
    for kind in ("arithmetic", "geometric", "log"):
        one = replace(base, assets=replace(base.assets, mean_kind=kind, return_kind="total"))
        moved, _ = step(one, 0, noise)
        logs[kind] = np.log(moved.gross[:, 1])
        if kind == "arithmetic":
            gross = moved.gross[:, 1].reshape(2, -1).mean(0)
            error = gross.std() / np.sqrt(gross.size)
            assert abs(gross.mean() - 1.035 ** (1 / 12)) < 4 * error
    assert logs["geometric"].mean() == pytest.approx(np.log1p(0.035) / 12, abs=1e-12)
    assert logs["log"].mean() == pytest.approx(0.035 / 12, abs=1e-12)
    assert logs["log"].std() == pytest.approx(0.18 / np.sqrt(12), rel=0.02)


@pytest.mark.prove
def test_an_appraisal_shows_part_of_the_return_at_once_and_the_rest_later():
    base = full(STEPS)
    sharp = replace(base, assets=replace(base.assets, smoothed=np.zeros(0, int)))
    noise = draws(base, 8)
    shown, _ = step(base, 0, noise)
    true, _ = step(sharp, 0, noise)
    assert np.log(shown.gross[:, 3]) == pytest.approx(0.4 * np.log(true.gross[:, 3]), abs=1e-15)
    assert shown.gross[:, 1] == pytest.approx(true.gross[:, 1], abs=0)


@pytest.mark.prove
def test_credit_earns_its_spread_less_defaults_in_the_real_world():
    """With no volatilities a bond at its mean spread s earns s - default loss over cash."""
    base = full(STEPS)

    def zero(given):
        return replace(given, values=np.zeros_like(given.values))

    at_mean = replace(base.credit.spread, values=base.credit.mean_spread.values)
    still = replace(
        base,
        rates=replace(base.rates, volatility=zero(base.rates.volatility)),
        credit=replace(base.credit, volatility=zero(base.credit.volatility), spread=at_mean),
    )
    moved, _ = step(still, 0, np.zeros((1, PensionSimulator.of(still).noise_size)))
    over = np.log(moved.gross[0]) - moved.cash[0]
    assert over[5] == pytest.approx((0.01 - 0.001) / 12, abs=1e-15)
    assert over[4] == pytest.approx(0.0, abs=1e-15)
