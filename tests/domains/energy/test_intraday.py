"""Batteries that trade differences from their schedule, at a spread."""

import datetime
import shutil
from functools import cache
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.energy.energy_cases import HOME, battery, case_at

from snapo.case.error import CaseError
from snapo.domains.energy.chapters.reference import around
from snapo.domains.energy.core.intraday import GAIN, VIEWS
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.setup import bare_problem, make_setup
from snapo.problem.smooth import Exact
from snapo.solver.bound import bound
from snapo.solver.derivatives.by_block import DerivativePass
from snapo.solver.evaluate import evaluate, path_totals

SPEED, VOLATILITY, HOUR = 525.6, 10.2956, 1 / 8760  # of the template
PRICES = np.array([60.0, 59.0, 60.5, 58.5, 61.0, 60.0])
INTO, BLOCK, PATHS, WIDE = 0.98, 3, 8192, 1000.0
SCHEDULED = {"auction": {"step": f"{BLOCK}h"}}


@pytest.fixture(scope="module")
def case_of(tmp_path_factory):
    """Six hours of one MWh, which is stored or taken in an hour; with keys of `[contract]`."""
    folder = tmp_path_factory.mktemp("battery")
    shutil.copytree(HOME / "template_battery", folder, dirs_exist_ok=True)
    rows = [f"2026-05-04T{hour:02d}:00,{price}" for hour, price in enumerate(PRICES)]
    (folder / "curve.csv").write_text("\n".join(["time,price", *rows]))
    keys = {
        "end": datetime.datetime(2026, 5, 4, len(PRICES)), "cycles": None, "energy": 1.0,
        "charge": {"power": 1 / INTO, "efficiency": INTO}, "wear": 0.0,
        "discharge": {"power": 1.0, "efficiency": 1.0},
    }  # fmt: skip

    def case(**changes):
        return case_at(folder, {f"contract.{name}": x for name, x in (keys | changes).items()})

    return case


@pytest.fixture(scope="module")
def setup_of(case_of):
    """Ready to solve, at a half spread; None: without auctions."""

    @cache
    def setup(half_spread):
        if half_spread is None:
            return make_setup(case_of(), "native")
        return make_setup(case_of(**SCHEDULED, intraday={"half_spread": half_spread}), "native")

    return setup


def best(half_spread: float) -> float:
    """The exact value: all schedules of each block, and in each hour the best flow, on a grid of
    the factor. An hour's forward price does not matter, as E[S | auction] is the same."""
    hours, count = np.arange(len(PRICES)), 601
    variance = -np.expm1(-2 * SPEED * HOUR * hours) / (2 * SPEED)
    f = np.linspace(-1, 1, count) * 6 * np.sqrt(variance[-1])
    left = np.exp(-SPEED * HOUR)
    step = np.exp(-0.5 * ((f[None, :] - left * f[:, None]) / np.sqrt(variance[1])) ** 2)
    step /= step.sum(axis=1, keepdims=True)
    sold = {-1: 1.0, 0: 0.0, 1: -1 / INTO}
    value = np.zeros((2, count))
    for first in reversed(range(0, len(PRICES), BLOCK)):
        after = np.full((2, count), -np.inf)
        for state, plan in product((0, 1), product((-1, 0, 1), repeat=BLOCK)):
            stored = state + np.cumsum(plan)
            if stored.min() < 0 or stored.max() > 1:
                continue
            later = value
            for k in reversed(range(BLOCK)):
                t, ahead = first + k, later @ step.T
                price = PRICES[t] * np.exp(VOLATILITY * f - VOLATILITY**2 * variance[t] / 2)
                gained = [
                    [
                        sold[q] * price - half_spread * abs(sold[q] - sold[plan[k]])
                        + ahead[level + q]
                        for q in (-1, 0, 1) if 0 <= level + q <= 1
                    ]
                    for level in (0, 1)
                ]  # fmt: skip
                later = np.stack([np.max(x, axis=0) for x in gained])
            after[state] = np.maximum(after[state], later[state])
        value = after
    return float(np.interp(0.0, f, value[0]))


def totals_of(setup, paths=PATHS):
    policy = setup.policy.value_rule
    return path_totals(setup.problem, policy, paths, engine=setup.engines.evaluate)


def assert_just_below(exact, setup, share):
    """The starting rule earns this share of the exact value and not more than it, by 2 errors."""
    engine = setup.engines.evaluate
    result = evaluate(setup.problem, setup.policy.value_rule, paths=PATHS, engine=engine)
    assert exact * share - 2 * result.standard_error < result.value
    assert result.value < exact + 2 * result.standard_error


