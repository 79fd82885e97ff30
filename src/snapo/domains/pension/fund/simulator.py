"""One path of a pension fund: markets move, members are paid, the fund rebalances.

Order within a step: the liability is valued and the contribution is set; payments in advance are
made; the fund trades; the market moves; payments in arrears are made; rights are indexed. Money
counts when it is paid, and present values discount by the return of cash on the path until then.

Signs: contributions are received, benefits, expenses and costs are paid; all are positive.
"""

from dataclasses import replace
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Box
from snapo.problem.form import without_uses
from snapo.problem.simulator import Schedule, Simulator

from ..market.dynamics import move, noise_size
from ..market.state import Move
from ..people.lpi import factor_width, limited
from ..people.mortality import divided
from ..records.case import DerivedNumbers, PensionCase, PensionModel
from ..records.inputs import model_of
from .books import MINIMUM, FundBalance, FundState, balance, opening
from .collateral import eligible
from .observation import observe
from .plan import contribution, indexation
from .schedule import FundTerms, Period, annual_bond, make_schedule, valued_years
from .terms import scales
from .trading import Holdings, drifted, trade


class FundFlows(NamedTuple):
    """Money of a step: contributions received, benefits and expenses paid."""

    contribution: Array
    benefit: Array
    expenses: Array

    @property
    def net(self) -> Array:
        return self.contribution - self.benefit - self.expenses


class Happened(NamedTuple):
    """The parts of a step: the `books` before it, the payments (`flows`), the sum `invested`, the
    holdings `held`, the market's `move`, the state `after` it, and the indexation `granted` and
    `cut` at its end."""

    books: FundBalance
    flows: FundFlows
    invested: Array
    held: Holdings
    move: Move
    after: FundState
    granted: Array
    cut: Array


def actions(case: PensionCase) -> Box:
    """The space of actions: weights, then the positions of the swap notionals in their ranges."""
    assets, swaps = case.assets, np.zeros(case.buckets)
    if not assets.short:
        return Box(0.0, 1.0, len(assets.classes) + case.buckets)
    low = np.concatenate([np.minimum(assets.low, 0.0), swaps])
    return Box(low, np.concatenate([np.maximum(assets.high, 1.0), swaps + 1]), len(low))


def derived(case: PensionCase) -> DerivedNumbers:
    """The derived numbers of the case, which a simulator contains."""
    basis = case.liability
    spread = basis.annual and basis.basis == "spread"
    return DerivedNumbers(
        eligible(case),
        scales(case),
        np.asarray(factor_width(case)),
        divided(case),
        annual_bond(case, valued_years(case)) if spread else None,
    )


