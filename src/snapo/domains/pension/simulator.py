"""One path of a pension fund: markets move, members are paid, the fund rebalances.

Order within a step: the liability is valued and the contribution set; payments in advance; the
fund trades; a step of the market; payments in arrears; indexation. Money counts when it is paid,
and present values discount by what cash has earned on the path until then.

Signs: contributions are received, benefits, expenses and costs are paid; all are positive.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...simulator import Box, Schedule, Simulator
from .market import Market, log_factor, move, noise_size
from .observation import observe
from .plan import contribution, indexation
from .records import PensionCase
from .schedule import Period, Terms, make_schedule
from .trading import trade

# Of the last step or the end of the horizon: ratio F, ln(F / F now), A - L, min(F - 1, 0) …
AT_END = (
    "funding_ratio",
    "log_relative",
    "surplus",
    "surplus_ratio",
    "assets",
    "liability",
    "pv_assets",
    "pv_liability",
    "discount",
    "pv_shortfall",
)
# Sums over the steps; "pv_" discounts, "_square" is of 1 - F below 1 and per year, "normal_cost"
# the value of what accrues, "granted" and "cut" the indexation; "funding" is F before each step,
# "bound_excess" by how much weights leave their bounds.
EACH_STEP = (
    "contribution",
    "benefit",
    "expenses",
    "cost",
    "normal_cost",
    "granted",
    "cut",
    "pv_contribution",
    "pv_benefit",
    "pv_expenses",
    "pv_cost",
    "pv_accrual",
    "pv_indexation",
    "shortfall_square",
    "collateral_shortfall",
    "funding",
    "bound_excess",
)
OUTPUTS = AT_END + EACH_STEP
LEAST = 1e-6  # of the assets now: the liability counts as at least this much in ratios


class State(NamedTuple):
    """The fund at the start of a step.

    `assets` money; `weights` [n] as drifted; `overlay` [b] notionals over assets, or None; `theta`
    cumulated indexation; `fresh` the ratio a of rights accrued since time 0 to their baseline;
    `deaths` y, the log of what mortality has taken beyond the baseline; `log_price_last` at the
    last indexation; `ratio_sum` towards the policy ratio; `jump` ln of the last indexation beyond
    what was valued already.
    """

    market: Market
    assets: Array
    weights: Array
    overlay: Array | None
    theta: Array
    fresh: Array
    deaths: Array
    log_price_last: Array
    ratio_sum: Array
    jump: Array


class Balance(NamedTuple):
    """Value of the liability, its payment nodes [J], of the step's accrual; the funding ratio F."""

    liability: Array
    by_node: Array
    accrual: Array
    ratio: Array


