"""`snapo.solve(problem)` with nothing set, beside optima of linear and dynamic programming.

Each in less than 60 s on two quiet cores, which is 120 s of processor time. The regulator stands in
`learning/test_convergence.py`, the pendulum in `learning/test_pendulum.py`; figures in
docs/simulator/defaults.md.
"""

import time
from dataclasses import replace

import jax
import numpy as np
import pytest
from examples import american_put

import snapo
from snapo.problem.noise.counter import Stored

from . import problems
from .references import Sddp, best_days, best_saver, best_stocks

LIMIT = 120.0  # seconds of all processors
SEEDS = pytest.mark.parametrize("seed", range(10))
FEW = {"sensitivity_paths": 1024, "smooth_paths": 0, "judge_paths": 0}


def test_the_best_of_one_day_is_the_one_by_hand():
    """One dear hour after one cheap one: a MWh bought at 10 and sold at 100, less losses and wear."""
    prices = np.full((1, 24), 50.0)
    prices[0, 3], prices[0, 9] = 10.0, 100.0
    into, out = 10 / problems.EFFICIENCY + problems.WEAR, 100 * problems.EFFICIENCY - problems.WEAR
    idle = np.full((1, 24), 50.0)
    assert best_days(prices)[0] == pytest.approx(
        # Besides, three more MWh are bought or sold at 50 beside one of the two hours.
        out - into,
        rel=1e-6,
    )
    assert best_days(idle)[0] == pytest.approx(0.0, abs=1e-9)


def seeded(problem, seed):
    """The same with scenarios of a seed's own; a solution has those of its problem."""
    return replace(problem, sources=snapo.Evaluation().sources(seed))


def solved(problem, inputs, seed, paths=8192):
    """The solution, and the processor seconds that it took; `-rP` shows them."""
    started = time.process_time()
    evaluation = snapo.Evaluation(paths=paths, **FEW)
    training = snapo.Training(seed=seed)
    solution = snapo.solve(problem, inputs, training=training, evaluation=evaluation)
    spent = time.process_time() - started
    print(
        f"seed {seed}: {solution.value:.6g} ± {solution.standard_error:.2g}, {spent:.0f} s of "
        f"processor time, training {solution.seconds['train']:.1f} s"
    )
    return solution, spent


@SEEDS
@pytest.mark.study
def test_put(seed):
    """4.478 by finite differences."""
    solution, seconds = solved(american_put.Put(), american_put.inputs, seed, 1_000_000)
    assert solution.value > 4.46 and seconds < LIMIT


@SEEDS
@pytest.mark.study
def test_cart_and_pole(seed):
    """Upright, within 12 degrees, in 90 % of the second half."""
    problem = seeded(problems.cart(), seed)
    solution, seconds = solved(problem, None, seed)
    share = problems.upright(problem, solution.policy)
    print(f"upright {share:.3f}")
    assert share > 0.9 and seconds < LIMIT


@pytest.mark.prove
def test_a_share_of_the_adjoints_goes_on_where_gradients_stay_wild():
    """A cart and pole: chosen after the first twenty steps, and told with the verdict."""
    few = snapo.Evaluation(paths=64, sensitivity_paths=0, smooth_paths=0, judge_paths=0)
    plan = snapo.Training(steps=25, validation_every=50)  # as in a training of usual length
    solution = snapo.solve(problems.cart(), training=plan, evaluation=few)
    shares = [record.keep for record in solution.history]
    assert set(shares[:20]) == {1.0} and 0.9 < shares[-1] < 1.0
    assert "every backward step kept only a share of" in " ".join(solution.notes)


@pytest.fixture(scope="module")
def known():
    """The rule of dual dynamic programming on fresh inflows: its costs [N], and their noise."""
    programme, rng, paths = Sddp(), np.random.default_rng(0), 4096
    for _ in range(30):
        programme.improve(rng, 4)
    month = rng.integers(0, problems.OUTCOMES, (problems.MONTHS, paths))
    noise = np.asarray(jax.scipy.special.ndtri((month + 0.5) / problems.OUTCOMES))[:, :, None]
    costs = programme.cost(month)
    assert programme.bound() < costs.mean() + 3 * costs.std() / paths**0.5
    return costs, noise


@SEEDS
@pytest.mark.study
def test_hydro(known, seed):
    """Its cost within 1 % of that of the rule of dual dynamic programming, on the same inflows.

    After thirty rounds (of four cuts for every month) that rule's cost is 2.5 % above the bound,
    which rises for hundreds of rounds more; the optimum lies between the two. A value on paths of
    its own would be off by .3 % for its paths alone.
    """
    costs, noise = known
    solution, seconds = solved(problems.Hydro(), problems.HYDRO, seed)
    bound = snapo.Xla("float64").bind(
        snapo.Problem(problems.Hydro(), problems.HYDRO, snapo.Mean("value"))
    )
    draws = Stored(np.zeros((len(costs), 0)), noise)
    cost = -np.asarray(bound.values(solution.policy, draws, snapo.Exact()).totals["value"])
    error = (cost - costs).std() / len(costs) ** 0.5
    print(f"{cost.mean() / costs.mean() - 1:+.3%} ± {error / costs.mean():.3%}")
    assert cost.mean() + 2 * error < 1.01 * costs.mean() and seconds < LIMIT


@SEEDS
@pytest.mark.study
def test_battery(seed):
    """94 % of a linear program for each day that knows its prices, on the prices of the run."""
    problem = seeded(snapo.Problem(problems.Battery(), problems.BATTERY, snapo.Mean("cash")), seed)
    draws = problem.sources.evaluation.draws(np.arange(8), problem.simulator)
    bound = snapo.Xla("float64").bind(problem)
    seen = bound.values(snapo.Constant([0.0] * 24), draws, snapo.Exact(), record=("state",))
    best = best_days(np.asarray(seen.record["state"]["prices"]).reshape(-1, 24))
    solution, seconds = solved(problem, None, seed, 1024)
    share = solution.value / (365 * best.mean())
    print(f"{share:.2%} of the best")
    assert share > 0.94 and seconds < LIMIT


@SEEDS
@pytest.mark.study
def test_stocks(seed):
    """Twelve newsvendors: within .3 % of the least cost, weights that decay and all."""
    problem = seeded(snapo.Problem(problems.Stocks(), None, snapo.Mean("value")), seed)
    solution, seconds = solved(problem, None, seed, 65_536)
    print(f"{-solution.value / best_stocks() - 1:.3%} above")
    assert -solution.value < 1.003 * best_stocks() and seconds < LIMIT


@SEEDS
@pytest.mark.study
def test_saver(seed):
    """A certainty equivalent within 2 % of the best one, although first gradients are of 5e10."""
    inputs = {name: snapo.Input(value) for name, value in problems.SAVER.items()}
    solution, seconds = solved(problems.Saver(), inputs, seed, 65_536)
    share = (best_saver() / solution.value) ** (1 / (problems.AVERSE - 1))
    print(f"{share:.2%} of the best certainty equivalent")
    assert 0.98 < share < 1.001 and seconds < LIMIT


def test_the_best_saver_is_that_of_a_search_in_every_month():
    """-23,051.11 by Nelder-Mead over weight and share at once, with 31 nodes."""
    assert best_saver() == pytest.approx(-23_051.11, abs=0.02)
