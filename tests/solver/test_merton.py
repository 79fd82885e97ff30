"""Merton's problem rebalanced monthly: weight, certainty equivalent and sensitivities.

r 2 %, mu 6 %, sigma 18 %, relative risk aversion 5, ten years from a wealth of 1. Returns are
independent and the utility is a power, so E[utility] = W^(1 - g) m^120 / (1 - g) with
m = E[(1 + w (R_stock / R_cash - 1))^(1 - g)] R_cash^(1 - g), a Gaussian integral in one dimension.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from snapo.engine import Xla
from snapo.problem.actions import Box
from snapo.problem.inputs import Input
from snapo.problem.objective import CRRA, ExpectedUtility
from snapo.problem.policies.rules import Constant
from snapo.problem.problem import Problem, prepare
from snapo.problem.scenarios import Pseudo
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import pull_back
from snapo.solver.train import Training, initial_progress, train

GAMMA, MONTHS = 5.0, 120
WEIGHT, EQUIVALENT = 0.24678682, 1.28318464  # published for exact monthly rebalancing
UTILITY = CRRA(GAMMA)
OBJECTIVE = ExpectedUtility("wealth", UTILITY)
MARKET = {"rate": 0.02, "drift": 0.06, "volatility": 0.18}


class Inputs(eqx.Module):
    rate: Input
    drift: Input
    volatility: Input


class Merton(Simulator):
    """Wealth in cash and one stock; the action is the stock's weight."""

    horizon: int = MONTHS
    action: Box = Box(0.0, 1.0)
    noise_size: int = 1

    def prepare(self, inputs):
        return Schedule(inputs, {"t": jnp.arange(self.horizon)})

    def initial(self, constants, noise):
        return 1.0

    def observe(self, constants, now, state):
        return jnp.stack([state])

    def step(self, constants, now, state, action, noise, smooth):
        c, dt = constants, 1 / 12
        cash = jnp.exp(c.rate * dt)
        exponent = (c.drift - c.volatility**2 / 2) * dt + c.volatility * jnp.sqrt(dt) * noise[0]
        return state * (cash + action[0] * (jnp.exp(exponent) - cash)), {}

    def terminal(self, constants, state, smooth):
        return {"wealth": state}


def log_equivalent(weight, rate, drift, volatility):
    """ln of the certainty equivalent, by 60 Gauss-Hermite points (exact to rounding)."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    stock = np.exp((drift - volatility**2 / 2) / 12 + volatility / np.sqrt(12) * nodes)
    month = np.exp(rate / 12) + weight * (stock - np.exp(rate / 12))
    moment = np.sum(weights * month ** (1 - GAMMA)) / np.sqrt(2 * np.pi)
    return MONTHS * np.log(moment) / (1 - GAMMA)


def test_the_closed_form_is_the_published_one():
    found = minimize_scalar(
        lambda w: -log_equivalent(w, **MARKET), bounds=(0, 1), options={"xatol": 1e-10}
    )
    # A search without derivatives sees a maximum to the root of rounding only.
    assert found.x == pytest.approx(WEIGHT, abs=5e-7)
    assert np.exp(-found.fun) == pytest.approx(EQUIVALENT, abs=1e-8)


@pytest.fixture(scope="module")
def measured():
    """Value, d value / d weight and by every input in 32 blocks of 512 antithetic paths."""
    simulator, inputs = (
        Merton(),
        Inputs(*(Input(MARKET[n]) for n in ("rate", "drift", "volatility"))),
    )
    schedule, scenarios = prepare(simulator, inputs), Pseudo(1)
    blocks = scenarios.blocks(32 * 512)
    draws = scenarios.draws(np.arange(32 * 512), simulator)
    policy, engine = Constant(np.array([WEIGHT])), Xla(precision="float64")
    wealth = engine.values(simulator, policy, schedule, draws, Exact()).totals["wealth"]
    weights = np.zeros((32, wealth.size))
    for k, block in enumerate(blocks):
        weights[k, block] = OBJECTIVE.weights({"wealth": wealth[block]})["wealth"]
    out = engine.adjoint(simulator, policy, schedule, draws, Exact(), {"wealth": weights})
    moved = pull_back(
        simulator,
        inputs,
        [jax.tree.map(lambda leaf, k=k: leaf[k], out.schedule) for k in range(32)],
    )
    utility = np.array([OBJECTIVE.value({"wealth": wealth[block]}) for block in blocks])
    return utility, {"weight": out.policy.value[:, 0], **moved}


def test_value_at_the_optimal_weight(measured):
    """Within three standard errors of the utility whose certainty equivalent is published."""
    utility, _ = measured
    expected, error = float(UTILITY(np.array([EQUIVALENT]))[0]), utility.std(ddof=1) / np.sqrt(32)
    assert abs(utility.mean() - expected) < 3 * error
    assert error < 0.01 * abs(expected)


def test_sensitivities_at_the_optimal_weight(measured):
    """d ln CE by every input against the closed form's differences; d / d weight is zero.

    ln CE = ln(U (1 - g)) / (1 - g), so d ln CE = dU / (U (1 - g)); as a ratio of means its standard
    error comes from dU - d ln CE (1 - g) U by blocks. Three of them, and each below 5 % of what it
    measures (the vega, whose paths differ most, below 15 %).
    """
    utility, gradients = measured
    for name, gradient in gradients.items():
        if name == "weight":
            expected = 0.0
        else:
            up, down = (
                log_equivalent(WEIGHT, **(MARKET | {name: MARKET[name] + s * 1e-5}))
                for s in (1, -1)
            )
            expected = (up - down) / 2e-5
        estimate = gradient.mean() / (utility.mean() * (1 - GAMMA))
        residual = (gradient - estimate * (1 - GAMMA) * utility) / (utility.mean() * (1 - GAMMA))
        error = residual.std(ddof=1) / np.sqrt(32)
        assert abs(estimate - expected) < 3 * error, name
        if expected:
            assert error < abs(expected) * (0.15 if name == "volatility" else 0.05), name
    # The continuous formulas: w T, (1 - w) T, -g w^2 sigma T, to the 0.2 % that months make.
    continuous = {
        "drift": WEIGHT * 10,
        "rate": (1 - WEIGHT) * 10,
        "volatility": -GAMMA * WEIGHT**2 * 0.18 * 10,
    }
    for name, formula in continuous.items():
        up, down = (
            log_equivalent(WEIGHT, **(MARKET | {name: MARKET[name] + s * 1e-5})) for s in (1, -1)
        )
        assert (up - down) / 2e-5 == pytest.approx(formula, rel=5e-3)


@pytest.mark.prove
def test_training_finds_the_weight():
    """150 steps of 1,024 paths from a weight of 0.6. Near the optimum ln CE falls by
    g sigma^2 T / 2 = 0.81 times the squared error of the weight, so 0.03 costs 0.07 %."""
    simulator, inputs = (
        Merton(),
        Inputs(*(Input(MARKET[n]) for n in ("rate", "drift", "volatility"))),
    )
    training = Training(steps=150, paths=1024, learning_rate=0.03, validation_every=150)
    start = initial_progress(Constant(np.array([0.6], np.float32)), training)
    progress = train(Problem(simulator, inputs, OBJECTIVE), start, training, Xla())
    assert progress.status == "trained"
    found = float(progress.average.value[0])
    assert found == pytest.approx(WEIGHT, abs=0.03)
    assert log_equivalent(found, **MARKET) == pytest.approx(np.log(EQUIVALENT), abs=1e-3)
