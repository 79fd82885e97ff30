"""Weights outside of [0, 1]: the map from numbers to weights, and the rules that use it."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.domains.pension.market_cases import CASH, EQUITY, assets, case
from tests.domains.pension.market_cases import given as given_

from snapo.domains.pension.fund.observation import FEATURES
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.fund.terms import trading_limits
from snapo.domains.pension.fund.trading import excess
from snapo.domains.pension.market.assets.bond import Bond
from snapo.domains.pension.policies.allocation import AllocationLimits, new_policy
from snapo.domains.pension.policies.classical import ConstantMix, PresentMix, followers
from snapo.domains.pension.records.assets import AssetGroup, Overlay
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.problem.problem import prepare
from snapo.problem.smooth import Exact, Smooth

pytestmark = pytest.mark.prove
NAMES = ("time", "funding_ratio", "weights")
FOUR = st.lists(st.floats(0, 1), min_size=4, max_size=4)
NUMBERS = st.lists(st.floats(-60, 60), min_size=4, max_size=4)
CLASSES = [CASH, EQUITY, Bond("Bonds", maturity=120), Bond("Long bonds", maturity=240)]


def fund(weight, low, high, groups=(), steps=24):
    """Cash, shares and two kinds of bonds between these bounds."""
    held = assets(
        steps, CLASSES, mean=[0.04], volatility=[0.18], weight=weight, high=high, groups=groups
    )
    held = replace(held, low=np.asarray(low, float))
    return replace(case(steps, held_assets=held), observation=NAMES)


LEVERED = fund([-0.4, 0.2, 0.9, 0.3], [-0.5, 0.0, 0.3, -0.1], [0.2, 0.4, 1.4, 0.8])
BORROWED = fund([-0.3, 1.2, 0.1, 0.0], [-0.5, 0.0, 0.0, 0.0], [0.2, 1.5, 0.4, 0.4])


exactly = jax.jit(Exact().simplex)
smoothly = jax.jit(lambda *given: Smooth(jnp.asarray(0.3)).simplex(*given))


def limits_of(low, high, groups=()) -> AllocationLimits:
    return AllocationLimits(fund([1.0, 0.0, 0.0, 0.0], low, high, groups))


def drawn(low, width, place):
    """Bounds whose sums stand on either side of 1, and weights between them."""
    low = 1.5 * np.array(low) - 1.0
    low -= max(0.0, low.sum() - 0.9) / 4
    high = low + 0.05 + 1.5 * np.array(width)
    high += max(0.0, 1.1 - high.sum()) / 4
    inside = low + (0.02 + 0.96 * np.array(place)) * (high - low)
    # Towards an end of all ranges until the sum is 1: every class stays inside.
    end = high if inside.sum() < 1 else low
    share = (1 - inside.sum()) / (end.sum() - inside.sum()) if inside.sum() != 1 else 0.0
    return low, high, inside + share * (end - inside)


@settings(max_examples=80, deadline=None)
@given(FOUR, FOUR, FOUR, NUMBERS)
def test_any_numbers_become_weights_within_the_bounds(low, width, place, numbers):
    low, high, _ = drawn(low, width, place)
    with jax.enable_x64(True):
        given = [np.asarray(each) for each in (numbers, low, high)]
        found, softly = np.asarray(exactly(*given)), np.asarray(smoothly(*given))
    assert np.all(found >= low - 1e-12) and np.all(found <= high + 1e-12)
    assert found.sum() == pytest.approx(1, abs=1e-10)
    # Smooth by itself: nothing is rounded.
    assert softly.tolist() == found.tolist()


@settings(max_examples=80, deadline=None)
@given(FOUR, FOUR, FOUR)
def test_every_mix_inside_the_bounds_is_reached(low, width, place):
    low, high, mix = drawn(low, width, place)
    part = (mix - low) / (high - low)
    if part.min() < 1e-6 or part.max() > 1 - 1e-6:
        return
    with jax.enable_x64(True):
        logits = jnp.asarray(np.log(part / (1 - part)))
        found = exactly(logits + 7.0, low, high)
    np.testing.assert_allclose(found, mix, atol=1e-9)


def test_groups_of_short_classes_are_reached_too():
    groups = (AssetGroup("bonds", (2, 3), 0.5, 1.5),)
    limits = limits_of([-0.6, 0.0, 0.2, -0.3], [0.4, 0.5, 1.4, 0.9], groups)
    with jax.enable_x64(True):
        nearest = jax.jit(lambda mix: limits.nearest(mix, Exact()))
        for mix in ([-0.5, 0.2, 1.2, 0.1], [0.3, 0.1, 0.8, -0.2], [-0.2, 0.3, 0.25, 0.65]):
            found = nearest(jnp.asarray(mix))
            np.testing.assert_allclose(found, mix, atol=1e-9)


def test_the_map_has_the_slopes_of_central_differences():
    limits = limits_of(
        [-0.5, 0.0, 0.3, -0.1], [0.2, 0.4, 1.4, 0.8], (AssetGroup("b", (2, 3), 0.6, 1.3),)
    )
    with jax.enable_x64(True):
        at, h = jnp.asarray([0.3, -1.1, 0.8, -0.4]), 1e-5
        map_ = jax.jit(lambda x: limits.weights(x, Exact()))
        slopes = np.asarray(jax.jit(jax.jacrev(map_))(at))
        for k in range(4):
            step = h * np.eye(4)[k]
            central = (np.asarray(map_(at + step)) - np.asarray(map_(at - step))) / (2 * h)
            np.testing.assert_allclose(slopes[:, k], central, atol=1e-10)
    assert np.abs(slopes.sum(0)).max() < 1e-12


def test_the_lower_limits_alone_are_the_shifted_softmax():
    """w = low + (1 - sum of low) p, p the softmax, in the limit of upper bounds far away."""
    low, logits = np.array([-0.4, 0.0, 0.1, -0.2]), np.array([0.2, -0.5, 1.0, 0.3])
    limits = limits_of(low, np.full(4, 1e7))
    with jax.enable_x64(True):
        found = np.asarray(jax.jit(lambda x: limits.weights(x, Exact()))(logits))
    share = np.exp(logits) / np.exp(logits).sum()
    np.testing.assert_allclose(found, low + (1 - low.sum()) * share, atol=1e-6)


@pytest.mark.parametrize("one", [LEVERED, BORROWED], ids=["bonds", "shares"])
def test_all_rules_start_at_the_levered_mix_and_stay_within_its_bounds(one):
    simulator = PensionSimulator.of(one)
    schedule = prepare(simulator, pension_inputs(one))
    mix = ConstantMix(one, one.assets.weight.used())
    rules = {"network": new_policy(one, simulator, schedule, jax.random.key(0)), "mix": mix}
    rules |= {key: rule for key, (_, rule) in followers(one, mix, (0.9, 1.3)).items()}
    assert set(rules) == {"network", "mix", "glide_path", "liability_driven"}
    size, rng = sum(FEATURES[name].size(one) for name in NAMES), np.random.default_rng(0)
    least, most = simulator.action.bounds()
    limits = trading_limits(one.assets, one.step)
    beyond = jax.jit(lambda action: excess(one.assets, limits, action))
    for name, rule in rules.items():
        decide = eqx.filter_jit(rule)
        held = np.asarray(decide(jnp.zeros(size), Exact()))
        assert held == pytest.approx(one.assets.weight.used(), abs=0.03), name
        for smooth in (Exact(), Smooth(jnp.asarray(0.2))):
            seen = jnp.asarray(2 * rng.standard_normal(size))
            action = np.asarray(decide(seen, smooth))
            assert np.all(action >= least) and np.all(action <= most)
            assert float(beyond(action)) < 1e-6
            assert action.sum() == pytest.approx(1, abs=1e-6)
    held = PresentMix(one, 1)(jnp.zeros(size), Exact())
    assert np.asarray(held).tolist() == pytest.approx(one.assets.weight.used().tolist())


def test_borrowed_cash_backs_no_swaps():
    """Shares on borrowed cash leave no collateral: notionals are zero, and slopes finite."""
    swap = Overlay(
        maturities=np.array([240]), notional=given_("overlay_notional", [0.0]), low=np.zeros(1),
        high=np.array([2.0]), unit="assets", leverage=given_("overlay_leverage", 2.0),
        cost=given_("overlay_cost", [0.0]),
        collateral_stress=given_("overlay_collateral_stress", 0.035),
    )  # fmt: skip
    limits = AllocationLimits(replace(BORROWED, overlay=swap))
    action = eqx.filter_jit(limits.action)
    with jax.enable_x64(True):
        weights, logit = jnp.asarray([-0.3, 1.3, 0.0, 0.0]), jnp.asarray([0.5])
        assert action(weights, logit, Exact())[4] == 0
        slopes = jax.jit(jax.jacrev(action))(weights, logit, Smooth(jnp.asarray(0.3)))
    assert np.isfinite(slopes).all()