class PensionSimulator(Simulator):
    """The fund of a case; see `snapo.domains.pension.records` for its terms.

    It contains no case: two funds of the same form differ only in arrays and inputs. The schedule
    has the numbers that a step reads.
    """

    model: PensionModel
    action: Box = eqx.field(static=True)
    fully_observed = True  # its rules see more, which moves too little to matter

    @classmethod
    def of(cls, case: PensionCase) -> Self:
        """The fund of a case."""
        model = model_of(case, derived(case))
        return cls(model, actions(case))  # pyright: ignore[reportCallIssue]

    def on_paths(self):
        return replace(self, model=jax.tree.map(lambda leaf: None, self.model))

    def on_step(self):
        return replace(self, model=replace(without_uses(self.model), steps=None))

    @property
    def horizon(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.model.steps

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return noise_size(self.model)

    def prepare(self, inputs: dict[str, Any]) -> Schedule:
        return make_schedule(self.model, inputs)

    def initial(self, constants: FundTerms, noise) -> FundState:
        return opening(constants)

    def payments_near(self, constants: FundTerms, now: Period, state: FundState):
        """The value [b] before a step of the payments that are nearest to each swap, in money."""
        books = balance(self.model, constants, now.people, now.shape, state)
        return constants.swaps.nearest @ books.by_node  # pyright: ignore[reportOptionalMemberAccess]

    def observe(
        self, constants: FundTerms, now: Period, state: FundState
    ) -> Float[Array, " features"]:
        books = balance(self.model, constants, now.people, now.shape, state)
        return observe(self.model, constants, now, state, books.ratio)

    def step(self, constants: FundTerms, now: Period, state: FundState, action, noise, smooth):
        done = self.happen(constants, now, state, action, noise, smooth)
        return done.after, self._outputs(constants, state, done, smooth)

    def happen(self, constants: FundTerms, now: Period, state: FundState, action, noise, smooth):
        """One step with all its parts."""
        case = self.model
        books = balance(case, constants, now.people, now.shape, state)
        flows = self._flows(constants, now, state, books, smooth)
        invested = state.assets + flows.net if self._in_advance else state.assets
        buckets = None if constants.swaps is None else constants.swaps.nearest @ books.by_node
        held = trade(case, constants, state, action, invested, buckets, smooth)
        moved = move(case, constants.market, now.market, state.market, noise)
        indexed = self._indexed(constants, now, state, books, moved.market, smooth)
        after = self._settled(constants, indexed[0], flows, invested, held, moved)
        return Happened(books, flows, invested, held, moved, after, *indexed[1:])

    @property
    def _in_advance(self) -> bool:
        return self.model.plan.timing == "advance"

    def _flows(
        self, constants: FundTerms, now: Period, state: FundState, books, smooth
    ) -> FundFlows:
        """The money received and paid; the rules use the books before the step."""
        people, market = now.people, state.market
        received = contribution(
            self.model.plan,
            constants.plan,
            assets=state.assets,
            liability=books.liability,
            normal_cost=books.accrual,
            payroll=people.payroll,
            wage=jnp.exp(market.log_wage),
            step=self.model.step,
            smooth=smooth,
            annuity=now.annuity,
        )
        if now.agreed is not None:
            received = received + now.agreed
        alive = state.theta * jnp.exp(-state.deaths)
        benefit = alive * (people.benefit + state.fresh * people.fresh_benefit)
        return FundFlows(received, benefit, people.expenses * jnp.exp(market.log_price))

    def _settled(
        self, constants: FundTerms, after: FundState, flows, invested, held, move
    ) -> FundState:
        """The state `after` with holdings and payments: assets, drifted weights, notionals."""
        growth = jnp.sum(held.weights * move.gross)
        assets = (invested - held.cost) * growth
        overlay = None
        if held.notional is not None:
            returned = jnp.exp(move.cash) * jnp.expm1(move.swaps)
            assets = assets + jnp.sum(held.notional * returned)
        assets = assets if self._in_advance else assets + flows.net
        if held.notional is not None and constants.swaps is not None:
            minimum = MINIMUM * constants.assets
            # Gains are settled: the notional of a par swap stays, that of others grows with its
            # bond.
            grown = jnp.exp(move.cash + move.swaps)
            rollout = held.notional * jnp.where(constants.swaps.at_par, 1.0, grown)
            overlay = rollout / jnp.where(assets > minimum, assets, constants.assets)
        weights = drifted(self.model.assets, held.weights * move.gross, growth)
        return after._replace(assets=assets, weights=weights, overlay=overlay)

    def _outputs(self, constants: FundTerms, state: FundState, done: Happened, smooth):
        """The named scalars of a step, see `records.case.OUTPUTS`."""
        books, flows, held = done.books, done.flows, done.held
        before = jnp.exp(state.market.log_discount)
        paid = before if self._in_advance else jnp.exp(done.move.market.log_discount)
        below = smooth.positive_part(1 - books.ratio, 0.1)
        return {
            "contribution": flows.contribution,
            "benefit": flows.benefit,
            "expenses": flows.expenses,
            "cost": held.cost,
            "normal_cost": books.accrual,
            "granted": done.granted,
            "cut": done.cut,
            "pv_contribution": paid * flows.contribution,
            "pv_benefit": paid * flows.benefit,
            "pv_expenses": paid * flows.expenses,
            "pv_cost": before * held.cost,
            "pv_accrual": before * books.accrual,
            "pv_indexation": self._indexation_value(before, books, state),
            "shortfall_square": self.model.step * below**2,
            "collateral_shortfall": self.model.step * held.collateral_shortfall / constants.assets,
            "funding": books.ratio,
            "bound_excess": held.bound_excess,
        }

    def _indexed(self, constants: FundTerms, now: Period, state: FundState, books, market, smooth):
        """The state at the end of a step except assets, and the indexation granted and cut."""
        rule = self.model.plan.indexation
        granted = cut = jnp.zeros_like(state.theta)
        ratio_sum = state.ratio_sum + now.averaging * books.ratio
        if rule.kind != "none" or rule.cut_years:
            growth = jnp.expm1(market.log_price - state.log_price_last)
            values = indexation(
                self.model.plan, constants.plan, ratio=ratio_sum, price_growth=growth, smooth=smooth
            )
            granted, cut = (now.due * item for item in values)
        after = self.rights(now, state, market, granted, cut)
        return after._replace(ratio_sum=ratio_sum * (1 - now.due)), granted, cut

    def rights(
        self, now: Period, state: FundState, market, granted: Array, cut: Array
    ) -> FundState:
        """The rights at the end of a step, after an indexation `granted` and `cut`."""
        case, people = self.model, now.people
        theta, last, jump = state.theta, state.log_price_last, jnp.zeros_like(state.theta)
        rule = case.plan.indexation
        if rule.kind != "none" or rule.cut_years:
            theta = theta * (1 + granted - cut)
            jump = jnp.log1p(granted - cut)
            if limited(case):  # the options end as the increase
                jump = jump - jnp.log1p(granted)
            if case.liability.future_indexation == "full":
                jump = jump - now.due * (market.log_price - last)
            last = last + now.due * (market.log_price - last)
        wage = jnp.exp(state.market.log_wage) / state.theta
        fresh = state.fresh + people.mix * (wage / people.baseline - state.fresh)
        deaths = state.deaths
        if case.lee_carter is not None:
            deaths = deaths + people.decline * state.market.mortality
        return state._replace(
            market=market,
            theta=theta,
            fresh=fresh,
            deaths=deaths,
            log_price_last=last,
            jump=jump,
        )

    @staticmethod
    def _indexation_value(discount: Array, books: FundBalance, state: FundState) -> Array:
        """The present value of the indexation at the end of the last step."""
        return discount * books.liability * -jnp.expm1(-state.jump)

    def terminal(self, constants: FundTerms, state: FundState, smooth):
        books = balance(self.model, constants, constants.last, constants.last_shape, state)
        discount = jnp.exp(state.market.log_discount)
        surplus = state.assets - books.liability
        ratio = jnp.where(books.ratio > 1e-3, books.ratio, 1e-3)
        start = constants.assets / jnp.maximum(constants.liability, MINIMUM * constants.assets)
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

    def slack(self, constants: FundTerms, now: Period, state: FundState, outputs):
        table = {"weights": -outputs["bound_excess"]}
        if constants.swaps is not None:
            table["collateral"] = -outputs["collateral_shortfall"]
        return table
