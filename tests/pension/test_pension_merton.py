"""P1: a pension fund with one stock, cash and no liability is Merton's problem, monthly.

Cash at 2 %, the stock grows at 6 % with 18 %, relative risk aversion 5, ten years. Returns are
independent and the utility a power, so the certainty equivalent is a Gaussian integral.
"""

import jax
import numpy as np
import pytest
from market_cases import CASH, EQUITY, assets, case, cash_flows

from snapo.adjoint import prepare, value_and_gradient
from snapo.domains.pension.inputs import pension_inputs
from snapo.domains.pension.policy import new_policy
from snapo.domains.pension.simulator import PensionSimulator
from snapo.engine.native import Native
from snapo.objective import CRRA, ExpectedUtility
from snapo.scenarios import Pseudo
from snapo.smooth import Exact
from snapo.train import Training, begin, train

pytestmark = pytest.mark.slow

GAMMA, STEPS = 5.0, 120
WEIGHT, EQUIVALENT = 0.24678682, 1.28318464  # of exact monthly rebalancing
OBJECTIVE = ExpectedUtility("assets", CRRA(GAMMA))
DRIFT, VOLATILITY, RATE = 0.06, 0.18, 0.02


def log_equivalent(weight, drift=DRIFT, volatility=VOLATILITY):
    """ln of the certainty equivalent of 1, by 60 Gauss-Hermite points."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    stock = np.exp((drift - volatility**2 / 2) / 12 + volatility / np.sqrt(12) * nodes)
    cash = np.exp(RATE / 12)
    moment = np.sum(weights * (cash + weight * (stock - cash)) ** (1 - GAMMA))
    return STEPS * np.log(moment / np.sqrt(2 * np.pi)) / (1 - GAMMA)


@pytest.fixture(scope="module")
def solved():
    """The network, trained on time alone."""
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
    one = case(STEPS, held_assets=held, flows=cash_flows([0.0], [0]))
    simulator, inputs = PensionSimulator(one), pension_inputs(one)  # pyright: ignore
    schedule = prepare(simulator, inputs)
    start = new_policy(one, simulator, schedule, jax.random.key(0))
    training = Training(steps=400, paths=2048, learning_rate=0.02, validation_every=200)
    engine = Native("float32")
    done = train(simulator, schedule, begin(start, training), OBJECTIVE, training, engine)
    return simulator, inputs, done.best


def weights_of(solved):
    policy = solved[2]
    times = 2 * np.arange(STEPS) / STEPS - 1
    return np.array([np.asarray(policy(np.array([t], np.float32), Exact()))[1] for t in times])


def test_the_trained_weight_is_mertons(solved):
    weights = weights_of(solved)
    assert abs(weights.mean() - WEIGHT) < 0.0025
    assert np.abs(weights - WEIGHT).max() < 0.01
    # Time runs through the weights, so the loss of each month counts on its own.
    found = np.mean([log_equivalent(weight) for weight in weights])
    assert (np.log(EQUIVALENT) - found) / 10 < 0.02e-4


def test_sensitivities_are_those_of_the_closed_form(solved):
    simulator, inputs, policy = solved
    paths = 2**15
    _, gradient = value_and_gradient(
        simulator, inputs, policy, objective=OBJECTIVE, scenarios=Pseudo(11), paths=paths,
        held=True, engine=Native("float64"),
    )  # fmt: skip
    totals = Native("float64").values(
        simulator, policy, prepare(simulator, inputs), Pseudo(11).draws(np.arange(paths), simulator),
        Exact(),
    ).totals  # fmt: skip
    utility = np.mean(np.asarray(totals["assets"]) ** (1 - GAMMA)) / (1 - GAMMA)
    # d ln CE = d U / ((1 - gamma) U); the mean is given as that of a year's simple return.
    slope = 1 / ((1 - GAMMA) * utility)
    to_drift = gradient.inputs["asset_mean"][0] * slope * np.exp(DRIFT)
    to_volatility = gradient.inputs["asset_volatility"][0] * slope
    weight, h = weights_of(solved).mean(), 1e-5
    drift = (log_equivalent(weight, DRIFT + h) - log_equivalent(weight, DRIFT - h)) / (2 * h)
    wide = [log_equivalent(weight, DRIFT, VOLATILITY + s) for s in (h, -h)]
    volatility = (wide[0] - wide[1]) / (2 * h)
    assert to_drift == pytest.approx(drift, rel=0.015)
    assert to_volatility == pytest.approx(volatility, rel=0.03)
    assert drift == pytest.approx(WEIGHT * 10, rel=0.015)
    assert volatility == pytest.approx(-GAMMA * WEIGHT**2 * VOLATILITY * 10, rel=0.03)
