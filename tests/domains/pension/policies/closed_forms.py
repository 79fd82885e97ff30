"""Closed forms of known problems: optimal weights under CRRA."""

import math
from typing import NamedTuple


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
