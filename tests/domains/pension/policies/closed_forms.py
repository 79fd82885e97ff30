"""Closed forms of known problems: optimal weights under CRRA, and a policy that follows them."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.domains.pension.fund.observation import slots
from snapo.domains.pension.policies.allocation import AllocationLimits
from snapo.domains.pension.records.case import PensionCase
from snapo.problem.policy import Policy, as_observation
from snapo.problem.smooth import EXACT


def merton(excess: float, volatility: float, risk_aversion: float) -> float:
    """The stock's weight under CRRA and constant opportunities: excess / (gamma sigma^2).

    `excess` is the stock's mean growth over cash, per year and continuous (R. Merton, Review of
    Economics and Statistics 51, 1969).
    """
    return excess / (risk_aversion * volatility**2)


class StockAndBond(NamedTuple):
    """Weights; the rest is cash."""

    stock: float
    bond: float


def vasicek_stock_bond(
    mean_reversion: float,
    rate_volatility: float,
    rate_price: float,
    excess: float,
    volatility: float,
    correlation: float,
    risk_aversion: float,
    horizon: float,
    maturity: float,
) -> StockAndBond:
    """CRRA of wealth after `horizon` years with Vasicek rates, a stock and a bond of `maturity`.

    Exposure to the two sources of risk is the price of risk over gamma, plus (1 - 1 / gamma) times
    that of the bond that pays at the horizon (C. Sorensen, Journal of Financial and Quantitative
    Analysis 34, 1999). `excess` of the stock and `correlation` of its shocks with the rate's;
    `rate_price` is negative where bonds earn a premium.
    """

    def reach(years: float) -> float:
        return -math.expm1(-mean_reversion * years) / mean_reversion

    alone = math.sqrt(1 - correlation**2)
    own_price = (excess / volatility - correlation * rate_price) / alone
    stock = own_price / (risk_aversion * volatility * alone)
    requested = rate_price / risk_aversion
    requested -= (1 - 1 / risk_aversion) * rate_volatility * reach(horizon)
    left = requested - stock * volatility * correlation
    return StockAndBond(stock, -left / (rate_volatility * reach(maturity)))


class StockBond(Policy):
    """The rule of `vasicek_stock_bond` for one stock and one bond, by time left; the rest is cash.

    `weights` [years, 2] of stock and bond with 0, 1, 2 … years left, linear between.
    """

    limits: AllocationLimits
    weights: Array
    stock: int = eqx.field(static=True)
    bond: int = eqx.field(static=True)
    cash: int = eqx.field(static=True)
    slot: int = eqx.field(static=True)
    years: float = eqx.field(static=True)

    def __init__(self, case: PensionCase, rule, stock: int, bond: int):
        self.limits, self.stock, self.bond = AllocationLimits(case), stock, bond
        self.cash = case.assets.cash
        self.slot, self.years = slots(case)["time"].start, case.steps * case.step
        left = np.arange(math.ceil(self.years) + 1)
        self.weights = jnp.asarray([rule(float(item)) for item in left], jnp.float32)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        left = self.years * (1 - observation[self.slot]) / 2
        table = self.weights.astype(observation.dtype)
        nodes = np.arange(table.shape[0])
        near = jnp.maximum(1 - jnp.abs(left - nodes), 0.0) @ table
        positions = np.arange(self.limits.low.array.shape[0])
        requested = near[0] * (positions == self.stock) + near[1] * (positions == self.bond)
        requested = requested + (1 - near[0] - near[1]) * (positions == self.cash)
        return self.limits.nearest(requested, smooth)
