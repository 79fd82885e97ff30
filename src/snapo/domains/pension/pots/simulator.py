"""One path of a fund of personal pots: the fund invests, and shares its return among cohorts.

Order within a step: contributions go into pots and reserve, and pensions are paid out of pots; the
fund trades; the market moves; the return is shared (`sharing`). At the end of a year the reserve
takes its part and restores pensions in payment; then the pensions of the next year are set to pot
divided by annuity. Pots and reserve add up to the assets at every time.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from snapo.problem.simulator import Schedule

from ..fund.books import FundState, balance, opening
from ..fund.observation import RATIO, observe
from ..fund.plan import contribution
from ..fund.simulator import FundFlows, Happened, PensionSimulator
from ..fund.trading import trade
from ..market.dynamics import move
from ..market.state import log_factor
from ..records.case import PensionCase
from ..records.pots import pensions
from .schedule import PotPeriod, PotTerms, annuity_values, pot_schedule
from .sharing import SharedResult, closed, shared

RESERVE = 0.1  # of the assets: a number of order one of the reserve, as the policy sees it
MINIMUM = 1e-9  # of an annuity of today, below which a cohort has no more payments


class PotState(NamedTuple):
    """The `fund` with its market and holdings; `pots` [C] and `reserve`: money; `level` [C]: the
    pensions of this year as multiples of those earned at time 0; `gained`: the excess return of
    the year so far."""

    fund: FundState
    pots: Array
    reserve: Array
    level: Array
    gained: Array

    @property
    def weights(self) -> Array:
        """The weights [n] of the fund after their drift."""
        return self.fund.weights


class Paid(NamedTuple):
    """Money paid in and out in a step: the `flows` of the fund, and those of each pot [C] and of
    the reserve."""

    flows: FundFlows
    pots: Array
    reserve: Array


class PotSimulator(PensionSimulator):
    """The fund of a case with `[pots]`; see `snapo.domains.pension.records.pots`."""

    def prepare(self, inputs: dict[str, Any]) -> Schedule:
        return pot_schedule(self.model, inputs)

    def initial(self, constants: PotTerms, noise) -> PotState:  # pyright: ignore
        fund, none = opening(constants.fund), jnp.zeros_like(constants.start_reserve)
        level = constants.level + jnp.zeros_like(constants.pots)
        return PotState(fund, constants.pots, constants.start_reserve, level, none)

    def observe(self, constants: PotTerms, now: PotPeriod, state: PotState):  # pyright: ignore
        """The observation of a fund, then the logarithm of each pot divided by its annuity, and the
        share of the reserve."""
        terms, fund = constants.fund, state.fund
        books = balance(self.model, terms, now.fund.people, now.fund.shape, fund)
        observed = observe(self.model, terms, now.fund, fund, books.ratio)
        level = self._level(
            constants, state.pots, annuity_values(terms, now.value, now.fund.shape, fund.market)
        )
        level = jnp.log(jnp.where(level > 1e-3, level, 1e-3) / constants.level) / RATIO
        held = state.reserve / (RESERVE * jnp.where(fund.assets > 0, fund.assets, constants.assets))
        return jnp.concatenate([observed, level, held[None]])

    def step(self, constants: PotTerms, now: PotPeriod, state: PotState, action, noise, smooth):  # pyright: ignore
        case, terms, fund = self.model, constants.fund, state.fund
        books = balance(case, terms, now.fund.people, now.fund.shape, fund)
        annuity, by_node = self._valued(constants, now, state)
        paid = self._paid(constants, now, state, books, smooth)
        invested = fund.assets + paid.flows.net if self._in_advance else fund.assets
        buckets = None if terms.swaps is None else terms.swaps.nearest @ by_node
        held = trade(case, terms, fund, action, invested, buckets, smooth)
        moved = move(case, terms.market, now.fund.market, fund.market, noise)
        after = fund._replace(market=moved.market)
        after = self._settled(terms, after, paid.flows, invested, held, moved)
        earned = after.assets - fund.assets - paid.flows.net
        annuities = annuity, annuity_values(terms, now.value_after, now.shape_after, moved.market)
        cash = jnp.expm1(moved.cash)
        parts = self._shared(constants, now, state, paid, earned, cash, annuities, smooth)
        state = state._replace(fund=after, gained=state.gained + parts.excess)
        state, summary = self._year(constants, now, state, parts, annuities[1], smooth)
        granted, cut = summary.pop("granted"), summary.pop("cut")
        done = Happened(books, paid.flows, invested, held, moved, after, granted, cut)
        return state, self._outputs(terms, fund, done, smooth) | summary

    def payments_near(self, constants: PotTerms, now: PotPeriod, state: PotState):  # pyright: ignore
        return constants.fund.swaps.nearest @ self._valued(constants, now, state)[1]  # pyright: ignore

    def _valued(self, constants: PotTerms, now: PotPeriod, state: PotState):
        """Values before a step: each cohort's annuity [C], and the payments of all pots by node
        [J]."""
        factor = jnp.exp(log_factor(constants.fund.market, now.fund.shape, state.fund.market))
        annuity = now.value @ factor
        return annuity, (self._level(constants, state.pots, annuity) @ now.value) * factor

    def _paid(self, constants: PotTerms, now: PotPeriod, state: PotState, books, smooth) -> Paid:
        """Contributions by salary, minus the reserve's part; pensions and expenses out of pots."""
        people, market = now.fund.people, state.fund.market
        received = contribution(
            self.model.plan,
            constants.fund.plan,
            assets=state.fund.assets,
            liability=books.liability,
            normal_cost=books.accrual,
            payroll=people.payroll,
            wage=jnp.exp(market.log_wage),
            step=self.model.step,
            smooth=smooth,
        )
        # Without anybody at work there is no one whose pot a contribution could go to.
        received = received * jnp.sum(now.payroll)
        benefit = state.level * now.benefit
        expenses = people.expenses * jnp.exp(market.log_price)
        borne = state.pots / jnp.where(jnp.sum(state.pots) > 0, jnp.sum(state.pots), 1.0)
        flows = FundFlows(received, jnp.sum(benefit), expenses)
        local = (1 - constants.fill) * received * now.payroll - benefit - expenses * borne
        return Paid(flows, local, flows.net - jnp.sum(local))

    def _shared(
        self, constants: PotTerms, now: PotPeriod, state: PotState, paid: Paid, *values
    ) -> SharedResult:
        """Pots and reserve after the return of the step, and the excess return in it.

        `values`: money earned, cash's return, the annuities before and after the step, `smooth`.
        """
        earned, cash, (before, after), smooth = values
        pots, reserve = state.pots + paid.pots, state.reserve + paid.reserve
        rest, grown = before, after + now.benefit
        holding = state.pots, state.reserve
        if self._in_advance:
            holding = pots, reserve
            rest, grown = before - now.benefit, after
        there = rest > MINIMUM * constants.assets
        growth = grown / jnp.where(there, rest, 1.0)
        # A cohort without payments has nothing to protect.
        returned = jnp.where(there, growth * jnp.exp(-now.unwound) - 1, cash)
        parts = shared(*holding, earned, returned, cash, now.protection, now.exposure, smooth)
        return SharedResult(pots + parts.pots, reserve + parts.reserve, parts.excess)

    def _year(
        self,
        constants: PotTerms,
        now: PotPeriod,
        state: PotState,
        held: SharedResult,
        annuity,
        smooth,
    ):
        """The state after the end of a year, if there is one, and its changes."""
        pots, reserve, _ = held
        due = now.fund.due

        def missing(pots):
            lack = smooth.positive_part(state.level * annuity - pots, 0.001 * constants.assets)
            return now.drawing * lack

        end = closed(pots, reserve, state.gained, missing, now.exposure, constants.reserve, smooth)
        level = self._level(constants, end.pots, annuity)
        change = level / jnp.where(state.level > 0, state.level, 1.0) - 1
        paid = now.drawing * state.level * annuity
        complete = jnp.sum(paid)
        paid = paid / jnp.where(complete > 0, complete, 1.0)
        summary = {
            "granted": due * jnp.sum(paid * smooth.positive_part(change, 0.01)),
            "cut": due * jnp.sum(paid * smooth.positive_part(-change, 0.01)),
            "filled": due * end.filled,
            "released": due * end.released,
        }
        state = state._replace(
            pots=pots + due * (end.pots - pots),
            reserve=reserve + due * (end.reserve - reserve),
            level=state.level + due * (level - state.level),
            gained=state.gained * (1 - due),
        )
        return state, summary

    @staticmethod
    def _level(constants: PotTerms, pots: Array, annuity: Array) -> Float[Array, " C"]:
        """Pots divided by annuities; the level of today for a cohort without payments."""
        there = annuity > MINIMUM * constants.assets
        return jnp.where(there, pots / jnp.where(there, annuity, 1.0), constants.level)

    def terminal(self, constants: PotTerms, state: PotState, smooth):  # pyright: ignore
        terminal = super().terminal(constants.fund, state.fund, smooth)
        level = state.level / constants.level
        mean = jnp.sum(level * constants.pots) / jnp.sum(constants.pots)
        assets = jnp.where(state.fund.assets > 0, state.fund.assets, constants.assets)
        by_cohort = {name: level[i] for i, name in enumerate(pensions(self.model.members))}
        return terminal | {"pension": mean, "reserve": state.reserve / assets} | by_cohort

    def slack(self, constants: PotTerms, now: PotPeriod, state: PotState, outputs):  # pyright: ignore
        return super().slack(constants.fund, now.fund, state.fund, outputs)


def simulator_of(case: PensionCase) -> PensionSimulator:
    """The fund of a case: of promised rights, or of personal pots."""
    kind = PensionSimulator if case.pots is None else PotSimulator
    return kind.of(case)
