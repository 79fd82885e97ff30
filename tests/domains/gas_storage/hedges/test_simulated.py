"""Exposures and simulated hedges against D11 of the desk's reference cases and closed forms."""

import datetime

import numpy as np
import pytest
from scipy.special import ndtr
from tests.domains.gas_storage.hedges.slow_store import DAYS, SlowStore, dates, plan

from snapo.domains.gas_storage.hedges import DELTAS, MIN_VARIANCE, DailyHedge
from snapo.domains.gas_storage.hedges.exposures import FittedExposures, StorePaths, sensitivities
from snapo.domains.gas_storage.hedges.held import Overnight, by_day
from snapo.domains.gas_storage.hedges.simulate import DailyHedges, HedgeGains, static
from snapo.domains.gas_storage.ladder.forwards import PathCurves, drawn_states
from snapo.domains.gas_storage.ladder.products import TradedProduct, TradedProducts, usual_products
from snapo.domains.gas_storage.prices.process import GaussianFactors

DAY_AHEAD, BALANCE, MONTHS = ("day_ahead",), ("balance_of_month",), ("months",)
# D11, exact: deviations with the parallel factor, and without it.
STATIC = {"plan by day": 208.54, "plan": 202.31, "deltas by day": 114.50, "deltas": 115.13}
DAILY = {
    DailyHedge(DELTAS, MONTHS): (108.53, 86.90),
    DailyHedge(DELTAS, BALANCE + MONTHS): (32.63, 32.03),
    DailyHedge(DELTAS, DAY_AHEAD + BALANCE + MONTHS): (28.85, 28.32),
    DailyHedge(MIN_VARIANCE, MONTHS): (116.80, None),
    DailyHedge(MIN_VARIANCE, DAY_AHEAD): (339.34, None),
    DailyHedge(MIN_VARIANCE, DAY_AHEAD + MONTHS): (24.58, None),
}
UNHEDGED, VALUE = 371.85, 656.153


def gained(gains: HedgeGains) -> np.ndarray:
    return sum((gain.gain for gain in gains.values()), np.zeros(()))


def close(money: np.ndarray, deviation: float) -> None:
    """Within 3 %, its mean within 3 standard errors."""
    assert money.std() == pytest.approx(deviation, rel=0.03)
    assert abs(money.mean() - VALUE) < 3 * money.std() / np.sqrt(money.size)


@pytest.mark.prove
def test_profit_and_loss_of_the_slow_store():
    """D11: all eleven deviations."""
    store, days = SlowStore(), dates()
    assert store.value == pytest.approx(VALUE, abs=0.01)
    fit, paths = store.paths(8192, 1), store.paths(8192, 2)
    close(paths.money, UNHEDGED)
    overnight = Overnight(usual_products(days, days[0]))
    rows = {" by day": by_day(DAYS, 0), "": overnight.to_delivery()}
    volumes = {"plan": plan(), "deltas": fit.volumes}
    for name, deviation in STATIC.items():
        kind, where = name.split(" ")[0], name.removeprefix("plan").removeprefix("deltas")
        close(paths.money + gained(static(paths, rows[where], volumes[kind], 0)), deviation)
    results = DailyHedges(overnight, tuple(DAILY)).simulated(fit, paths)
    for (deviation, _), gains in zip(DAILY.values(), results, strict=True):
        close(paths.money + gained(gains), deviation)


@pytest.mark.study
def test_profit_and_loss_without_the_parallel_factor():
    """D11: months alone leave nine tenths of the rest, which the balance of the month removes."""
    store, days = SlowStore(), dates()
    fit, paths = store.paths(8192, 3, 0.0), store.paths(8192, 4, 0.0)
    close(paths.money, 97.64)
    hedges = [hedge for hedge, (_, alone) in DAILY.items() if alone is not None]
    results = DailyHedges(Overnight(usual_products(days, days[0])), hedges).simulated(fit, paths)
    for hedge, gains in zip(hedges, results, strict=True):
        close(paths.money + gained(gains), DAILY[hedge][1])


