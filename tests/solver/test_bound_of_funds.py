"""Bounds from above of three funds with closed forms: power utility, quadratic cost, no choice.

Everything is homogeneous in the state, so each inner problem keeps one number a path: the worth of
the best decisions in hindsight is that number times the utility, or the square, of the state.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.solver import test_constant_mix as mix
from tests.solver import test_funding as funding
from tests.solver.test_merton import EQUIVALENT, GAMMA, MARKET, OBJECTIVE, UTILITY, WEIGHT, Inputs
from tests.solver.test_merton import Merton as MertonOfTest

from snapo import Input, Mean, Problem
from snapo.problem.policies.rules import Constant, Linear
from snapo.problem.scenarios import Pseudo, Sources
from snapo.solver.bound import Bound, bound

SOURCES = Sources.of(Pseudo(3))


def of_all_steps(rolled, name: str) -> np.ndarray:
    """[T, N] a number of the state after every step."""
    states = np.asarray(rolled.record["state"][name], np.float64)[1:]
    return np.concatenate([states, np.asarray(rolled.state[name], np.float64)[None]])


# Merton's problem: weights of a stock between 0 and 1, power utility.

GRID = np.linspace(0, 1, 401)
CASH = np.exp(MARKET["rate"] / 12)
SHOCK = MARKET["volatility"] / np.sqrt(12)
NODES, SHARES = np.polynomial.hermite_e.hermegauss(60)
EXCESS = np.exp((MARKET["drift"] - MARKET["volatility"] ** 2 / 2) / 12 + SHOCK * NODES) - CASH
SHARES = SHARES / np.sqrt(2 * np.pi)


def moment(weight) -> np.ndarray:
    """E[(a month's growth)^(1 - g)] for weights of the stock."""
    return (CASH + np.multiply.outer(weight, EXCESS)) ** (1 - GAMMA) @ SHARES


class Merton(MertonOfTest):
    """With the stock's excess return of the month in the state."""

    def initial(self, constants, noise):
        return {"wealth": jnp.ones(()), "excess": jnp.zeros(())}

    def observe(self, constants, now, state):
        return state["wealth"][None]

    def step(self, constants, now, state, action, noise, smooth):
        wealth, _ = super().step(constants, now, state["wealth"], action, noise, smooth)
        all_stock, _ = super().step(constants, now, jnp.ones(()), jnp.ones(1), noise, smooth)
        excess = all_stock - jnp.exp(constants.rate / 12)
        return {"wealth": wealth, "excess": excess}, {}

    def terminal(self, constants, state, smooth):
        return {"wealth": state["wealth"]}


class OfPower:
    """Penalties: the surprises of C_t W^(1 - g) / (1 - g), where C_t belongs to one weight."""

    terms, description = 1, "the surprises of a power of wealth"

    def __init__(self, weight: float = WEIGHT):
        self.factor = float(moment(weight))

    def best(self, rolled, draws, scale):
        """c_t = min over weights of (c - s C) R^(1 - g) + s C E[R^(1 - g)], from the end.

        Between the grid's weights a curve lies at most its curvature times an eighth of their
        distance's square lower; that is taken off, so that the bound is one.
        """
        excess = of_all_steps(rolled, "excess")
        found, ahead, room = np.ones(excess.shape[1]), 1.0, (GRID[1] - GRID[0]) ** 2 / 8
        bends = GAMMA * (GAMMA - 1)
        mean_bend = bends * float(SHARES @ (EXCESS**2 * np.minimum(1, CASH + EXCESS) ** -6))
        for month in reversed(excess):
            growth = CASH + np.multiply.outer(GRID, month)
            kept, charged = found - scale[0] * ahead, scale[0] * ahead
            curves = kept * growth ** (1 - GAMMA) + charged * moment(GRID)[:, None]
            bend = np.abs(kept) * bends * month**2 * growth.min(0) ** (-1 - GAMMA)
            found = curves.min(0) - room * (bend + charged * mean_bend)
            ahead *= self.factor
        return found * UTILITY(np.ones(1))

    def charged(self, rolled, draws, scale):
        after, excess = of_all_steps(rolled, "wealth"), of_all_steps(rolled, "excess")
        wealth = np.asarray(rolled.record["state"]["wealth"], np.float64)
        expected = moment((after / wealth - CASH) / excess)
        ahead = self.factor ** np.arange(len(after))[::-1, None]
        return scale[0] * np.sum(ahead * (UTILITY(after) - UTILITY(wealth) * expected), axis=0)


def merton(weight: float, relaxation: OfPower, **options) -> Bound:
    given = Inputs(*(Input(MARKET[name]) for name in ("rate", "drift", "volatility")))
    problem = Problem(Merton(), given, OBJECTIVE, SOURCES)
    return bound(problem, Constant(np.array([weight])), relaxation=relaxation, paths=512, **options)


def equivalent(utility: float) -> float:
    return UTILITY.certainty_equivalent(utility)


@pytest.mark.prove
def test_power_utility_is_certified_within_a_thousandth_of_its_certainty_equivalent():
    found = merton(WEIGHT, OfPower())
    assert equivalent(found.lower.low) <= EQUIVALENT * (1 + 1e-8)
    assert EQUIVALENT <= equivalent(found.upper.high) < 1.001 * EQUIVALENT
    assert equivalent(found.upper.value) / equivalent(found.lower.value) < 1.001


@pytest.mark.prove
@pytest.mark.parametrize("weight", [0.0, 0.6])
def test_a_wrong_power_or_policy_is_wide_and_never_wrong(weight):
    exact = UTILITY(np.array([EQUIVALENT]))[0]
    wrong = merton(WEIGHT, OfPower(weight))
    assert wrong.upper.high >= exact and wrong.gap.value > 10 * merton(WEIGHT, OfPower()).gap.value
    poor = merton(weight, OfPower())
    assert equivalent(poor.lower.high) < 0.99 * EQUIVALENT
    assert poor.upper.high >= exact
    foresight = merton(WEIGHT, OfPower(), penalty="none")
    assert equivalent(foresight.upper.value) > 1.2 * EQUIVALENT


# Linear-quadratic funding: contributions and stocks without limits.


class Funding(funding.Funding):
    """With the stock's excess return of the month in the state."""

    def initial(self, constants, noise):
        return {"x": super().initial(constants, noise), "excess": jnp.zeros(())}

    def observe(self, constants, now, state):
        return super().observe(constants, now, state["x"])

    def step(self, constants, now, state, action, noise, smooth):
        x, cost = super().step(constants, now, state["x"], action, noise, smooth)
        excess = jnp.exp(constants["drift"] + constants["shock"] * noise[0]) - constants["cash"]
        return {"x": x, "excess": excess}, cost


class OfSquare:
    """Penalties: the surprises of `wrong` v_t X^2, discounted; v_t by the exact recursion."""

    terms, description = 1, "the surprises of a square"

    def __init__(self, wrong: float = 1.0):
        h, r, mu, sigma = 1 / 12, funding.R, funding.MU, funding.SIGMA
        self.cash, self.discount = np.exp(r * h), np.exp(-r * h)
        self.first = np.exp(mu * h) - self.cash
        both = np.exp((2 * mu + sigma**2) * h) - 2 * self.cash * np.exp(mu * h) + self.cash**2
        self.second = both
        months = range(funding.MONTHS + 1)
        # The recursion's value of a start of 1, by the months that are left.
        self.v = np.array([funding.recursion(months=n, start=1.0)[2] for n in months]) * wrong

    def best(self, rolled, draws, scale):
        """c_t = min over s, p of the month's cost and c - S v of the path, S v of all paths."""
        excess = of_all_steps(rolled, "excess")
        found, h = np.zeros(excess.shape[1]), 1 / 12
        for left, month in enumerate(reversed(excess)):
            charged = scale[0] * self.v[left]
            kept = found - charged
            # Quadratic in p: kept (y G + p e)^2 + charged E[(y G + p e)^2], y = 1 + s h.
            square = kept * month**2 + charged * self.second
            cross = kept * month + charged * self.first
            assert (square > 0).all() or not charged
            slope = np.where(square > 0, cross**2 / np.where(square > 0, square, 1.0), 0.0)
            ahead = self.discount * self.cash**2 * (kept + charged - slope)
            s = -ahead / (funding.KAPPA + ahead * h)
            cost = h * (funding.KAPPA * s**2 + 1 - funding.KAPPA)
            found = cost + ahead * (1 + s * h) ** 2
        return -found * funding.START**2

    def charged(self, rolled, draws, scale):
        after = of_all_steps(rolled, "x")
        x = np.asarray(rolled.record["state"]["x"], np.float64)
        gains = np.asarray(self.gains, np.float32).astype(float)  # as the policy keeps them
        base, stocks = x * (1 + gains[0] / 12) * self.cash, gains[1] * x
        expected = base**2 + 2 * base * stocks * self.first + stocks**2 * self.second
        ahead = self.v[: len(x)][::-1, None] * self.discount ** np.arange(1, len(x) + 1)[:, None]
        return -scale[0] * np.sum(ahead * (after**2 - expected), axis=0)


def funded(gains: tuple[float, float], wrong: float = 1.0) -> Bound:
    problem = Problem(Funding(), funding.inputs(), funding.COST, SOURCES)
    relaxation = OfSquare(wrong)
    relaxation.gains = gains
    return bound(problem, Linear(np.array(gains)[:, None]), relaxation=relaxation, paths=512)


@pytest.mark.prove
def test_quadratic_funding_is_certified_within_a_thousandth():
    """One rule for all months loses below .1 % to gains that fall to zero at the end."""
    s, p, cost = funding.recursion()
    found = funded((s, p))
    assert -found.lower.low >= cost * (1 - 1e-9) and found.upper.high >= -cost * (1 + 1e-9)
    assert found.upper.value == pytest.approx(-cost, rel=1e-9)
    assert found.gap.value < 1e-3 * cost


@pytest.mark.prove
def test_a_wrong_square_is_wide_and_never_wrong():
    s, p, cost = funding.recursion()
    assert funded((s / 2, p / 2)).gap.value > 0.05 * cost
    found = funded((s, p), wrong=0.8)
    assert found.upper.high >= -cost and found.gap.value > 0.005 * cost


# A constant mix with an outflow: nothing to choose, and the exact value as a control.


class OfMix:
    """The one mix there is: its assets, less the surprises of their conditional mean."""

    terms, description = 1, "the surprises of the expected assets"

    def __init__(self):
        self.mean = 0.5 * np.exp(np.array([0.06, 0.03]) / 12).sum()

    def best(self, rolled, draws, scale):
        return np.asarray(rolled.state, np.float64) - self.charged(rolled, draws, scale)

    def charged(self, rolled, draws, scale):
        assets = np.asarray(rolled.record["state"], np.float64)
        after = np.concatenate([assets[1:], np.asarray(rolled.state, np.float64)[None]])
        ahead = self.mean ** np.arange(len(assets))[::-1, None]
        return scale[0] * np.sum(ahead * (after - (assets * self.mean - 0.5)), axis=0)


@pytest.mark.prove
def test_a_fund_without_a_choice_lies_on_its_closed_form():
    problem = Problem(mix.Mix(), mix.inputs(), Mean("assets"), SOURCES)
    found = bound(problem, mix.MIX, relaxation=OfMix(), paths=128)
    for each in (found.lower, found.upper):
        assert each.value == pytest.approx(81.20917249, abs=1e-8)
        assert each.standard_error < 1e-9
    assert found.gap.value == 0
