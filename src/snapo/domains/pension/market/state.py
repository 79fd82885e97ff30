"""The market of one path: its state, the numbers that all paths share, and a step's result."""

from typing import Any, NamedTuple

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import tree_map, xp

LONG = 10.0  # years of the long rate that a policy may see


class Market(NamedTuple):
    """State of the market: `factors` [g] of rates and expected inflation (under ready-made
    scenarios the zero rates of the file), the logarithms of price index and wages, Lee-Carter's k,
    spreads ln(s / mean) [R] or None, appraised returns [q] or None, and the logarithm of the
    discount factor of cash."""

    factors: Array
    log_price: Array
    log_wage: Array
    mortality: Array
    spread: Array | None
    reported: Array | None
    log_discount: Array


class MarketTerms(NamedTuple):
    """The numbers of the whole horizon: `start`: the market at time 0; `slope` [J, g] at the
    payment nodes, with ln P(t, t+u) = shape - `slope` @ factors; `rate_slope` [2, g]: slopes of
    long and short rate. Under ready-made scenarios there is `swap_slope` [2, J, k], for the
    payments of swaps before and after a step; otherwise the numbers of the models, with `shock` [Z,
    Z], `decay`, `reach` [g] and wages (see `dynamics.IndexGrowth`)."""

    start: Market
    slope: Array
    rate_slope: Array
    swap_slope: Any = None
    shock: Any = None
    decay: Any = None
    reach: Any = None
    wage_growth: Any = None
    wage_volatility: Any = None
    mortality_volatility: Any = None
    spreads: Any = None
    assets: Any = None


class MarketSteps(NamedTuple):
    """The numbers of each step t: `rate_level` [T, 2]: long and short rate if the factors are zero;
    the models' shifts of cash and prices; volatilities and drifts of the factors [T, g]."""

    rate_level: Array
    cash_shift: Any = None
    price_shift: Any = None
    index_volatility: Any = None
    volatility: Any = None
    drift: Any = None
    assets: Any = None


class Move(NamedTuple):
    """What happens in one step: the log return of cash, gross returns [n], swaps' log returns over
    cash [b] or None, the market after the step, and for the models the bonds `beneath` (see
    `dynamics.returns`)."""

    cash: Array
    gross: Array
    swaps: Any
    market: Market
    beneath: Any = ()


def at_start(factors: Array, spread: Array | None = None, displayed: Array | None = None) -> Market:
    """The market at time 0."""
    zero = xp.zeros(())
    return Market(factors, zero, zero, zero, spread, displayed, zero)


def log_factor(terms: MarketTerms, shape: Float[Array, " J"], market: Market) -> Array:
    """The logarithm of the factor [J] on a payment's forward value, at the factors of the
    market."""
    return shape - terms.slope @ market.factors


def without_empty(tree: Any) -> Any:
    """The record without arrays of size zero, which represent absent parts of a case."""
    return tree_map(lambda leaf: leaf if leaf.size else None, tree)