# A store whose flows are options, with known deltas: a unit is sold on each day on which the price
# is above the strike.
SHORT, STRIKE, VOLATILITY, SPEED = 40, 20.0, 1.2, 15.0


def one_factor(days: int = SHORT, before: int = 0) -> GaussianFactors:
    """An Ornstein-Uhlenbeck factor by day, `before` days from the valuation date to the first."""
    gaps = np.append(before, np.ones(days)) / 365
    decay, left = np.exp(-SPEED * gaps), np.exp(-2 * SPEED * gaps)
    shock = np.sqrt((1 - left) / (2 * SPEED))
    variance = VOLATILITY**2 * (1 - np.exp(-2 * SPEED * np.cumsum(gaps))) / (2 * SPEED)
    loading = np.full((days + 1, 1), VOLATILITY)
    return GaussianFactors(loading, variance, decay[:, None], shock[:, None, None])


def options(count: int, seed: int, prices: GaussianFactors, forward: np.ndarray) -> StorePaths:
    states, days = drawn_states(prices, count, seed), len(forward) - 1
    spots = PathCurves(prices, forward, states).spots
    sold = (spots > STRIKE).astype(float)
    sold[-1] = 0.0
    levels = np.concatenate([np.full((1, count), float(days)), days - np.cumsum(sold, axis=0)[:-1]])
    money = np.sum(sold * (spots - STRIKE), axis=0)
    return StorePaths(prices, forward, np.ones(days + 1), states, levels, sold, money)


def option_deltas(paths: StorePaths, t: int) -> np.ndarray:
    """[T - t, N] E_t[S 1{S > K}] / F = Phi(d1), Black's delta, on step t."""
    prices, total = paths.factors, paths.factors.variance
    later = np.arange(t + 1, len(total))
    left = np.exp(-2 * SPEED * (later - t) / 365) * total[t]
    deviation = np.sqrt(total[later] - left)[:, None]
    assert not prices.additive
    return ndtr(np.log(paths.ahead(t) / STRIKE) / deviation + deviation / 2)


def forward_curve() -> np.ndarray:
    return STRIKE + 2.0 * np.sin(np.arange(SHORT + 1) / 6)


def test_exposures_along_paths_are_the_deltas_of_options():
    """Black's delta of each product, within the error of the fit: 21 functions on 8,192 paths."""
    prices, forward, t = one_factor(), forward_curve(), 9
    blocks = [(t + 1, 30), (t + 10, 30), (30, SHORT)]
    fit, paths = (options(8192, seed, prices, forward) for seed in (1, 2))
    exposures = FittedExposures.of(fit, {n: blocks if n == t else [] for n in range(SHORT)})
    ahead = paths.ahead(t)
    volumes, factor = exposures.at(t, paths, ahead)
    deltas = option_deltas(paths, t)
    for volume, (first, after) in zip(volumes, blocks, strict=True):
        days = slice(first - t - 1, after - t - 1)
        exact = np.sum(deltas[days] * ahead[days], axis=0) / ahead[days].sum(axis=0)
        assert np.std(exact) > 0.02
        assert np.sqrt(np.mean((volume - exact) ** 2)) < 0.025
    exact = np.einsum("dn,df->fn", (deltas * ahead)[:-1], sensitivities(prices, t)[:-1])
    assert np.sqrt(np.mean((factor - exact) ** 2)) < 0.04 * np.mean(exact)