class PensionSimulator(Simulator):
    """The fund of a case; see `snapo.domains.pension.records` for its terms."""

    case: PensionCase = eqx.field(static=True)

    @property
    def horizon(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.case.steps

    @property
    def action(self) -> Box:  # pyright: ignore[reportIncompatibleVariableOverride]
        return Box(len(self.case.assets.classes) + self.case.buckets, 0.0, 1.0)

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return noise_size(self.case)

    def prepare(self, inputs: dict[str, Any]) -> Schedule:
        return make_schedule(self.case, inputs)

    def initial(self, constants: Terms, noise) -> State:
        zero, one = jnp.zeros_like(constants.assets), jnp.ones_like(constants.assets)
        swaps = constants.swaps
        return State(
            market=constants.market.start,
            assets=constants.assets,
            weights=constants.weight,
            overlay=None if swaps is None else swaps.notional / constants.assets,
            theta=one,
            fresh=one,
            deaths=zero,
            log_price_last=zero,
            ratio_sum=zero,
            jump=zero,
        )

    def observe(self, constants: Terms, now: Period, state: State) -> Float[Array, " features"]:
        ratio = self.balance(constants, now.people, now.shape, state).ratio
        return observe(self.case, constants, now, state, ratio)

    def balance(self, constants: Terms, people, shape: Array, state: State) -> Balance:
        """Values on the case's basis, at the market of `state`."""
        market = state.market
        factor = log_factor(constants.market, shape, market)
        if self.case.lee_carter is not None:
            factor = factor - people.outlook * market.mortality
        scale = jnp.log(state.theta) - state.deaths
        if self.case.liability.future_indexation == "full":
            # Increases are due that prices have called for and no indexation has granted yet.
            scale = scale + market.log_price - state.log_price_last
        factor, scale = jnp.exp(factor), jnp.exp(scale)
        by_node = scale * (people.accrued + state.fresh * people.fresh) * factor
        liability = jnp.sum(by_node)
        wage = jnp.exp(market.log_wage) / state.theta
        accrual = scale * wage * jnp.sum(people.accrual * factor)
        return Balance(liability, by_node, accrual, self.ratio(constants, state, liability))

    def ratio(self, constants: Terms, state: State, liability: Array) -> Array:
        """Assets over liability; a fund without liabilities has a large one."""
        least = LEAST * constants.assets
        return state.assets / jnp.where(liability > least, liability, least)

    def step(self, constants: Terms, now: Period, state: State, action, noise, smooth):
        case, people, market = self.case, now.people, state.market
        in_advance = case.plan.timing == "advance"
        books = self.balance(constants, people, now.shape, state)
        wage, price = jnp.exp(market.log_wage), jnp.exp(market.log_price)
        received = contribution(
            case.plan,
            constants.plan,
            assets=state.assets,
            liability=books.liability,
            normal_cost=books.accrual,
            payroll=people.payroll,
            wage=wage,
            step=case.step,
            smooth=smooth,
        )
        alive = state.theta * jnp.exp(-state.deaths)
        benefit = alive * (people.benefit + state.fresh * people.fresh_benefit)
        expenses = people.expenses * price
        flow = received - benefit - expenses
        invested = state.assets + flow if in_advance else state.assets
        buckets = None if constants.swaps is None else constants.swaps.nearest @ books.by_node
        held = trade(case, constants, state, action, invested, buckets, smooth)
        moved = move(case, constants.market, now.market, market, noise)
        growth = jnp.sum(held.weights * moved.gross)
        assets = (invested - held.cost) * growth
        if held.notional is not None:
            returned = jnp.exp(moved.cash) * jnp.expm1(moved.swaps)
            assets = assets + jnp.sum(held.notional * returned)
        assets = assets if in_advance else assets + flow
        overlay = None
        if held.notional is not None:
            rolled = held.notional * jnp.exp(moved.cash + moved.swaps)
            overlay = rolled / jnp.where(
                assets > LEAST * constants.assets, assets, constants.assets
            )
        after, granted, cut = self._indexed(constants, now, state, books, moved.market, smooth)
        after = after._replace(
            assets=assets, weights=held.weights * moved.gross / growth, overlay=overlay
        )
        before = jnp.exp(market.log_discount)
        paid = before if in_advance else jnp.exp(moved.market.log_discount)
        below = smooth.positive_part(1 - books.ratio, 0.1)
        return after, {
            "contribution": received,
            "benefit": benefit,
            "expenses": expenses,
            "cost": held.cost,
            "normal_cost": books.accrual,
            "granted": granted,
            "cut": cut,
            "pv_contribution": paid * received,
            "pv_benefit": paid * benefit,
            "pv_expenses": paid * expenses,
            "pv_cost": before * held.cost,
            "pv_accrual": before * books.accrual,
            "pv_indexation": self._indexation_value(before, books, state),
            "shortfall_square": case.step * below**2,
            "collateral_shortfall": case.step * held.collateral_shortfall / constants.assets,
            "funding": books.ratio,
            "bound_excess": held.bound_excess,
        }

    def _indexed(self, constants: Terms, now: Period, state: State, books, market, smooth):
        """The state at the end of a step but for assets, and what was granted and cut."""
        case, people = self.case, now.people
        rule = case.plan.indexation
        theta, last = state.theta, state.log_price_last
        granted = cut = jump = jnp.zeros_like(theta)
        ratio_sum = state.ratio_sum + now.averaging * books.ratio
        if rule.kind != "none" or rule.cut_years:
            given = indexation(
                case.plan,
                constants.plan,
                ratio=ratio_sum,
                price_growth=jnp.expm1(market.log_price - last),
                smooth=smooth,
            )
            granted, cut = (now.due * each for each in given)
            theta = theta * (1 + granted - cut)
            jump = jnp.log1p(granted - cut)
            if case.liability.future_indexation == "full":
                jump = jump - now.due * (market.log_price - last)
            last = last + now.due * (market.log_price - last)
        wage = jnp.exp(state.market.log_wage) / state.theta
        fresh = state.fresh + people.mix * (wage / people.baseline - state.fresh)
        deaths = state.deaths
        if case.lee_carter is not None:
            deaths = deaths + people.decline * state.market.mortality
        after = State(
            market=market,
            assets=state.assets,
            weights=state.weights,
            overlay=state.overlay,
            theta=theta,
            fresh=fresh,
            deaths=deaths,
            log_price_last=last,
            ratio_sum=ratio_sum * (1 - now.due),
            jump=jump,
        )
        return after, granted, cut

    @staticmethod
    def _indexation_value(discount: Array, books: Balance, state: State) -> Array:
        """Present value of the indexation that the last step ended with."""
        return discount * books.liability * -jnp.expm1(-state.jump)

    def terminal(self, constants: Terms, state: State, smooth):
        books = self.balance(constants, constants.last, constants.last_shape, state)
        discount = jnp.exp(state.market.log_discount)
        surplus = state.assets - books.liability
        ratio = jnp.where(books.ratio > 1e-3, books.ratio, 1e-3)
        start = constants.assets / jnp.maximum(constants.liability, LEAST * constants.assets)
        short = smooth.positive_part(-surplus, 0.1 * constants.assets)
        return {
            "funding_ratio": books.ratio,
            "log_relative": jnp.log(ratio / start),
            "surplus": surplus,
            "surplus_ratio": -smooth.positive_part(1 - books.ratio, 0.1),
            "assets": state.assets,
            "liability": books.liability,
            "pv_assets": discount * state.assets,
            "pv_liability": discount * books.liability,
            "discount": discount,
            "pv_shortfall": discount * short,
            "pv_indexation": self._indexation_value(discount, books, state),
        }

    def totals(self):
        return {"funding": "last", "bound_excess": "max"}

    def slack(self, constants: Terms, now: Period, state: State, outputs):
        found = {"weights": -outputs["bound_excess"]}
        if constants.swaps is not None:
            found["collateral"] = -outputs["collateral_shortfall"]
        return found
