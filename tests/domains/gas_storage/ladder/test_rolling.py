"""Rolling intrinsic against D6 of the desk's reference cases, G1 and G6, and its own order."""

import datetime
import time

import numpy as np
import pytest
from tests.domains.gas_storage.ladder.monthly import (
    FORWARD,
    factors,
    mean,
    months,
    paired,
    path_curves,
    rolled,
    schedule,
)
from tests.domains.gas_storage.storage_cases import bare, read

from snapo.domains.gas_storage.bounds.relaxation import Hindsight
from snapo.domains.gas_storage.contract.schedule import of_prices
from snapo.domains.gas_storage.ladder.forwards import PathCurves, drawn_states
from snapo.domains.gas_storage.ladder.products import TradedProducts, usual_products
from snapo.domains.gas_storage.ladder.rolling import (
    Chains,
    Infeasible,
    TradeBlock,
    intrinsic_in,
    rolling,
)
from snapo.domains.gas_storage.ladder.store import FlatStore
from snapo.domains.gas_storage.references.intrinsic import intrinsic
from snapo.domains.gas_storage.references.lattice import refined

SPREADS = (0.0, 0.25, 0.60)


@pytest.mark.parametrize(("spread", "value"), [(0.0, 15.8), (0.25, 14.3), (0.6, 12.2)])
def test_the_best_plan_in_month_forwards(spread, value):
    """D6, exact."""
    store = FlatStore(schedule(), "linear")
    assert intrinsic_in(store, months(spread)(0), FORWARD) == pytest.approx(value, abs=1e-9)


@pytest.mark.parametrize(
    ("spread", "value", "error"),
    [(0.0, 16.8727, 0.0002), (0.25, 14.904, 0.001), (0.60, 12.5386, 0.001)],
)
def test_rolling_intrinsic_on_a_few_paths(spread, value, error):
    """D6; a trade that forgets the spread of the unwound forward is 0.2 and more too high."""
    ours, sampling = mean(rolled(spread, 4000, 1))
    assert abs(ours - value) < 3 * np.hypot(sampling, error)
    assert sampling < 0.03


@pytest.mark.prove
@pytest.mark.parametrize(
    ("spread", "value", "error"),
    [(0.0, 16.8727, 0.0002), (0.25, 14.904, 0.001), (0.60, 12.5386, 0.001)],
)
def test_rolling_intrinsic(spread, value, error):
    """D6, its errors below 0.005."""
    ours, sampling = mean(rolled(spread, 100_000, 1))
    assert abs(ours - value) < 3 * np.hypot(sampling, error)
    assert sampling < 0.005


@pytest.mark.parametrize(
    ("spread", "value", "error"),
    [(0.0, 16.8766, 3e-4), (0.25, 15.2834, 2e-4), (0.6, 13.1315, 3e-4)],
)
def test_the_best_policy_of_the_month_forwards(spread, value, error):
    """D6: it trades each month when delivered, at a cost of the half spread."""
    ours, moved = refined(schedule(spread), factors(), "linear")
    assert abs(ours - value) < 3 * np.hypot(moved, error)
    assert moved < 0.005


@pytest.mark.prove
@pytest.mark.parametrize(("spread", "value"), [(0.0, 22.111), (0.25, 20.494), (0.6, 18.369)])
def test_perfect_foresight_of_the_month_forwards(spread, value):
    """D6, known to 0.006; squares of the prices, whose mean is known, take most of the variance."""
    inner, parts, controls = Hindsight(schedule(spread), "linear", None, 4), [], []
    for seed in range(8):
        curves = path_curves(100_000, seed)
        parts.append(paired(inner.best(curves.spots, curves.states)))
        squares = (curves.spots / FORWARD[:, None]) ** 2 - np.exp(factors().variance[:, None])
        controls += [np.array([paired(square) for square in squares[1:-1]])]
    money, known = np.concatenate(parts), np.concatenate(controls, axis=1)
    design = np.vstack([np.ones(len(money)), known])
    fit = np.linalg.lstsq(design.T, money, rcond=None)[0]
    ours, sampling = mean(money - fit[1:] @ known)
    assert abs(ours - value) < 3 * np.hypot(sampling, 0.006)
    assert sampling < 0.005


def test_a_path_never_earns_less_than_the_plan_of_today():
    """Trades are made only where they gain, also after the spread."""
    for spread in SPREADS:
        store, curves = FlatStore(schedule(), "linear"), path_curves(500, 3)
        money = rolling(Chains(store), months(spread), curves, 500).money
        assert np.min(money) >= intrinsic_in(store, months(spread)(0), FORWARD) - 1e-9


def test_curves_on_paths_are_martingales():
    """The expected forward price is today's, the first one on a day its spot price."""
    curves = path_curves(200_000, 5)
    for t in (1, 4, 7):
        prices = curves(t)
        np.testing.assert_allclose(prices.mean(axis=1), FORWARD[t:], rtol=2e-3)
        np.testing.assert_allclose(prices[0], curves.spots[t], rtol=1e-12)


def test_positions_are_multiples_of_a_lot():
    """Whole units are best anyway; a lot larger than any flow leaves all to the spot market, where
    nothing is unwound, and the value is that of a policy."""
    store, curves = FlatStore(schedule(), "linear"), path_curves(2000, 7)

    def of(lot: float):
        def blocks(t):
            return tuple(block._replace(lot=lot) for block in months(0.25)(t))

        return rolling(Chains(store), blocks, curves, 2000)

    free, whole, none = of(0.0), of(1.0), of(3.0)
    np.testing.assert_allclose(whole.money, free.money, rtol=0, atol=1e-9)
    assert np.max(none.traded) <= 8.0 + 1e-9 < np.max(free.traded)
    value, sampling = mean(paired(none.money))
    assert value < 15.2834 + 3 * sampling


