"""Bounds on the rights and payments of a path that hold for all decisions.

Decisions affect rights through indexation only, and contributions through assets and rights. The
smallest rights follow from the smallest increase at every date, the largest from the largest;
contributions are highest without assets and with the largest rights.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.problem.smooth import Exact

from ..fund.books import FundState, balance, opening
from ..fund.plan import contribution, indexation
from ..fund.schedule import FundTerms, Period
from ..fund.simulator import PensionSimulator
from ..market.state import Market

FUNDED = 1e6  # a funding ratio above every limit of a plan


class Extremes(NamedTuple):
    """Extremes of one path: `received` [T] the maximum of contributions minus payments, money;
    `liability` the minimum at the horizon."""

    received: Float[Array, " T"]
    liability: Float[Array, ""]


def extremes(
    simulator: PensionSimulator, terms: FundTerms, steps: Period, before: Market, after: Market
) -> Extremes:
    """The extremes of a path whose markets `before` and `after` each step have leaves [T, …]."""
    case = simulator.model

    def step(rights: tuple[FundState, FundState], values):
        now, market, then = values
        lower, maximum = (right._replace(market=market) for right in rights)
        received = _most_received(simulator, terms, now, lower, maximum)
        bounds = _increases(simulator, terms, now, market, then, lower.log_price_last)
        zero = jnp.zeros_like(bounds[0])
        lowest = simulator.rights(now, lower, then, bounds[0], zero)
        return (lowest, simulator.rights(now, maximum, then, bounds[1], zero)), received

    start = opening(terms)
    (minimum, _), received = jax.lax.scan(step, (start, start), (steps, before, after))
    last = balance(case, terms, terms.last, terms.last_shape, minimum)
    return Extremes(received, last.liability)


def _most_received(
    simulator, terms: FundTerms, now: Period, minimum: FundState, maximum: FundState
) -> Array:
    """Contributions without assets against the most rights, minus benefits on the least."""
    case = simulator.model
    books = balance(case, terms, now.people, now.shape, maximum)
    highest = contribution(
        case.plan,
        terms.plan,
        assets=jnp.zeros_like(terms.assets),
        liability=books.liability,
        normal_cost=books.accrual,
        payroll=now.people.payroll,
        wage=jnp.exp(maximum.market.log_wage),
        step=case.step,
        smooth=Exact(),
        annuity=now.annuity,
    )
    if now.agreed is not None:
        highest = highest + now.agreed
    alive = minimum.theta * jnp.exp(-minimum.deaths)
    benefit = alive * (now.people.benefit + minimum.fresh * now.people.fresh_benefit)
    return highest - benefit - now.people.expenses * jnp.exp(minimum.market.log_price)


def _increases(simulator, terms: FundTerms, now: Period, market: Market, then: Market, last: Array):
    """(least, most) net increase at the end of the step, whatever the funding ratio."""
    rule = simulator.model.plan.indexation
    if rule.kind == "none" and not rule.cut_years:
        return jnp.zeros_like(last), jnp.zeros_like(last)
    growth = jnp.expm1(then.log_price - last)
    poor, rich = (
        indexation(
            simulator.model.plan, terms.plan, ratio=ratio, price_growth=growth, smooth=Exact()
        )
        for ratio in (jnp.zeros_like(growth), jnp.full_like(growth, FUNDED))
    )
    minimum = jnp.minimum(poor[0], rich[0]) - poor[1]
    return now.due * minimum, now.due * jnp.maximum(poor[0], rich[0])
