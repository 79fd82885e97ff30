"""`snapo.solve(problem)` with nothing set, beside optima of linear and dynamic programming.

Each in less than 60 s on two quiet cores, which is 120 s of processor time. The regulator stands in
`learning/test_convergence.py`, the pendulum in `learning/test_pendulum.py`; figures in
docs/own_simulator.md.
"""

import time

import jax
import numpy as np
import pytest
from examples import american_put

import snapo
from snapo.problem.noise.counter import Stored

from . import problems
from .references import Sddp, best_days

LIMIT = 120.0  # seconds of all processors
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


def solved(problem, inputs=None, paths=8192):
    """The solution, and the processor seconds that it took."""
    started = time.process_time()
    solution = snapo.solve(problem, inputs, evaluation=snapo.Evaluation(paths=paths, **FEW))
    return solution, time.process_time() - started


@pytest.mark.study
def test_put():
    """4.478 by finite differences."""
    solution, seconds = solved(american_put.Put(), american_put.inputs, 65536)
    assert solution.value > 4.46 and seconds < LIMIT


@pytest.mark.study
def test_cart_and_pole():
    """Upright, within 12 degrees, in 90 % of the second half."""
    problem = problems.cart()
    solution, seconds = solved(problem)
    assert problems.upright(problem, solution.policy) > 0.9 and seconds < LIMIT


@pytest.mark.study
def test_hydro():
    """Its cost within 1 % of that of the rule of dual dynamic programming, on the same inflows.

    After thirty rounds (of four cuts for every month) that rule's cost is 2.5 % above the bound,
    which rises for hundreds of rounds more; the optimum lies between the two. A value on paths of
    its own would be off by .3 % for its paths alone.
    """
    programme, rng, paths = Sddp(), np.random.default_rng(0), 4096
    for _ in range(30):
        programme.improve(rng, 4)
    month = rng.integers(0, problems.OUTCOMES, (problems.MONTHS, paths))
    noise = np.asarray(jax.scipy.special.ndtri((month + 0.5) / problems.OUTCOMES))[:, :, None]
    solution, seconds = solved(problems.Hydro(), problems.HYDRO, 8192)
    bound = snapo.Xla("float64").bind(
        snapo.Problem(problems.Hydro(), problems.HYDRO, snapo.Mean("value"))
    )
    draws = Stored(np.zeros((paths, 0)), noise)
    cost = -np.asarray(bound.values(solution.policy, draws, snapo.Exact()).totals["value"])
    known = programme.cost(month)
    error = (cost - known).std() / paths**0.5
    assert programme.bound() < known.mean() + 3 * known.std() / paths**0.5
    assert cost.mean() + 2 * error < 1.01 * known.mean() and seconds < LIMIT


@pytest.mark.study
def test_battery():
    """94 % of a linear program for each day that knows its prices, on the prices of the run."""
    problem = snapo.Problem(problems.Battery(), problems.BATTERY, snapo.Mean("cash"))
    draws = problem.sources.evaluation.draws(np.arange(8), problem.simulator)
    bound = snapo.Xla("float64").bind(problem)
    seen = bound.values(snapo.Constant([0.0] * 24), draws, snapo.Exact(), record=("state",))
    best = best_days(np.asarray(seen.record["state"]["prices"]).reshape(-1, 24))
    solution, seconds = solved(problem, paths=1024)
    assert solution.value > 0.94 * 365 * best.mean() and seconds < LIMIT
