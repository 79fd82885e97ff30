"""Thirty assets within limits: a risk-averse investor rebalances each month and pays for trading.

Weights meet an upper limit for each asset and a range for each group (equities, bonds, others), and
add up to one by construction. The objective is the expected CRRA utility of wealth after five
years.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import snapo
from snapo.problem.objective import Objective

ASSETS, MONTHS = 30, 60
EQUITIES, BONDS, OTHERS = tuple(range(15)), tuple(range(15, 25)), tuple(range(25, 30))


class Inputs(eqx.Module):
    """The differentiable inputs: mean and volatility of each asset (a year), costs, and limits."""

    mean: snapo.Input
    volatility: snapo.Input
    momentum: snapo.Input
    cost: snapo.Input
    most: snapo.Input
    equity_range: snapo.Input
    bond_range: snapo.Input


class Portfolio(snapo.Simulator):
    """One path. State: weights after the month's returns, wealth, and a slow market signal.

    `loadings` [30, 4] are the correlations of each asset with three market factors and the signal.
    The rest of the variance of an asset is independent of the other assets.
    """

    loadings: np.ndarray
    horizon: int = MONTHS
    action: snapo.Box = snapo.Box(-np.inf, np.inf, ASSETS)
    noise_size: int = ASSETS + 4

    def prepare(self, inputs: Inputs) -> snapo.Schedule:
        month = 1 / 12
        own = jnp.sqrt(1 - jnp.sum(self.loadings**2, axis=1))
        constants = {
            "drift": (inputs.mean - inputs.volatility**2 / 2) * month,
            "systematic": inputs.volatility[:, None] * self.loadings * jnp.sqrt(month),
            "own": inputs.volatility * own * jnp.sqrt(month),
            "momentum": inputs.momentum * month,
            "cost": inputs.cost,
            "most": inputs.most,
            "equities": inputs.equity_range,
            "bonds": inputs.bond_range,
        }
        return snapo.Schedule(constants, {"left": 1 - jnp.arange(MONTHS) / MONTHS})

    def initial(self, constants, noise):
        like = constants["drift"]
        return {
            "weights": jnp.full(ASSETS, 1 / ASSETS, like.dtype),
            "wealth": jnp.ones_like(like[0]),
            "signal": jnp.zeros_like(like[0]),
        }

    def observe(self, constants, now, state):
        drifted = ASSETS * state["weights"] - 1
        return jnp.concatenate([drifted, jnp.stack([now["left"], state["signal"]])])

    def step(self, constants, now, state, action, noise, smooth):
        c = constants
        groups = ((EQUITIES, *c["equities"]), (BONDS, *c["bonds"]), (OTHERS, 0.0, 1.0))
        weights = smooth.simplex(action, 0.0, c["most"], groups)
        traded = jnp.sum(smooth.absolute(weights - state["weights"], scale=1 / ASSETS))
        paid = c["cost"] * traded
        factors, own = noise[:4], noise[4:]
        # One unit of the signal raises the expected return of equities in a month by `momentum`.
        lift = c["momentum"] * state["signal"] * (jnp.arange(ASSETS) < len(EQUITIES))
        growth = jnp.exp(c["drift"] + lift + c["systematic"] @ factors + c["own"] * own)
        gross = jnp.sum(weights * growth)
        after = {
            "weights": weights * growth / gross,
            "wealth": state["wealth"] * (1 - paid) * gross,
            "signal": 0.9 * state["signal"] + jnp.sqrt(1 - 0.81) * factors[3],
        }
        return after, {"turnover": traded, "equity_share": weights[: len(EQUITIES)].sum() / MONTHS}

    def terminal(self, constants, state, smooth):
        return {"wealth": state["wealth"]}


def simulator() -> Portfolio:
    """Equities share a market factor and bonds a rate factor; other assets depend on both.

    The signal predicts the returns of equities.
    """
    loadings = np.zeros((ASSETS, 4))
    loadings[list(EQUITIES)] = (0.65, 0.0, 0.25, 0.10)
    loadings[list(BONDS)] = (-0.10, 0.80, 0.0, 0.0)
    loadings[list(OTHERS)] = (0.35, 0.15, 0.30, 0.0)
    return Portfolio(loadings)


def inputs() -> Inputs:
    """Means and volatilities a year: equities 5 to 7 % and 16 to 24 %, bonds 2.5 to 3.5 % and 4 to
    8 %, others between the two.
    """

    def between(low, high, count):
        return np.linspace(low, high, count)

    mean = [*between(0.05, 0.07, 15), *between(0.025, 0.035, 10), *between(0.04, 0.05, 5)]
    volatility = [*between(0.16, 0.24, 15), *between(0.04, 0.08, 10), *between(0.10, 0.15, 5)]
    groups = (("equity", EQUITIES), ("bond", BONDS), ("other", OTHERS))
    names = [f"{name} {i + 1}" for name, members in groups for i in range(len(members))]
    return Inputs(
        mean=snapo.Input(mean, "per year", names),
        volatility=snapo.Input(volatility, "per sqrt(year)", names),
        momentum=snapo.Input(0.04, "per year and unit of signal"),
        cost=snapo.Input(0.002, "of the amount traded"),
        most=snapo.Input(np.full(ASSETS, 0.10), "share", names),
        equity_range=snapo.Input([0.20, 0.60], "share", ("least", "most")),
        bond_range=snapo.Input([0.20, 0.60], "share", ("least", "most")),
    )


def objective() -> Objective:
    """Expected utility with a constant relative risk aversion of 5."""
    return snapo.ExpectedUtility("wealth", snapo.CRRA(5.0))


if __name__ == "__main__":
    print(snapo.solve(simulator(), inputs(), objective=objective()))
