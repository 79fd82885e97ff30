"""Path p is the same world in every contract: noise counts from the valuation date, in float64."""

import datetime
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.domains.gas_storage.storage_cases import read_case

from snapo.domains.gas_storage.setup import bare_problem
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.policies.rules import Constant
from snapo.problem.scenarios import Pseudo, Sobol
from snapo.problem.smooth import EXACT
from snapo.solver.adjoint import flat_weights, pull_back

VALUATION, DAY = datetime.date(2025, 1, 1), datetime.timedelta(1)
ONE = 'kind = "one-factor"\nmean_reversion = 4.0\nvolatility = 0.9'
SEVERAL = """kind = "multi-factor"
factors = [
    { mean_reversion = 41.0, volatility = 0.93 },
    { mean_reversion = 1.3, volatility = 0.42 },
    { mean_reversion = 0.0, volatility = 0.21 },
]
correlation = [[1.0, 0.31, -0.22], [0.31, 1.0, 0.17], [-0.22, 0.17, 1.0]]"""
SPIKES = (
    ONE.replace("one-factor", "one-factor-jumps")
    + """
jump_intensity = 6.0
jump_size = 0.3
jump_mean_reversion = 150.0"""
)
FORCED = Constant(np.zeros(2))  # nothing moves but what must


@pytest.fixture
def store(tmp_path):
    """A store from one day after the valuation date to another, that must withdraw 1 a day from the
    day `flow` on and injects up to 2 a day before."""

    @cache
    def made(start, end, model=SEVERAL, flow=None, outage=False):
        first, last, must = (VALUATION + n * DAY for n in (start, end, flow or start))
        outages = f'outages = ["{first}/{must - DAY}"]' if outage else ""
        rows = ["date,value", f"{must - DAY},0", f"{must},1"]
        (tmp_path / "forced.csv").write_text("\n".join(rows))
        prices = [f"{VALUATION + n * DAY},{20 + 5 * np.sin(n / 9):.3f}" for n in range(end + 1)]
        (tmp_path / "curve.csv").write_text("\n".join(["date,price", *prices]))
        (tmp_path / "case.toml").write_text(f"""kind = "gas-storage"
[contract]
start = {first}
end = {last}
inventory = 500.0
max_inventory = 900.0
max_injection = 2.0
max_withdrawal = 3.0
min_withdrawal = "forced.csv"
end_inventory = "free"
{outages}
[market]
valuation_date = {VALUATION}
forward_curve = "curve.csv"
interest_rate = 0.02
[model]
{model}
""")
        return bare_problem(read_case(tmp_path))

    return made


def rolled(problem, source=None, paths=8, policy=FORCED, engine=None):
    """Price states [T, paths, …] and cash flows [paths]."""
    draws = (source or Pseudo(3)).draws(np.arange(paths), problem.simulator)
    bound = (engine or Native("float64")).bind(problem)
    rollout = bound.values(policy, draws, EXACT, record=("state",))
    return np.asarray(rollout.record["state"].price), np.asarray(rollout.totals["cash_flow"])


@pytest.mark.parametrize(
    ("source", "first", "start"),
    [
        (Pseudo(3), 0, 1),
        pytest.param(Pseudo(3), 0, 30, marks=pytest.mark.prove),
        pytest.param(Pseudo(3, antithetic=False), 2, 40, marks=pytest.mark.prove),
        (Sobol(3), 2, 40),
    ],
)
def test_a_later_start_is_an_outage_until_then(store, source, first, start):
    early, late = store(first, 45, flow=start, outage=True), store(start, 45)
    assert source.world(early.simulator) == source.world(late.simulator)
    (before, one), (after, other) = (rolled(problem, source) for problem in (early, late))
    assert np.abs(after).max() > 0.1 and len(after) == 45 - start
    assert_allclose(after, before[start - first :], atol=1e-12)
    assert_allclose(other, one, rtol=1e-9)