def test_a_product_that_does_not_trade_yet_is_only_planned():
    """With nothing but the spot market no position is held, and no spread is paid before."""
    store, curves = FlatStore(schedule(), "linear"), path_curves(50, 7)

    def blocks(t):
        first, *later = months(0.0)(t)
        return (first, *(block._replace(trades=False) for block in later))

    rolled_up = rolling(Chains(store), blocks, curves, 50)
    assert np.max(rolled_up.traded) <= 8.0  # a unit a month, and nothing twice


def store_of(name: str):
    """A store, its curve with the price of the end, its factors and what trades."""
    case = read(name)
    simulator, _, plain = bare(case)
    numbers = np.append(plain.steps.forward, plain.constants.end_forward)
    kind = case.contract.ratchets.interpolation
    store, prices = FlatStore(plain, kind), simulator.process.factors(of_prices(plain))
    return store, numbers, prices, usual_products(case.days, case.valuation_date), plain, kind


@pytest.mark.parametrize("name", ["G1", "G2", "G6"])
def test_the_plan_in_days_is_the_intrinsic_value(name):
    """Days as products are no restriction; nodes of the level cost little with ratchets."""
    store, curve, _, _, plain, kind = store_of(name)
    days = tuple(TradeBlock(t, t + 1) for t in range(store.horizon))
    assert intrinsic_in(store, days, curve) == pytest.approx(intrinsic(plain, kind).value, rel=2e-4)


@pytest.mark.parametrize(("name", "value"), [("G6", 306.20), ("G1", 40_761.0)])
def test_the_plan_in_months(name, value):
    """G6 loses nothing by flat months; G1, whose rates depend on the inventory, half a percent."""
    store, curve, _, products, *_ = store_of(name)
    assert intrinsic_in(store, products.blocks(0), curve) == pytest.approx(value, rel=1e-4)


@pytest.mark.prove
def test_slow_storage_rolled():
    """G6: above the intrinsic value, below the exact one."""
    store, curve, prices, products, *_ = store_of("G6")
    curves = PathCurves(prices, curve, drawn_states(prices, 64, 1))
    value, sampling = mean(paired(rolling(Chains(store), products.blocks, curves, 64).money))
    assert 306.20 + 3 * sampling < value < 656.15 - 3 * sampling


@pytest.mark.prove
def test_a_thousand_paths_with_ratchets_are_rolled_in_two_minutes():
    """G1: in processor time, of 32 paths; between the plan of today and the exact value."""
    store, curve, prices, products, *_ = store_of("G1")
    curves, chains = PathCurves(prices, curve, drawn_states(prices, 32, 2)), Chains(store)
    began = time.process_time()
    for t in range(store.horizon):
        chains.of(products.blocks(t))
    made = time.process_time()
    value, sampling = mean(paired(rolling(chains, products.blocks, curves, 32).money))
    ended = time.process_time()
    assert made - began + (ended - made) * 1000 / 32 < 240  # two cores
    assert 40_761 + 3 * sampling < value < 78_370 + 3 * sampling


def test_a_contract_that_flat_volumes_cannot_meet_has_a_reason():
    """Empty after two months and full after four: no flat volume of four months does that."""
    plain = schedule()
    plain.steps.next_high[1], plain.steps.next_low[3] = 0.0, 2.0
    chains = Chains(FlatStore(plain, "linear"))
    with pytest.raises(Infeasible, match="no volumes that are equal"):
        chains.of((TradeBlock(0, 4), TradeBlock(4, 8)))


def test_before_the_first_delivery_the_plan_of_today_is_traded():
    """A store valued earlier: rolling starts from the plan of the valuation date."""
    contract = {"end": datetime.date(2009, 7, 1), "max_inventory": 20.0}
    case = read("G6", contract=contract, market={"valuation_date": datetime.date(2009, 3, 1)})
    simulator, _, plain = bare(case)
    prices = simulator.process.factors(of_prices(plain))
    products = usual_products(case.days, case.valuation_date)
    assert isinstance(products, TradedProducts) and products.before
    store = FlatStore(plain, "linear")
    curve = np.append(plain.steps.forward, plain.constants.end_forward)
    curves = PathCurves(prices, curve, drawn_states(prices, 4, 1))
    money = rolling(Chains(store, 26), products.blocks, curves, 4, before=True).money
    assert np.min(money) >= intrinsic_in(store, products.blocks(-1), curve) - 1e-6


def test_curves_of_normal_prices():
    """D2: each path's first price is its spot price, the mean of the others today's curve."""
    case = read("D2")
    simulator, _, plain = bare(case)
    prices = simulator.process.factors(of_prices(plain))
    assert prices.additive
    curve = np.append(plain.steps.forward, plain.constants.end_forward)
    curves = PathCurves(prices, curve, drawn_states(prices, 20_000, 1))
    np.testing.assert_allclose(curves(100)[0], curves.spots[100], rtol=1e-12)
    np.testing.assert_allclose(curves(100).mean(axis=1), curve[100:], atol=1e-9)  # antithetic
    assert curves.spots.min() < 0 and 9.0 < curves.spots[200].std() < 9.1