def test_the_mean_falls_by_half_the_spread_times_the_volume_traded():
    """On every path, of daily and static hedges; without a spread no hedge moves the mean."""
    prices, forward = one_factor(), forward_curve()
    fit, paths = options(1024, 1, prices, forward), options(1024, 2, prices, forward)
    first = datetime.date(2026, 3, 10)
    days = tuple(first + datetime.timedelta(n) for n in range(SHORT))
    free = usual_products(days, first)
    dear = TradedProducts(
        days, first, tuple(x._replace(bid_offer=0.4) for x in free.products), 0.4, (0.4, 0.0)
    )
    hedges = [DailyHedge(DELTAS, DAY_AHEAD + BALANCE + MONTHS), DailyHedge(DELTAS, MONTHS)]
    hedges += [DailyHedge(MIN_VARIANCE, DAY_AHEAD + MONTHS)]
    without, gains = (DailyHedges(Overnight(x), hedges).simulated(fit, paths) for x in (free, dear))
    without += [static(paths, Overnight(free).to_delivery(), fit.volumes, 0)]
    gains += [static(paths, Overnight(dear).to_delivery(), fit.volumes, 0)]
    for plain, costly in zip(without, gains, strict=True):
        traded = sum(gain.traded for gain in costly.values())
        np.testing.assert_allclose(gained(costly), gained(plain) - 0.2 * traded, atol=1e-9)
        assert np.min(traded) > 0
        assert all(np.all(gain.cost == 0) for gain in plain.values())
        assert abs(gained(plain).mean()) < 3 * gained(plain).std() / np.sqrt(1024)


def test_one_product_hedges_one_factor():
    """Least variance in the day-ahead alone: what is left is of second order in a day's shock."""
    prices, forward = one_factor(), forward_curve()
    fit, paths = options(8192, 1, prices, forward), options(8192, 2, prices, forward)
    days = tuple(datetime.date(2026, 3, 10) + datetime.timedelta(n) for n in range(SHORT))
    hedge = [DailyHedge(MIN_VARIANCE, DAY_AHEAD)]
    (gains,) = DailyHedges(Overnight(usual_products(days, days[0])), hedge).simulated(fit, paths)
    assert np.std(paths.money + gained(gains)) < 0.25 * np.std(paths.money)


def test_before_the_first_delivery_the_exposures_of_today_are_held():
    """Valued 60 days earlier: on the valuation date all paths hold the same volumes."""
    prices, forward = one_factor(before=60), forward_curve()
    fit, paths = options(4096, 1, prices, forward), options(4096, 2, prices, forward)
    days = tuple(datetime.date(2026, 3, 1) + datetime.timedelta(n) for n in range(SHORT))
    overnight = Overnight(usual_products(days, datetime.date(2025, 12, 31)))
    assert overnight.first == -1
    hedges = [DailyHedge(DELTAS, DAY_AHEAD + BALANCE + MONTHS)]
    (gains,) = DailyHedges(overnight, hedges).simulated(fit, paths)
    assert np.std(paths.money + gained(gains)) < 0.35 * np.std(paths.money)
    assert abs(gained(gains).mean()) < 3 * gained(gains).std() / np.sqrt(4096)


def test_volumes_are_multiples_of_a_lot():
    """A lot so large that no exposure is half of it leaves the contract unhedged."""
    prices, forward = one_factor(), forward_curve()
    fit, paths = options(512, 1, prices, forward), options(512, 2, prices, forward)
    days = tuple(datetime.date(2026, 3, 10) + datetime.timedelta(n) for n in range(SHORT))
    hedge, traded = [DailyHedge(DELTAS, BALANCE)], []
    for lot in (0.0, 0.25, 5.0):
        products = TradedProducts(days, days[0], (), 0.0, (0.0, lot))
        (gains,) = DailyHedges(Overnight(products), hedge).simulated(fit, paths)
        traded.append(gains["balance_of_month"].traded)
    assert np.all(np.abs(traded[1] / 0.25 - np.round(traded[1] / 0.25)) < 1e-9)
    assert np.min(traded[0]) > 0 and np.all(traded[2] == 0)


