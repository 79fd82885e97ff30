"""A fund of personal pots: its money adds up, and its closed forms."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension import market_cases, people_cases
from tests.domains.pension.market_cases import given
from tests.domains.pension.people_cases import members
from tests.domains.pension.pots_cases import STEPS, fund, pots

from snapo.domains.pension.policies.allocation import limit_unit, notionals
from snapo.domains.pension.pots.simulator import PotSimulator
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.plan import Liability
from snapo.problem.inputs import plain
from snapo.problem.smooth import Exact

pytestmark = pytest.mark.prove
ROUND_OFF = 1e-12 * 8000  # of the assets


def rolled(case, paths=6, actions=None):
    """Every state [T+1, N, …] and output [T, N] on paths with weights drawn at random, or these."""
    simulator: Any = PotSimulator.of(case)
    rng = np.random.default_rng(3)
    inputs = plain(pension_inputs(case))
    with jax.enable_x64(True):
        schedule = eqx.filter_jit(simulator.prepare)(inputs)
        terms, steps = schedule.constants, schedule.steps
        states = [simulator.initial(terms, None)]
        states[0] = jax.tree.map(lambda a: jnp.broadcast_to(a, (paths, *jnp.shape(a))), states[0])
        step = jax.jit(
            jax.vmap(lambda *a: simulator.step(terms, *a, Exact()), in_axes=(None, 0, 0, 0))
        )
        found = []
        for t in range(case.steps):
            now = jax.tree.map(lambda a, t=t: a[t], steps)
            action = rng.dirichlet(np.ones(3), paths)
            if actions is not None:
                action = np.broadcast_to(actions, (paths, len(actions)))
            noise = rng.normal(size=(paths, simulator.noise_size))
            state, outputs = step(now, states[-1], action, noise)
            states.append(state)
            found.append(outputs)
        stack = jax.tree.map(lambda *each: np.stack(each), *states)
        return stack, jax.tree.map(lambda *each: np.stack(each), *found), (terms, steps)


@pytest.fixture(scope="module")
def usual():
    protection, exposure = [0.2, 0.6, 0.4, 0.9, 1.0], [1.5, 1.0, 1.2, 0.5, 0.3]
    case = fund()
    case = replace(case, pots=pots(case, protection, exposure))
    return case, *rolled(case)


def test_pots_and_reserve_are_the_assets_at_every_step(usual):
    _, states, _, _ = usual
    total = states.pots.sum(-1) + states.reserve
    assert total == pytest.approx(states.fund.assets, rel=1e-12)
    assert total[0] == pytest.approx(np.full(6, 8000.0))


def test_the_reserve_keeps_the_law(usual):
    """Never negative; at the ends of years no more than 15 % of all assets."""
    _, states, outputs, _ = usual
    share = states.reserve / states.fund.assets
    assert share.min() >= 0
    assert share[12::12].max() <= 0.15 + 1e-12
    assert share[0] == pytest.approx(np.full(6, 0.1))
    ends = np.zeros(STEPS, bool)
    ends[11::12] = True
    assert not outputs["filled"][~ends].any()
    assert not outputs["released"][~ends].any()
    assert (outputs["filled"][ends] != 0).any()
    assert (outputs["released"][ends] > 0).any()
    # At most a fifth of the reserve a year.
    assert np.all(outputs["released"][ends] <= 0.2 / 0.8 * states.reserve[12::12] * (1 + 1e-12))


def test_pensions_fall_only_where_a_year_has_taken_its_share_of_the_reserve():
    """The rule of funds that publish theirs, see `test_published.py`: a year takes a fifth of the
    reserve at most, and no more than brings pensions up to the level of the year before."""
    case = fund()
    case = replace(case, pots=pots(case, [0.2] * 5, [1.0] * 5, reserve=0.02))
    states, outputs, (_, steps) = rolled(case, 40)
    ends = np.arange(11, case.steps, 12)
    fallen = np.log(states.level[ends + 1] / states.level[ends]) < -1e-9
    fallen = (fallen & (np.asarray(steps.drawing)[ends, None] > 0)).any(-1)
    released = outputs["released"][ends]
    whole = released >= 0.2 * (states.reserve[ends + 1] + released) * (1 - 1e-9)
    assert np.array_equal(fallen, whole & (released > 0))
    assert fallen.any() and ((released > 0) & ~fallen).any()


def test_pensions_are_pots_over_annuities_and_stand_for_a_year(usual):
    _, states, outputs, (_, steps) = usual
    level = states.level
    assert np.array_equal(level[1], level[0])
    assert np.array_equal(level[11], level[0])
    assert not np.array_equal(level[12], level[0])
    paid = (level[:-1] * np.asarray(steps.benefit)[:, None, :]).sum(-1)
    assert outputs["benefit"] == pytest.approx(paid)


def test_a_fully_protected_cohort_without_excess_return_keeps_its_pension():
    """Whatever rates and shares do: the closed form of protection; the others bear all the rest."""
    case = fund(plan=market_cases.plan("arrears"))
    case = replace(case, pots=pots(case, [0.0, 0.0, 0.0, 1.0, 1.0], [1, 1, 1, 0, 0], reserve=0.0))
    states, outputs, _ = rolled(case)
    kept = states.level[:, :, 3:]
    assert kept == pytest.approx(np.broadcast_to(kept[0], kept.shape), rel=1e-12)
    assert states.level[-1, :, 0].std() > 0.01
    assert outputs["cut"].max() < 1e-12


@pytest.mark.parametrize(("added", "annual"), [(0.0, False), (0.01, False), (0.01, True)])
@pytest.mark.parametrize("timing", ["advance", "arrears"])
def test_without_risk_every_pot_and_the_reserve_earn_cash(timing, added, annual):
    """No volatility and no costs: whatever the fund holds and whatever its rules are, no one's return
    goes to anyone else; pensions stand still, but where the projected return is above the curve."""
    case = quiet(timing)
    if added:
        rate = given("liability_rate", added)
        case = replace(case, liability=Liability("spread", rate, "none", annual))
    states, outputs, (_, steps) = rolled(case, paths=3)
    assert np.ptp(np.diff(states.fund.market.log_discount[:, 0])) > 1e-4
    of_pots, of_reserve = beyond_cash(states, steps, timing)
    assert np.abs(of_pots).max() < ROUND_OFF
    assert np.abs(of_reserve).max() < ROUND_OFF
    assert np.abs(states.gained).max() < ROUND_OFF
    assert np.abs(outputs["filled"]).max() < ROUND_OFF
    if not added:
        assert np.ptp(states.level) < 1e-12 * states.level[0, 0, 0]


def test_no_market_value_is_moved_beforehand():
    """DNB's words, see `sharing`: under the pricing measure no pot and no reserve is expected to earn
    more than cash, with rates and shares at random and whatever the protections and exposures are. The
    volatilities are small, so that 4096 paths tell 0.2 % of a pot."""
    case = replace(quiet("arrears", rate=0.002, equity=0.03), measure="Q")
    states, _, (_, steps) = rolled(case, paths=4096)
    of_pots, of_reserve = beyond_cash(states, steps, "arrears")
    discount = np.exp(states.fund.market.log_discount[1:])
    worth = np.concatenate([of_pots, of_reserve[..., None]], -1) * discount[..., None]
    worth = worth.sum(0)  # over time, of each path
    error = worth.std(0) / np.sqrt(len(worth))
    assert np.all(error < 7e-4 * np.append(states.pots[0, 0], states.reserve[0, 0]))
    assert np.all(np.abs(worth.mean(0)) < 3 * error)


def beyond_cash(states, steps, timing):
    """Of each pot [T, N, C] and the reserve [T, N], the money that it earned beyond cash."""
    growth = np.exp(-np.diff(states.fund.market.log_discount, axis=0))
    paid = states.level[:-1] * np.asarray(steps.benefit)[:, None, :]
    before, after = (0.0, paid) if timing == "arrears" else (paid, 0.0)
    of_pots = states.pots[1:] + after - (states.pots[:-1] - before) * growth[..., None]
    return of_pots, states.reserve[1:] - states.reserve[:-1] * growth


def quiet(timing, rate=0.0, equity=0.0):
    """A fund without costs, contributions, expenses or filling of its reserve, by default in a market
    without risk, whose curve rises."""
    case = fund(rate=rate, equity=equity, plan=market_cases.plan(timing))
    assets = replace(
        case.assets, mean=given("asset_mean", [0.0]), cost=market_cases.none("asset_cost", 3)
    )
    tenor, zero = [1.0, 2.0, 5.0, 10.0, 20.0, 30.0], [0.01, 0.015, 0.02, 0.025, 0.027, 0.026]
    case = replace(case, assets=assets, curve=market_cases.curve("zero_rate", tenor, zero))
    none = {"fill_contribution": 0.0, "fill_return": 0.0, "release": 0.0, "reserve": 0.05}
    return replace(
        case, pots=pots(case, [0.0, 0.6, 0.4, 0.9, 1.0], [1.5, 1.0, 0.0, 0.5, 2.0], **none)
    )


@pytest.mark.parametrize("timing", ["advance", "arrears"])
def test_one_cohort_without_a_reserve_is_a_plain_pot(timing):
    """In cash at 2 %, P' = P R + c - b, or (P + c - b) R, with b = P over its annuity: whatever the
    rules of sharing are."""
    case = alone(timing)
    states, outputs, (_, steps) = rolled(case, paths=2, actions=np.array([1.0, 0.0, 0.0]))
    annuity, benefit = np.asarray(steps.value).sum((1, 2)), np.asarray(steps.benefit)[:, 0]
    assert benefit[-1] > 0  # retired by then
    pot, growth = 8000.0, np.exp(0.02)
    for t in range(case.steps):
        assert states.pots[t, :, 0] == pytest.approx(pot, rel=1e-12)
        paid = pot / annuity[t] * benefit[t]
        assert outputs["benefit"][t] == pytest.approx(paid, rel=1e-12, abs=1e-12)
        net = outputs["contribution"][t, 0] - paid - outputs["expenses"][t, 0]
        pot -= outputs["cost"][t, 0]  # of the first trades, into cash
        pot = (pot + net) * growth if timing == "advance" else pot * growth + net
    assert outputs["contribution"][0, 0] > 0
    assert not states.reserve.any()


def alone(timing):
    """One cohort that retires within the horizon, in a market without noise."""
    people, one = members(), slice(1, 2)
    people = replace(
        people,
        names=("old",),
        status=people.status[one],
        sex=people.sex[one],
        age=people.age[one],
        number=people_cases.given("members", [80.0]),
        pension=people_cases.given("accrued_pension", [12.0]),
        salary=people_cases.given("salary", [45.0]),
        service=people.service[one],
    )
    case = fund(steps=8, step=1.0, people=people, timing=timing, rate=0.0)
    none = {"reserve": 0.0, "fill_contribution": 0.0, "fill_return": 0.0}
    return replace(case, pots=pots(case, [0.7], [1.3], **none))


def test_limits_of_swaps_are_shares_of_the_payments_that_pots_pay_for():
    """All payments are nearest to one of two swaps, and worth the pots: 90 % of 8,000. The first
    step trades the notionals that these limits imply."""
    overlay = market_cases.full(1).overlay
    assert overlay is not None
    overlay = replace(overlay, zero_coupon=(), leverage=given("overlay_leverage", 1.0))
    case = fund(steps=1, overlay=overlay)
    values = limit_unit(case)
    assert values.sum() == pytest.approx(7200, rel=1e-6)
    assert values.min() > 700
    positions = np.array([0.3, 0.6])
    states, _, _ = rolled(case, 2, np.array([0.2, 0.5, 0.3, *positions]))
    traded = states.fund.overlay[1] * states.fund.assets[1][:, None]
    assert traded == pytest.approx(np.tile(notionals(case, positions, values), (2, 1)), rel=1e-6)
