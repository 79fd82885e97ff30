"""P1: a pension fund with one stock, cash and no liability is Merton's problem, monthly.

Cash at 2 %, the stock grows at 6 % with 18 %, relative risk aversion 5, ten years. Returns are
independent and the utility a power, so the certainty equivalent of any weights that move with time
alone is a product of Gaussian integrals, one a month, and so are its derivatives.
"""

from dataclasses import replace

import jax
import numpy as np
import pytest
from tests.domains.pension.market_cases import CASH, EQUITY, assets, case, cash_flows

from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.policies.allocation import new_policy
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.engine.native import Native
from snapo.problem.objective import CRRA, ExpectedUtility
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Sobol
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import value_and_gradient
from snapo.solver.train import Training, initial_progress, train

pytestmark = pytest.mark.study

GAMMA, STEPS = 5.0, 120
WEIGHT, EQUIVALENT = 0.24678682, 1.28318464  # of exact monthly rebalancing
OBJECTIVE = ExpectedUtility("assets", CRRA(GAMMA))
DRIFT, VOLATILITY, RATE = 0.06, 0.18, 0.02


NODES, MASS = np.polynomial.hermite_e.hermegauss(60)
MASS = MASS / MASS.sum()


def monthly(weights, drift=DRIFT, rate=RATE, volatility=VOLATILITY):
    """Gross returns [months, nodes] of a portfolio, and of the stock [nodes] and cash."""
    stock = np.exp((drift - volatility**2 / 2) / 12 + volatility / np.sqrt(12) * NODES)
    cash = np.exp(rate / 12)
    return cash + np.asarray(weights)[:, None] * (stock - cash), stock, cash


def log_equivalent(weights, drift=DRIFT, rate=RATE, volatility=VOLATILITY):
    """ln of the certainty equivalent of 1 with these weights [months], by 60 Gauss-Hermite points:
    the sum over months of ln E[R^(1 - gamma)] / (1 - gamma)."""
    gross = monthly(weights, drift, rate, volatility)[0]
    return np.sum(np.log(gross ** (1 - GAMMA) @ MASS)) / (1 - GAMMA)


def slopes(weights):
    """d ln CE by drift, rate and volatility: sums over months of E[R^-gamma dR] / E[R^(1-gamma)]."""
    weights = np.asarray(weights)[:, None]
    gross, stock, cash = monthly(weights[:, 0])
    moved = {
        "drift": weights * stock / 12,
        "rate": (1 - weights) * cash / 12,
        "volatility": weights * stock * (NODES / np.sqrt(12) - VOLATILITY / 12),
    }
    pull = gross**-GAMMA * MASS / (gross ** (1 - GAMMA) @ MASS)[:, None]
    return {name: float(np.sum(pull * each)) for name, each in moved.items()}


def fund():
    """Cash and the stock, worth 1, without members."""
    held = assets(
        STEPS,
        [CASH, EQUITY],
        mean=[np.expm1(DRIFT)],
        volatility=[VOLATILITY],
        weight=[0.5, 0.5],
        return_kind="total",
        mean_kind="arithmetic",
        amount=1.0,
    )
    return case(STEPS, held_assets=held, flows=cash_flows([0.0], [0]))


@pytest.fixture(scope="module")
def solved():
    """The network, trained on time alone."""
    one = fund()
    simulator, inputs = PensionSimulator.of(one), pension_inputs(one)
    problem = Problem(simulator, inputs, OBJECTIVE)
    start = new_policy(one, simulator, problem.schedule, jax.random.key(0))
    training = Training(steps=400, paths=2048, learning_rate=0.02, validation_every=200)
    engine = Native("float32")
    return problem, train(problem, initial_progress(start, training), training, engine).best


def weights_of(solved):
    policy = solved[1]
    times = 2 * np.arange(STEPS) / STEPS - 1
    return np.array([np.asarray(policy(np.array([t], np.float32), Exact()))[1] for t in times])


def test_the_trained_weight_is_mertons(solved):
    weights = weights_of(solved)
    assert abs(weights.mean() - WEIGHT) < 0.0025
    assert np.abs(weights - WEIGHT).max() < 0.01
    # Returns are independent: each month's loss counts on its own, 0.02 bp a year in all.
    assert (np.log(EQUIVALENT) - log_equivalent(weights)) / 10 < 0.02e-4


def test_the_closed_forms_agree_with_each_other_and_with_the_continuous_ones():
    constant, h = np.full(STEPS, WEIGHT), 1e-5
    assert np.exp(log_equivalent(constant)) == pytest.approx(EQUIVALENT, rel=1e-8)
    found, now = slopes(constant), {"drift": DRIFT, "rate": RATE, "volatility": VOLATILITY}
    for name, value in now.items():
        up, down = (log_equivalent(constant, **{name: value + s}) for s in (h, -h))
        assert found[name] == pytest.approx((up - down) / (2 * h), rel=1e-7)
    assert found["drift"] == pytest.approx(WEIGHT * 10, rel=0.015)
    assert found["rate"] == pytest.approx((1 - WEIGHT) * 10, rel=0.015)
    assert found["volatility"] == pytest.approx(-GAMMA * WEIGHT**2 * VOLATILITY * 10, rel=0.03)


def test_sensitivities_are_those_of_the_closed_form(solved):
    """By the adjoint at the weights as trained: mu, r and sigma to 1e-3 of the closed form there,
    mu to 1.5 % and sigma to 3 % of the closed forms at the best weight."""
    problem, policy = solved
    # Sobol points: the error of the derivative by sigma is 1 % on as many pseudo-random paths.
    source, paths, engine = Sobol(11), 2**15, Native("float64")
    problem = replace(problem, sources=replace(problem.sources, evaluation=source))
    _, gradient = value_and_gradient(problem, policy, paths=paths, decisions="held", engine=engine)
    draws = source.draws(np.arange(paths), problem.simulator)
    assets_then = np.asarray(engine.bind(problem).values(policy, draws, Exact()).totals["assets"])
    # d ln CE = d U / ((1 - gamma) U); the mean is given as that of a year's simple return.
    slope = 1 / np.mean(assets_then ** (1 - GAMMA))
    found = {
        "drift": gradient.inputs["asset_mean"][0] * slope * np.exp(DRIFT),
        "rate": gradient.inputs["zero_rate"].sum() * slope,
        "volatility": gradient.inputs["asset_volatility"][0] * slope,
    }
    assert found == pytest.approx(slopes(weights_of(solved)), rel=1e-3)
    best = slopes(np.full(STEPS, WEIGHT))
    assert found["drift"] == pytest.approx(best["drift"], rel=0.015)
    assert found["volatility"] == pytest.approx(best["volatility"], rel=0.03)