@pytest.mark.prove
def test_both_ends_of_the_spread(setup_of):
    """Without a spread the flows of every path are those without auctions. At a very wide one
    nothing is traded, and the value is that of auctions only, both exact."""
    free, none, wide = setup_of(0.0), setup_of(None), setup_of(WIDE)
    of_free, of_none, of_wide = map(totals_of, (free, none, wide))
    for name in ("charge", "discharge"):
        assert np.array_equal(of_free[name], of_none[name])
    money = of_free["cash_flow"] - of_free[GAIN]
    assert np.allclose(money, of_none["cash_flow"], atol=1e-3)
    values = around(wide.problem)
    assert values is not None
    scheduled, without = values
    assert best(0.0) == pytest.approx(without, rel=1e-3)
    assert best(WIDE) == pytest.approx(scheduled, rel=1e-3)
    assert np.all(of_wide["traded intraday"] == 0)
    for setup, exact in ((free, without), (wide, scheduled)):
        assert_just_below(exact, setup, 0.998)


@pytest.mark.prove
def test_the_policy_is_below_the_best_schedules_and_near_them(setup_of):
    """All schedules of two blocks, with the best trades."""
    for half_spread in (0.1, 0.3, 1.0):
        setup, exact = setup_of(half_spread), best(half_spread)
        assert_just_below(exact, setup, 0.997)


@pytest.mark.prove
def test_the_derivative_with_respect_to_the_half_spread(setup_of):
    """With flows held it is minus the traded volume, and negative."""
    setup = setup_of(0.3)
    problem, policy, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    path = DerivativePass(problem, engine.bind(problem), policy, Exact(), held=True)
    slope = path.derivatives([np.arange(PATHS)]).inputs["half_spread"].value.item()
    traded = totals_of(setup)["traded intraday"]
    assert slope == pytest.approx(-traded.mean(), rel=1e-4) and slope < 0


@pytest.mark.prove
def test_no_policy_earns_more_than_the_bound(setup_of):
    setup = setup_of(0.3)
    result = bound(
        setup.problem, setup.policy.value_rule, paths=1024, engine=setup.engines.evaluate,
        relaxation=EnergyRelaxation(setup.problem),
    )  # fmt: skip
    error = result.upper.standard_error
    assert best(0.3) < result.upper.value + 3 * error
    assert result.upper.value < best(0.0) * 1.02 + 3 * error


def test_a_schedule_depends_on_what_is_known_at_its_auction():
    """Neither later prices nor trades change the observation of the schedule."""
    case = battery(
        end=datetime.datetime(2026, 5, 4, 8), auction={"step": "4h"}, intraday={"half_spread": 2.0}
    )
    problem = bare_problem(case)
    simulator, schedule = problem.simulator, jax.tree.map(jnp.asarray, problem.schedule)
    initial = jax.jit(lambda noise: simulator.initial(schedule.constants, noise))
    state = initial(jnp.zeros(simulator.initial_noise_size))
    state = state._replace(levels=jnp.array([1.0, 0.0]), scheduled=jnp.array([2.0, 0.0]))

    @jax.jit
    def view(t, state):
        row = jax.tree.map(lambda leaf: leaf[t], schedule.steps)
        return simulator.observe(schedule.constants, row, state).reshape((VIEWS, -1))

    moved = state._replace(levels=jnp.array([3.0, 0.5]), price=jnp.array([0.02]))
    for t in (0, 1, 4, 7):
        same = bool(jnp.array_equal(view(t, state)[0], view(t, moved)[0]))
        assert same == (t not in (0, 4))
        assert not jnp.array_equal(view(t, state)[1], view(t, moved)[1])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"intraday": {"half_spread": 2.0}}, "contract.intraday: .*specify `auction` too"),
        ({"auction": {"step": "4h"}, "intraday": {"half_spread": -1.0}}, "half_spread"),
        ({"auction": {"step": "4h"}, "intraday": {}}, "half_spread"),
        ({"auction": {"step": "4h"}, "intraday": {"half_spread": 2.0},
          "start": datetime.datetime(2026, 5, 5, 2)}, "the hour of an auction"),
    ],
)  # fmt: skip
def test_mistakes_of_trades_are_named(changes, message):
    with pytest.raises(CaseError, match=message):
        battery(**changes)
