"""Classical policies and the network's head: feasible, trainable, and right where that is known."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.market_cases import CASH, EQUITY, assets, case, full, given
from tests.domains.pension.policies.closed_forms import StockBond, merton, vasicek_stock_bond

from snapo.domains.pension.fund.observation import FEATURES, slots
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.fund.terms import trading_limits
from snapo.domains.pension.fund.trading import excess
from snapo.domains.pension.market.assets.bond import Bond
from snapo.domains.pension.policies.allocation import AllocationLimits, new_policy
from snapo.domains.pension.policies.classical import ConstantMix, followers
from snapo.domains.pension.records.assets import Overlay
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.engine.native import unsupported
from snapo.problem.policy import parameters
from snapo.problem.problem import prepare
from snapo.problem.smooth import Exact, Smooth


@pytest.fixture(scope="module")
def problem():
    one = full()
    simulator = PensionSimulator.of(one)
    schedule = prepare(simulator, pension_inputs(one))
    policies = {"network": new_policy(one, simulator, schedule, jax.random.key(0))}
    policies["constant_mix"] = mix = ConstantMix(one)
    policies |= {key: policy for key, (_, policy) in followers(one, mix, (0.9, 1.3)).items()}
    return one, simulator, schedule, policies


def beyond_limits(one):
    """By how much weights leave the limits of a case, compiled."""
    limits = trading_limits(one.assets, one.step)
    return jax.jit(lambda weights: excess(one.assets, limits, weights))


@pytest.mark.prove
def test_all_classical_policies_are_there(problem):
    assert set(problem[3]) == {"network", "constant_mix", "glide_path", "liability_driven"}


@pytest.mark.prove
@pytest.mark.parametrize("key", ["network", "constant_mix", "glide_path", "liability_driven"])
def test_every_policy_keeps_the_limits_and_can_be_compiled(problem, key):
    one, simulator, schedule, policies = problem
    policy = policies[key]
    assert unsupported(simulator, schedule, policy, Exact()) is None
    assert parameters(policy).size > 0
    count, rng = len(one.assets.classes), np.random.default_rng(0)
    size = sum(FEATURES[name].size(one) for name in one.observation)
    decide, beyond = eqx.filter_jit(policy), beyond_limits(one)
    for smooth in (Exact(), Smooth(jnp.asarray(0.2))):
        for _ in range(3):
            action = np.asarray(decide(jnp.asarray(2 * rng.standard_normal(size)), smooth))
            assert action.shape == (count + 2,)
            assert action.min() >= 0 and action.max() <= 1
            assert beyond(action[:count]) < 1e-6
            assert action[:count].sum() == pytest.approx(1, abs=1e-6)


@pytest.mark.prove
def test_policies_start_at_what_the_fund_holds(problem):
    one, _, _, policies = problem
    size = sum(FEATURES[name].size(one) for name in one.observation)
    weight = one.assets.weight.used()
    for policy in policies.values():
        action = np.asarray(eqx.filter_jit(policy)(jnp.zeros(size), Exact()))
        assert action[: len(weight)] == pytest.approx(weight, abs=0.03)


@pytest.mark.prove
def test_weights_within_the_limits_are_their_own_nearest(problem):
    """Sums of groups too; weights that leave the limits are moved inside."""
    one, nearest = problem[0], eqx.filter_jit(AllocationLimits(problem[0]).nearest)
    for within in (one.assets.weight.used(), np.array([0.3, 0.1, 0.05, 0.15, 0.1, 0.2, 0.1])):
        found = np.asarray(nearest(jnp.asarray(within, jnp.float32), Exact()))
        assert found == pytest.approx(within, abs=1e-5)
    outside = jnp.asarray([0.0, 0.9, 0.0, 0.0, 0.1, 0.0, 0.0], jnp.float32)
    assert beyond_limits(one)(nearest(outside, Exact())) < 1e-6


@pytest.mark.prove
def test_swaps_are_held_as_far_as_weights_back_them():
    """100 % of a 20-year zero-coupon swap loses 50.3 % of the assets at 350 bp, of a payment that is
    then worth exp(-0.7); three quarters of them count."""
    steps = 6
    held = assets(steps, [CASH, EQUITY], mean=[0.04], volatility=[0.18], weight=[0.75, 0.25])
    swap = Overlay(
        maturities=np.array([240]), notional=given("overlay_notional", [0.0]), low=np.zeros(1),
        high=np.array([2.0]), unit="assets", leverage=given("overlay_leverage", 2.0),
        cost=given("overlay_cost", [0.0]),
        collateral_stress=given("overlay_collateral_stress", 0.035), zero_coupon=(0,),
    )  # fmt: skip
    lost = 1 - np.exp(-20 * 0.035)
    held_by = eqx.filter_jit(AllocationLimits(case(steps, held_assets=held, overlay=swap)).action)
    weights = jnp.asarray([0.75, 0.25])
    for place, expected in ((0.9, 0.75 / lost / 2), (0.5, 0.5)):
        logit = jnp.log(jnp.asarray([place / (1 - place)]))
        action = np.asarray(held_by(weights, logit, Exact()))
        assert action == pytest.approx([0.75, 0.25, expected], rel=1e-6)


@pytest.mark.prove
def test_the_observation_has_what_the_case_names(problem):
    one, simulator, schedule, _ = problem
    now = jax.tree.map(lambda leaf: leaf[0], schedule.steps)

    @jax.jit
    def observed(constants, now):
        return simulator.observe(constants, now, simulator.initial(constants, None))

    seen = np.asarray(observed(schedule.constants, now))
    place = slots(one)
    assert seen.shape == (max(each.stop for each in place.values()),)
    ratio = float(schedule.constants.assets / schedule.constants.liability)
    assert seen[place["funding_ratio"]] == pytest.approx(np.log(ratio) / 0.2, rel=1e-5)
    assert seen[place["weights"]] == pytest.approx(one.assets.weight.used(), rel=1e-6)
    # The ten-year zero rate of the case's curve, in units of 2 %.
    assert seen[place["long_rate"]] == pytest.approx(0.025 / 0.02, rel=1e-5)


@pytest.mark.prove
def test_mertons_rule_is_the_published_weight():
    assert merton(0.04, 0.18, 5.0) == pytest.approx(0.246913580, abs=1e-9)


@pytest.mark.prove
def test_the_stock_bond_rule_meets_its_limits():
    """Infinite risk aversion holds the horizon's bond alone; no rate risk leaves Merton's stock."""
    numbers = {
        "mean_reversion": 0.15,
        "rate_volatility": 0.01,
        "rate_price": -0.2,
        "excess": 0.04,
        "volatility": 0.18,
        "correlation": 0.0,
        "horizon": 10.0,
        "maturity": 10.0,
    }
    careful = vasicek_stock_bond(risk_aversion=1e9, **numbers)
    assert careful.stock == pytest.approx(0, abs=1e-6)
    assert careful.bond == pytest.approx(1, abs=1e-6)
    usual = vasicek_stock_bond(risk_aversion=5.0, **numbers)
    assert usual.stock == pytest.approx(merton(0.04, 0.18, 5.0))
    reach = (1 - np.exp(-1.5)) / 0.15
    assert usual.bond == pytest.approx(0.2 / (5 * 0.01 * reach) + 0.8)
    # First-order conditions with correlation: covariance times weights is premium / gamma + hedge.
    tied = numbers | {"correlation": 0.3, "maturity": 5.0}
    stock, bond = vasicek_stock_bond(risk_aversion=5.0, **tied)
    on_rate = -0.01 * (1 - np.exp(-0.75)) / 0.15
    spread = np.array([[0.18**2, 0.18 * 0.3 * on_rate], [0.18 * 0.3 * on_rate, on_rate**2]])
    premium = np.array([0.04, -0.2 * on_rate])
    hedge = -0.01 * reach * np.array([0.18 * 0.3, on_rate])
    assert spread @ [stock, bond] == pytest.approx(premium / 5 + 0.8 * hedge)


@pytest.mark.prove
def test_the_stock_bond_policy_follows_its_rule_within_bounds():
    steps = 24
    bond = Bond("Bond", maturity=60)
    held = assets(
        steps, [CASH, EQUITY, bond], mean=[0.04], volatility=[0.18], weight=[0.2, 0.3, 0.5]
    )
    one = replace(case(steps, held_assets=held), observation=("time",))
    policy = eqx.filter_jit(StockBond(one, lambda left: (0.25, 0.3 + 0.1 * left), 1, 2))
    start, end = (np.asarray(policy(jnp.asarray([when]), Exact())) for when in (-1.0, 1.0))
    assert start == pytest.approx([0.25, 0.25, 0.5], abs=1e-3)
    assert end == pytest.approx([0.45, 0.25, 0.3], abs=1e-3)
    fixed = ConstantMix(one, np.array([0.5, 0.2, 0.3]))
    assert np.asarray(eqx.filter_jit(fixed)(jnp.zeros(1), Exact())) == pytest.approx(
        [0.5, 0.2, 0.3], abs=1e-5
    )