def test_normal_prices_have_volumes_as_exposures():
    """S = F + s f: the value moves with the price by the expected volume, Phi(d)."""
    prices, forward, t = one_factor(), forward_curve(), 12
    prices = prices._replace(loading=8.0 * prices.loading, variance=64 * prices.variance)
    prices = prices._replace(additive=True)
    fit, paths = options(8192, 1, prices, forward), options(8192, 2, prices, forward)
    blocks = [(t + 1, 25)]
    exposures = FittedExposures.of(fit, {n: blocks if n == t else [] for n in range(SHORT)})
    ahead = paths.ahead(t)
    (volume,), _ = exposures.at(t, paths, np.ones_like(ahead))
    later = np.arange(t + 1, 25)
    left = np.exp(-2 * SPEED * (later - t) / 365) * prices.variance[t]
    deviation = np.sqrt(prices.variance[later] - left)[:, None]
    exact = ndtr((ahead[: 25 - t - 1] - STRIKE) / deviation).mean(axis=0)
    assert np.std(exact) > 0.05
    assert np.sqrt(np.mean((volume - exact) ** 2)) < 0.025


def test_a_product_with_a_name_of_its_own_hedges_its_days():
    """A file of products: family `others`."""
    prices, forward = one_factor(), forward_curve()
    fit, paths = options(4096, 1, prices, forward), options(4096, 2, prices, forward)
    days = tuple(datetime.date(2026, 3, 10) + datetime.timedelta(n) for n in range(SHORT))
    product = TradedProduct("late", days[20], days[39], last_trading=days[19])
    overnight = Overnight(TradedProducts(days, days[0], (product,), balance=None))
    (gains,) = DailyHedges(overnight, [DailyHedge(DELTAS, ("others",))]).simulated(fit, paths)
    late = np.sum(paths.sold[20:] * (paths.curves.spots[20:] - STRIKE), axis=0)
    early = paths.money - late
    assert np.var(late + gains["others"].gain) < np.var(late)
    assert np.var(early) > 0


def test_certain_volumes_are_hedged_without_a_remainder():
    """Flows that no price changes, with discounting: any complete set of products leaves nothing."""
    prices, forward, count = one_factor(), forward_curve(), 64
    days = tuple(datetime.date(2026, 3, 10) + datetime.timedelta(n) for n in range(SHORT))
    discount = np.exp(-0.05 * np.arange(SHORT + 1))
    march = np.arange(SHORT) < 22
    volumes = np.append(np.where(march, -2.0, 3.0), 0.0)
    states = drawn_states(prices, count, 5)
    sold = np.repeat(volumes[:, None], count, axis=1)
    levels = 50 - np.cumsum(np.concatenate([np.zeros((1, count)), sold[:-1]]), axis=0)
    spots = PathCurves(prices, forward, states).spots
    money = np.einsum("t,tn,tn->n", discount, sold, spots)
    paths = StorePaths(prices, forward, discount, states, levels, sold, money)
    np.testing.assert_allclose(paths.volumes, volumes * spots.mean(axis=1) / forward, rtol=1e-12)
    exact = float(np.sum(discount * volumes * forward))
    overnight = Overnight(usual_products(days, days[0]))
    for rows in (by_day(SHORT, 0), overnight.to_delivery()):
        total = money + gained(static(paths, rows, volumes, 0))
        np.testing.assert_allclose(total, exact, rtol=1e-12)
    hedges = [
        DailyHedge(DELTAS, DAY_AHEAD + BALANCE + MONTHS),
        DailyHedge(DELTAS, BALANCE + MONTHS),
    ]
    many = options(4096, 1, prices, forward)
    fit = StorePaths(
        prices, forward, discount, many.states, np.full((SHORT + 1, 4096), 50.0),
        np.repeat(volumes[:, None], 4096, axis=1), np.zeros(4096),
    )  # fmt: skip
    for gains in DailyHedges(overnight, hedges).simulated(fit, paths):
        assert np.std(money + gained(gains)) < 0.01 * np.std(money)
