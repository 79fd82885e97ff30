"""Monthly linear-quadratic funding: a trained linear rule finds the optimal gains and value.

X = fund minus liability, X' = (X + SC/12) e^(r/12) + pi (e^((mu - sigma^2/2)/12 + sigma dW) -
e^(r/12)), cost (kappa SC^2 + (1 - kappa) X^2)/12 at the start of the month, discounted at r, 30
years from X = -20. The value is quadratic, v_t X^2, and the optimum linear: with a, b the first
and second moment of the excess return and G = e^(r/12), pi = -G a / b (X + SC/12).
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from snapo.engine import Xla
from snapo.problem.actions import Box
from snapo.problem.inputs import Input
from snapo.problem.objective import Mean
from snapo.problem.policies.rules import Linear
from snapo.problem.problem import Problem, prepare
from snapo.problem.scenarios import Pseudo, Sources
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import value_and_gradient
from snapo.solver.train import Training, initial_progress, train

MONTHS, KAPPA, START = 360, 0.95, -20.0
R, MU, SIGMA = 0.02, 0.06, 0.18
UNIT = 10.0  # actions and observations are of order one: contributions and stocks in tens
COST = -Mean("cost")


class Inputs(eqx.Module):
    rate: Input
    drift: Input
    volatility: Input
    start: Input


def inputs():
    return Inputs(Input(R), Input(MU), Input(SIGMA), Input(START))


class Funding(Simulator):
    """One path; the actions are the yearly supplementary contribution and the stocks held."""

    horizon: int = MONTHS
    action: Box = Box(-np.inf, np.inf, 2)
    noise_size: int = 1

    def prepare(self, inputs):
        discount = jnp.exp(-inputs.rate * jnp.arange(self.horizon) / 12)
        constants = {
            "cash": jnp.exp(inputs.rate / 12),
            "drift": (inputs.drift - inputs.volatility**2 / 2) / 12,
            "shock": inputs.volatility / jnp.sqrt(12.0),
            "start": inputs.start,
        }
        return Schedule(constants, {"discount": discount})

    def initial(self, constants, noise):
        return constants["start"]

    def observe(self, constants, now, state):
        return jnp.stack([state / UNIT])

    def step(self, constants, now, state, action, noise, smooth):
        c, contribution, stocks = constants, UNIT * action[0], UNIT * action[1]
        cost = now["discount"] * (KAPPA * contribution**2 + (1 - KAPPA) * state**2) / 12
        excess = jnp.exp(c["drift"] + c["shock"] * noise[0]) - c["cash"]
        return (state + contribution / 12) * c["cash"] + stocks * excess, {"cost": cost}


def recursion(gains=None, months=MONTHS, r=R, mu=MU, sigma=SIGMA, start=START):
    """The optimal gains of the first month and the value; or the value of stationary gains."""
    growth, h = np.exp(r / 12), 1 / 12
    first = np.exp(mu * h) - growth
    second = np.exp((2 * mu + sigma**2) * h) - 2 * growth * np.exp(mu * h) + growth**2
    share, v, s = growth * first / second, 0.0, 0.0
    for _ in range(months):
        if gains is None:
            next_ = v / growth * growth**2 * (1 - first**2 / second)
            s = -next_ * h / (KAPPA * h + next_ * h**2)
            v = (KAPPA * s**2 + 1 - KAPPA) * h + next_ * (1 + s * h) ** 2
        else:
            s, p = gains
            y = 1 + s * h
            mean = (y * growth) ** 2 + 2 * y * growth * p * first + p**2 * second
            v = (KAPPA * s**2 + 1 - KAPPA) * h + v / growth * mean
    return s, -share * (1 + s * h), v * start**2


def test_the_recursion_is_the_published_one():
    """The digits given. They are those of a horizon without end; thirty years cut 2e-6 of it off,
    and the gains of the first month do not notice."""
    s, p, value = recursion(months=3600)
    assert -s == pytest.approx(0.213289, abs=1e-6)
    assert -p == pytest.approx(1.200034, abs=2e-6)
    assert -p / (1 + s / 12) == pytest.approx(1.221749, abs=2e-6)
    assert value == pytest.approx(82.7165, abs=5e-5)
    assert recursion()[2] == pytest.approx(value, rel=5e-6)


@pytest.mark.prove
def test_value_and_sensitivities_of_a_given_rule():
    """The rule (-.2, -1.1): its cost by the recursion on second moments. 8,192 antithetic paths;
    the cost is heavy-tailed, so within 4 standard errors and 2 %. d cost / d start is exactly
    2 cost / start on every path (everything is linear in the start), to float64's 1e-10."""
    gains = (-0.2, -1.1)
    policy = Linear(np.array(gains)[:, None])
    simulator, scenarios = Funding(), Pseudo(3)
    draws = scenarios.draws(np.arange(8192), simulator)
    totals = Xla(precision="float64").values(
        simulator, policy, prepare(simulator, inputs()), draws, Exact()
    )
    blocks = np.array([totals.totals["cost"][b].mean() for b in scenarios.blocks(8192)])
    error = blocks.std(ddof=1) / np.sqrt(32)
    assert abs(blocks.mean() - recursion(gains)[2]) < 4 * error
    assert error < 0.02 * blocks.mean()
    problem = Problem(simulator, inputs(), COST, Sources.of(scenarios))
    value, gradient = value_and_gradient(problem, policy, paths=512)
    assert float(gradient.inputs["start"]) == pytest.approx(2 * value / START, rel=1e-10)


@pytest.mark.prove
def test_training_finds_the_gains():
    """200 steps of 512 paths from gains of half the optimum: gains within 2 %, value within 0.5 %
    by the recursion, so without sampling error in the comparison. The optimal gains fall to zero
    in the last months, where little cost is left: one rule for all months loses below 0.1 %."""
    simulator = Funding()
    training = Training(
        steps=200, paths=512, learning_rate=0.03, validation_every=200, validation_paths=512
    )
    policy = Linear(np.array([[-0.1], [-0.6]], np.float32), np.zeros(2, np.float32))
    problem = Problem(simulator, inputs(), COST)
    progress = train(problem, initial_progress(policy, training), training, Xla())
    assert progress.status == "trained"
    s, p, best = recursion()
    gains = np.asarray(progress.average.gain)[:, 0]
    np.testing.assert_allclose(gains, [s, p], rtol=0.02)
    assert recursion(tuple(gains))[2] == pytest.approx(best, rel=0.005)
