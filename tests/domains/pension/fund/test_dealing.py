"""Limits of trading: bands, sales of illiquid classes, turnover; and the present mix, held."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.market_cases import full

from snapo.domains.pension.fund.observation import slots
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.fund.terms import trading_limits
from snapo.domains.pension.fund.trading import dealt
from snapo.domains.pension.policies.classical import PresentMix, present_mixes
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.objective import Mean
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact, Smooth

CASE = full(3)
COUNT = len(CASE.assets.classes)
CASH = CASE.assets.cash
NOW = np.full(COUNT, 1 / COUNT)


def limited(**limits):
    return replace(CASE.assets, **limits)


def column(default, **values):
    found = np.full(COUNT, default)
    for place, value in values.items():
        found[int(place[1:])] = value
    return found


def traded(assets, wanted, step=1.0, smooth=None):
    with jax.enable_x64(True):
        return np.asarray(
            dealt(
                CASH,
                trading_limits(assets, step),
                jnp.asarray(wanted),
                jnp.asarray(NOW),
                smooth or Exact(),
            )
        )


def sold(place, to):
    """All that one class gives up, to another."""
    wanted = NOW.copy()
    wanted[place], wanted[to] = 0.0, NOW[to] + NOW[place]
    return wanted


OTHERS = [i for i in range(COUNT) if i != CASH]
FIRST, SECOND = OTHERS[:2]


def test_without_a_limit_that_binds_the_wanted_weights_are_held():
    wanted = sold(FIRST, SECOND)
    free = limited(max_sale=column(1.0), band=column(0.0), turnover=5.0)
    assert traded(free, wanted) == pytest.approx(wanted, abs=1e-15)


def test_an_illiquid_class_is_not_sold_and_purchases_are_cut_to_the_cash():
    assets = limited(max_sale=column(np.inf, **{f"i{FIRST}": 0.0}))
    assert traded(assets, sold(FIRST, SECOND)) == pytest.approx(NOW, abs=1e-15)
    # It may be bought.
    assert traded(assets, sold(SECOND, FIRST)) == pytest.approx(sold(SECOND, FIRST), abs=1e-15)


def test_no_more_than_the_share_of_a_year_is_sold():
    assets = limited(max_sale=column(np.inf, **{f"i{FIRST}": 0.3}))
    found = traded(assets, sold(FIRST, SECOND), 1 / 12)
    assert found[FIRST] == pytest.approx(NOW[FIRST] * (1 - 0.3 / 12))
    assert found.sum() == pytest.approx(1.0, abs=1e-15)
    assert found[CASH] == pytest.approx(NOW[CASH])


def test_turnover_shrinks_all_trades_alike():
    wanted = np.eye(COUNT)[FIRST]
    found = traded(limited(turnover=0.12), wanted, 1 / 12)
    assert np.abs(found - NOW).sum() / 2 == pytest.approx(0.01)
    assert (found - NOW) / (wanted - NOW) == pytest.approx(0.01 / np.abs(wanted - NOW).sum() * 2)


def test_within_a_band_nothing_is_traded():
    wanted = NOW + 0.02 * (np.eye(COUNT)[FIRST] - np.eye(COUNT)[SECOND])
    band = column(0.0, **{f"i{i}": 0.03 for i in OTHERS})
    assert traded(limited(band=band), wanted) == pytest.approx(NOW, abs=1e-15)
    assert traded(limited(band=band / 2), wanted) == pytest.approx(wanted, abs=1e-15)


def test_smooth_trades_are_near_the_exact_ones_and_add_up():
    every = limited(
        max_sale=column(np.inf, **{f"i{FIRST}": 0.3}), band=column(0.01, **{f"i{CASH}": 0.0})
    )
    for wanted in (sold(FIRST, SECOND), sold(SECOND, FIRST), np.eye(COUNT)[SECOND]):
        found = traded(every, wanted, smooth=Smooth(0.01))
        assert found == pytest.approx(traded(every, wanted), abs=1e-4)
        assert found.sum() == pytest.approx(1.0, abs=1e-14)


@pytest.mark.prove
def test_the_present_mix_rebalanced_yearly_drifts_in_between_on_both_engines():
    """At each year's end it goes back to today's weights; a fund with limits rolls alike on both."""
    one = replace(CASE, overlay=None, observation=("time", "weights"), steps=CASE.steps)
    assert set(present_mixes(one)) == {"present_mix"} | (
        {"present_mix_yearly"} if one.step < 1 else set()
    )
    policy = PresentMix(one, 2)
    seen = np.zeros(1 + COUNT)
    seen[slots(one)["weights"]] = drifted = np.random.default_rng(1).dirichlet(np.ones(COUNT))
    for step in range(one.steps):
        seen[0] = 2 * step / one.steps - 1
        with jax.enable_x64(True):
            found = np.asarray(policy(jnp.asarray(seen), Exact()))
        want = drifted if step % 2 else one.assets.weight.used()
        assert found == pytest.approx(want, abs=1e-7)
    illiquid = limited(max_sale=column(np.inf, **{f"i{FIRST}": 0.1}), turnover=0.5)
    fund = replace(one, assets=illiquid)
    simulator = PensionSimulator.of(fund)
    problem = Problem(simulator, pension_inputs(fund), Mean("funding_ratio"))
    draws = Pseudo(seed=1).draws(np.arange(16), simulator)
    totals = [
        engine.bind(problem).values(policy, draws, Exact()).totals["funding_ratio"]
        for engine in (Xla(precision="float64"), Native(precision="float64"))
    ]
    assert np.asarray(totals[0]) == pytest.approx(np.asarray(totals[1]), rel=1e-11)


@pytest.mark.prove
@pytest.mark.parametrize("wide", [False, True])
def test_within_the_bands_derivatives_are_finite_while_training(wide):
    """Trades then fade like exp(-band / width): purchases of 1e-30 and less are shared out."""
    assets = limited(band=column(0.005, **{f"i{CASH}": 0.0}))
    wanted = NOW + 10.0 ** -np.linspace(2, 6, 50)[:, None] * np.cos(np.arange(COUNT) * 2.3)
    wanted[:, CASH] += 1 - wanted.sum(1)
    with jax.enable_x64(wide):
        size = jnp.float64 if wide else jnp.float32

        def weighted(wanted, now, warm):
            found = dealt(assets.cash, trading_limits(assets, 1 / 12), wanted, now, Smooth(warm))
            return found @ jnp.arange(COUNT, dtype=size)

        slopes = jax.jit(jax.vmap(jax.grad(weighted, (0, 1)), (0, None, None)))
        for warm in (0.02, 0.005, 0.001):
            found = slopes(jnp.asarray(wanted, size), jnp.asarray(NOW, size), size(warm))
            assert all(np.isfinite(each).all() for each in found)
