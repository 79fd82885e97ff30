"""A fund of personal pots: its money adds up, and its closed forms."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension import market_cases, people_cases
from tests.domains.pension.people_cases import members

from snapo.case.given import Given
from snapo.domains.pension.market.assets.bond import Bond
from snapo.domains.pension.pots.simulator import PotSimulator
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.pots import PotRules, Pots
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.inputs import plain
from snapo.problem.objective import Mean
from snapo.problem.policy import Constant
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo, Sources
from snapo.problem.smooth import Exact
from snapo.solver.certificate import bump_check, nudged

pytestmark = pytest.mark.prove
STEPS = 24
RULES = PotRules("2023-07-01", "by hand", 0.15, 0.1, 0.1)


def pots(case, protection, exposure, **changes):
    """Allocations by cohort [C], the same in all steps."""

    def by_cohort(name, values):
        index = np.broadcast_to(np.arange(len(values)), (case.steps, len(values)))
        return Given(name, np.array(values, float), tuple(map(str, values)), "1", index)

    usual = {"reserve": 0.1, "fill_contribution": 0.1, "fill_return": 0.1, "release": 0.2}
    numbers = usual | {"largest": 0.15} | changes
    return Pots(
        RULES,
        **{k: market_cases.given(f"reserve_{k}", v) for k, v in numbers.items()},
        protection=by_cohort("pot_protection", protection),
        exposure=by_cohort("pot_exposure", exposure),
    )


def fund(steps=STEPS, step=1 / 12, people=None, rate=0.01, equity=0.2, timing="arrears", **changes):
    """Cohorts with stochastic rates, equity and a bond."""
    classes = [market_cases.CASH, market_cases.EQUITY, Bond("Bond", maturity=round(10 / step))]
    held = market_cases.assets(
        steps, classes, mean=[0.03], volatility=[equity], weight=[0.2, 0.5, 0.3], amount=8000.0,
        cost=[0.0, 0.001, 0.0005],
    )  # fmt: skip
    plan = market_cases.plan(
        timing, contribution=market_cases.no_contribution("fixed", rate=0.2),
        expenses=market_cases.given("expenses", 5.0),
    )  # fmt: skip
    people = members() if people is None else people
    fields = {
        "step": step, "cash_flows": None, "members": people, "mortality": people_cases.mortality(),
        "rates": market_cases.rates(steps, s=rate), "plan": plan,
        "observation": ("time", "funding_ratio", "rates", "weights"),
    }  # fmt: skip
    case = market_cases.case(steps, held_assets=held)
    case = replace(case, **fields)
    count = len(people.names)
    return replace(case, **({"pots": pots(case, [0.5] * count, [1.0] * count)} | changes))


def rolled(case, paths=6, actions=None):
    """Every state [T+1, N, …] and output [T, N] on paths with weights drawn at random, or these."""
    simulator: Any = PotSimulator(case)  # pyright: ignore[reportCallIssue]
    rng = np.random.default_rng(3)
    inputs = plain(pension_inputs(case))
    with jax.enable_x64(True):
        schedule = jax.jit(simulator.prepare)(inputs)
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
                action = np.broadcast_to(actions, action.shape)
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


def test_both_engines_agree_and_the_adjoint_is_that_of_differences():
    """Pensions of the horizon by every number of every input, decisions of the policy held."""
    case = fund(steps=3, step=1.0)
    case = replace(case, pots=pots(case, [0.2, 0.6, 0.4, 0.9, 1.0], [1.5, 1.0, 1.2, 0.5, 0.3]))
    simulator: Any = PotSimulator(case)  # pyright: ignore[reportCallIssue]
    source = Pseudo(1)
    problem = nudged(
        Problem(simulator, pension_inputs(case), Mean("pension"), Sources(source, source, source))
    )
    policy = Constant(np.array([0.2, 0.5, 0.3]))
    found = bump_check(problem, policy, 16, smooth=None, every=True, engine=Native("float64"))
    assert {"reserve_reserve", "pot_protection", "pot_exposure"} <= {each.input for each in found}
    assert all(each.passed for each in found)
    draws = source.draws(np.arange(16), simulator)
    totals = [
        engine("float64").bind(problem).values(policy, draws, Exact()).totals
        for engine in (Xla, Native)
    ]
    for name, one in totals[0].items():
        assert np.asarray(one) == pytest.approx(np.asarray(totals[1][name]), rel=1e-9, abs=1e-12)