def test_engines_agree(store):
    (states, cash), (others, same) = (
        rolled(store(30, 45), engine=engine) for engine in (Native("float64"), Xla("float64"))
    )
    assert_allclose(states, others, atol=1e-12)
    assert_allclose(cash, same, rtol=1e-12)


@pytest.mark.parametrize("start", [0, 1, 2, 30, 100, 400])
def test_the_law_of_the_first_day_is_the_closed_form(store, start):
    prices = store(start, start + 2).schedule.constants.price
    speeds = np.array([41.0, 1.3, 0.0])
    pair = speeds[:, None] + speeds
    correlation = np.array([[1.0, 0.31, -0.22], [0.31, 1.0, 0.17], [-0.22, 0.17, 1.0]])
    time = start / 365
    expected = correlation * np.where(
        pair > 0, -np.expm1(-pair * time) / np.where(pair > 0, pair, 1.0), time
    )
    for shock in (prices.before, prices.first_shock):
        assert_allclose(shock @ shock.T, expected, rtol=1e-11, atol=1e-16)


@pytest.mark.prove
def test_derivatives_are_central_differences(store):
    problem, paths, policy = store(30, 40), 64, Constant(np.array([0.3, 0.2]))
    draws = Pseudo(5).draws(np.arange(paths), problem.simulator)
    weights = flat_weights(problem.objective, paths)
    engine = Native("float64")
    passed = engine.bind(problem).adjoint(policy, draws, EXACT, weights, wrt=("schedule",))
    slopes = pull_back(problem.simulator, problem.inputs, [passed.schedule])
    for name in ("mean_reversion", "volatility", "correlation"):
        numbers, step = problem.inputs_by_name[name].value, 1e-5
        expected = np.empty(numbers.shape)
        for i in np.ndindex(numbers.shape):
            moved = np.zeros(numbers.shape)
            moved[i] = step
            up, down = (
                rolled(problem.at({name: numbers + side * moved}), Pseudo(5), paths, policy)[1]
                for side in (1, -1)
            )
            expected[i] = (up - down).mean() / (2 * step)
        assert np.abs(expected).max() > 1e-3
        slope = np.reshape(slopes[name], numbers.shape)
        assert_allclose(slope, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_two_stores_a_month_apart_are_as_correlated_as_their_prices(store):
    """Each sells 1 a day for 60 days: covariances of lognormal prices are known."""
    problems = [store(start, start + 60, ONE) for start in (0, 30)]
    source = Pseudo(8, antithetic=False)
    cash = np.stack([rolled(problem, source, 1 << 14)[1] for problem in problems])
    days = np.arange(90)
    time, forward = days / 365, 20 + 5 * np.sin(days / 9)
    apart = np.abs(time[:, None] - time)
    shared = -np.expm1(-8.0 * np.minimum(time[:, None], time)) / 8.0
    cover = np.expm1(0.81 * np.exp(-4.0 * apart) * shared) * np.outer(forward, forward)
    held = np.exp(-0.02 * time) * np.stack([days < 60, days >= 30])
    expected = held @ cover @ held.T
    spread = np.array([1.0, -1.0])
    ratio = np.std(spread @ cash) / np.sqrt(spread @ expected @ spread)
    correlation = expected[0, 1] / np.sqrt(expected[0, 0] * expected[1, 1])
    assert abs(ratio - 1) < 0.03
    assert abs(np.corrcoef(cash)[0, 1] - correlation) < 0.01


def test_dates_are_numbers_of_one_form(store):
    assert store(40, 50).form == store(60, 70).form != store(70, 80).form


def test_spikes_begin_their_own_calendar(store):
    today, one, other, same = (store(n, n + 5, SPIKES) for n in (0, 30, 31, 30))
    source = Pseudo(3)
    worlds = [source.world(problem.simulator) for problem in (today, one, other, same)]
    assert len(set(worlds[:3])) == 3 and worlds[1] == worlds[3]
    draws = source.draws(np.arange(2), one.simulator)
    assert (int(draws.first), draws.before) == (0, 0)
    assert source.world(store(0, 5).simulator) == source.world(store(30, 35).simulator)
