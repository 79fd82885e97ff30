"""Holdings of a step: weights, swaps, limits of trading, the cost of trading and the collateral
needed.

The action is n weights, then for each swap bucket the position of the notional in its range. Cash
takes the remainder of the other weights, so that any policy finances itself.

Limits apply in this order:

- A class whose weight is within its `band` of the wanted weight is not traded.
- A class with a `max_sale` is sold by at most that share of the holding per year (0: not at all).
- Purchases shrink in proportion until at least the wanted cash is left.
- All trades shrink in proportion to the limit of turnover, which is half the sum of all changes of
  weights, per year.

If weights may be negative, a fund can lose more than it has. A fund without assets holds no
investments and no swaps: it owes its debt in cash, at the short rate, without costs, until
contributions exceed it. Investments go to zero continuously as the assets do, so that money moves
without a jump.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.smooth import Constraints

from ..records.assets import Assets
from ..records.case import PensionModel
from .terms import TradingLimits

LEFT = 1e-3  # of the assets at the start of a step: with less at its end, they are gone
SHARE = 0.01  # width over which the cost of a trade is rounded while training


class Holdings(NamedTuple):
    """`weights` [n]: weights of the assets after trading; `notional` [b]: notionals of the swaps in
    money, or None; `cost`: cost of trading, in money; `bound_excess`: how far the policy's weights
    are outside their bounds (negative inside); `collateral_shortfall`: missing collateral, in
    money."""

    weights: Array
    notional: Array | None
    cost: Array
    bound_excess: Array
    collateral_shortfall: Array


def trade(case: PensionModel, terms, state, action, assets, buckets, smooth) -> Holdings:
    """Trades from the holdings of `state` to those of the action. `assets`: the money to invest;
    `buckets` [b]: the value of the liability payments nearest to each swap."""
    count, cash = len(case.assets.classes), case.assets.cash
    others = action[:count] * (np.arange(count) != cash)
    requested = others + (np.arange(count) == cash) * (1 - jnp.sum(others))
    weights = requested
    limits = terms.limits
    if limits.dealing:
        weights = dealt(cash, limits, requested, state.weights, smooth)
    traded = jnp.sum(terms.cost * smooth.absolute(weights - state.weights, SHARE))
    size = weights
    if case.assets.short:
        # A fee is paid on holdings of either sign.
        either = smooth.absolute(weights, SHARE)
        size = jnp.where(limits.low < 0, either, weights)
    cost = assets * (traded + jnp.sum(terms.fee * size))
    notional, short = None, jnp.zeros_like(assets)
    swaps = terms.swaps
    if swaps is not None:
        notional = _notional(case, swaps, action[count:], assets, buckets, smooth)
        # Holdings minus targets: if nothing is traded, the derivative with respect to the
        # holding is then that of one more.
        change = state.overlay * state.assets / terms.assets - notional / terms.assets
        cost = cost + terms.assets * jnp.sum(swaps.cost * smooth.absolute(change, SHARE))
        gap = swaps.stress.gap(assets * weights, notional)
        short = smooth.positive_part(gap, SHARE * terms.assets)
    held = Holdings(weights, notional, cost, excess(case.assets, limits, requested), short)
    return _while_solvent(case.assets, held, assets) if case.assets.short else held


def _while_solvent(classes: Assets, held: Holdings, assets: Array) -> Holdings:
    """The holdings, or only cash if no `assets` but a debt is left."""
    left = assets > 0
    alone = jnp.asarray(np.arange(len(classes.classes)) == classes.cash, held.weights.dtype)
    return held._replace(
        weights=jnp.where(left, held.weights, alone),
        notional=None if held.notional is None else jnp.where(left, held.notional, 0.0),
        cost=jnp.where(left, held.cost, 0.0),
        collateral_shortfall=jnp.where(left, held.collateral_shortfall, 0.0),
    )


def drifted(classes: Assets, grown: Array, growth: Array) -> Float[Array, " n"]:
    """The weights after a step, computed from `grown` [n], the holdings per unit of the assets
    before the step, and their sum `growth`. If a fund that may borrow has lost all its assets, its
    weight in cash is 1."""
    if not classes.short:
        return grown / growth
    left = growth > LEFT
    alone = jnp.asarray(np.arange(len(classes.classes)) == classes.cash, grown.dtype)
    return jnp.where(left, grown / jnp.where(left, growth, 1.0), alone)


def _notional(case: PensionModel, swaps, action, assets, buckets, smooth) -> Float[Array, " b"]:
    """Notionals within their ranges, scaled down together where leverage would exceed its limit."""
    share = swaps.low + action * (swaps.high - swaps.low)
    unit = assets
    if case.overlay is not None and case.overlay.unit == "liability":
        unit = buckets
    notional = share * unit
    # Leverage counts against the fund's assets; they are above zero wherever this matters.
    total = jnp.sum(smooth.absolute(notional / _positive(assets, 1e-3), SHARE))
    return notional * swaps.leverage / _positive(smooth.maximum(total, swaps.leverage), 1e-9)


def _positive(x: Array, minimum: float) -> Array:
    return jnp.where(x > minimum, x, minimum)


def excess(assets: Assets, limits: TradingLimits, weights: Array) -> Array:
    """The largest amount by which a weight or a group leaves its bounds."""
    largest = jnp.maximum(jnp.max(limits.low - weights), jnp.max(weights - limits.high))
    for i, group in enumerate(assets.groups):
        total = sum(weights[j] for j in group.members)
        over = jnp.maximum(limits.group_low[i] - total, total - limits.group_high[i])
        largest = jnp.maximum(largest, over)
    return largest


NEAR = 0.001  # of a weight, over which corners are rounded while training
NONE = 1e-12  # of the assets: fewer purchases than this are none


def dealt(
    cash: int, limits: TradingLimits, requested: Array, now: Array, smooth: Constraints
) -> Float[Array, " n"]:
    """The weights [n] after trading from the weights `now` [n] towards the `requested` ones [n].
    All three add up to 1."""
    is_cash = np.arange(len(now)) == cash
    move = jnp.where(is_cash, 0.0, requested - now)
    if limits.band is not None:
        far = smooth.indicator(jnp.abs(move) - limits.band, NEAR)
        move = jnp.where(limits.band > 0, far * move, move)
    if limits.max_sale is not None:
        limited = jnp.isfinite(limits.max_sale)
        maximum = jnp.where(limited, limits.max_sale, 0.0) * now
        move = jnp.where(limited, smooth.maximum(move, -maximum, NEAR), move)
    bought = jnp.sum(jnp.maximum(move, 0.0))
    free = now[cash] - requested[cash] - jnp.sum(jnp.minimum(move, 0.0))
    # While training, a class within its band is bought in traces, whose reciprocal has no bounds.
    some = bought > NONE
    room = jnp.where(some, bought, 1.0)
    paid = smooth.clip(free, 0.0, room, NEAR) / room
    move = jnp.where(some & (move > 0), move * paid, move)
    if limits.turnover is not None:
        maximum = limits.turnover
        turnover = (jnp.sum(jnp.abs(move)) + jnp.abs(jnp.sum(move))) / 2
        move = move * maximum / smooth.maximum(turnover, maximum, NEAR)
    return now + move - jnp.where(is_cash, jnp.sum(move), 0.0)
