"""One path of a gas storage contract: prices, feasible flows, cash.

The action has two shares: of the injection and of the withdrawal that are feasible today beyond the
forced flow. A flow is feasible if it is within the rates of the day and if the contract can still
be met from the new inventory, so that no penalty is needed.

Signs: volumes are positive, `cash_flow` is received by the holder. Money is discounted to the
valuation date.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Literal, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from snapo.problem.actions import Box
from snapo.problem.form import Use, formed
from snapo.problem.problem import Problem
from snapo.problem.simulator import Schedule
from snapo.problem.smooth import Exact

from ..policy.network import curve_ahead, observation
from ..policy.value_table import Innovations, ValueTable, of_day, of_end
from ..prices.process import PriceProcess, use
from .reachable import reachable
from .records import Contract, EndTerms, StorageCase, storage_inputs
from .schedule import Discounts, FlowLimits, PricedSimulator, StoreState
from .terms import ContractTerms, Day, end_interval, inventory_limits, per_day


class StorageSimulator(PricedSimulator):
    """The contract of a case; see `snapo.domains.gas_storage.contract.records` for its terms.

    It does not contain the case: simulators of contracts of the same form differ only in arrays and
    inputs.

    **Arguments:**

    - `contract`, `process`: the contract and the price process of the case, after `formed`;
      `curve`, `rate`: the inputs of its forward prices and interest rates, and where they are used;
      `discounts`: the discount factors of its payments.
    - `day` [T]: integer days since the valuation date; `end_day`: that of the end date.
    - `value_table`: the marginal values from which the policy starts (see `policy.value_table`).
    - `hedge`: [T] forward volumes of the control variate `forward_hedge`, fixed in advance; its
      total, the discounted sum of hedge x (spot - forward), is zero on average.
    - `innovations`: the innovations of a fitted value of the store, for the control variate
      `value_surprise` instead of `forward_hedge`; its total is also zero on average.
    - `price_scale`, `rate_scale`: the scales of the features, which are the mean forward price and
      the largest daily rate.
    """

    contract: Contract
    process: PriceProcess
    curve: Use
    rate: Use
    discounts: Discounts
    day: Int[np.ndarray, " T"]
    end_day: Int[np.ndarray, ""]
    price_scale: Float[np.ndarray, ""]
    rate_scale: Float[np.ndarray, ""]
    value_table: ValueTable | None = None
    hedge: Float[np.ndarray, " T"] | None = None
    innovations: Innovations | None = None
    action: Box = eqx.field(static=True, default=Box(0.0, 1.0, 2))
    fully_observed = True

    @classmethod
    def of(cls, case: StorageCase, value_table: ValueTable | None = None) -> Self:
        """The simulator of a case, with the scales of its numbers."""
        contract, market = case.contract, case.market
        numbers = {name: item.value for name, item in storage_inputs(case).items()}
        made = cls(  # pyright: ignore[reportCallIssue]
            formed(contract),
            formed(case.model),
            market.forward_curve.use(),
            market.zero_rate.use(),
            Discounts.of(case),
            case.day,
            np.asarray(case.end_day),
            np.zeros(()),
            np.zeros(()),
            value_table,
        )
        return made.scaled(numbers)

    def scaled(self, values: Mapping[str, np.ndarray]) -> Self:
        """The simulator with the scales of features for the values of these inputs: the mean size
        of forward prices, and the largest volume that may flow on a day."""
        rows: Any = self.contract.ratchets
        size = self.process.price_scale(self.curve.in_numpy(values), values)
        rates = [
            np.max(item.in_numpy(values), initial=0.0) for item in (rows.withdrawal, rows.injection)
        ]
        return replace(
            self,
            price_scale=np.asarray(size),
            rate_scale=np.asarray(max(*rates, 1e-9)),
        )

    @property
    def interpolation(self) -> Literal["linear", "step"]:
        """The interpolation of the rates between ratchet rows: "linear" or "step"."""
        return self.contract.ratchets.interpolation

    def on_paths(self):
        # The policy's view of value table and innovations is in the schedule.
        names = ("contract", "process", "curve", "rate", "discounts", "value_table", "innovations")
        bare = jax.tree.map(lambda leaf: None, [getattr(self, name) for name in names])
        return replace(self, **dict(zip(names, bare)))

    def on_step(self):
        hedge = None if self.hedge is None else np.zeros(())
        return replace(super().on_step(), day=None, hedge=hedge)

    @property
    def horizon(self) -> int:
        return len(self.day)

    @property
    def first_step(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return int(self.day[0]) if self.horizon else 0

    def prepare(self, inputs: dict[str, Any]) -> Schedule:
        prices = self.process.prepare(inputs)
        last = jax.tree.map(lambda leaf: leaf[-1], prices.steps)
        steps = self._days(inputs, jax.tree.map(lambda leaf: leaf[:-1], prices.steps))
        return self._completed(Schedule(self._terms(inputs, prices.constants, last), steps))

    def prepared_apart(self):
        return replace(self, value_table=None, hedge=None, innovations=None), self._completed

    def _completed(self, schedule: Schedule) -> Schedule:
        """The schedule with the value table, the hedge and the innovations added, which do not
        depend on inputs here."""
        table, hedge, innovations = self.value_table, self.hedge, self.innovations
        steps = schedule.steps._replace(
            value_table=None if table is None else table.knots,
            hedge=np.zeros(self.horizon) if hedge is None else hedge,
            innovation=None if innovations is None else innovations.days,
        )
        end = None if innovations is None else innovations.end
        return Schedule(schedule.constants._replace(innovation=end), steps)

    def _days(self, inputs: dict[str, Any], prices) -> Day:
        contract, discounts, rates = self.contract, self.discounts, use(inputs, self.rate)
        at = partial(use, inputs)
        forward, limits = at(self.curve)[: self.horizon], inventory_limits(contract, at)
        interval = end_interval(contract, at)
        low, high = reachable(limits, *interval, self.interpolation)
        return Day(
            day=jnp.asarray(self.day, float),
            forward=forward,
            gas_discount=discounts.gas(rates),
            flow_discount=discounts.flow(rates),
            injection_cost_discount=discounts.injection_cost(rates),
            withdrawal_cost_discount=discounts.withdrawal_cost(rates),
            price=prices,
            ahead=curve_ahead(forward, self.price_scale),
            **per_day(contract, at, limits, low, high),
        )

    def _terms(self, inputs: dict[str, Any], constants, last) -> ContractTerms:
        contract, discounts, rates = self.contract, self.discounts, use(inputs, self.rate)
        end = contract.at_end.terms(partial(use, inputs))
        fixed = use(inputs, contract.fixed_costs) * discounts.fixed(rates)
        return ContractTerms(
            inventory=use(inputs, contract.inventory),
            end_levels=end.levels,
            end_values=end.values,
            end_fraction=end.fraction,
            end_forward=use(inputs, self.curve)[-1],
            end_discount=discounts.end(rates)[0],
            fixed_costs=jnp.sum(fixed),
            last_day=jnp.asarray(self.end_day, float),
            price=constants,
            end_price=last,
            price_scale=jnp.asarray(self.price_scale),
            rate_scale=jnp.asarray(self.rate_scale),
        )

    def initial(self, constants: ContractTerms, noise) -> StoreState:
        return StoreState(constants.inventory, self.process.initial(constants.price, noise))

    def observe(
        self, constants: ContractTerms, now: Day, state: StoreState
    ) -> Float[Array, " features"]:
        spot, flows = self.spot(constants, now, state), self.flows(now, state, Exact())
        return observation(self.process, constants, now, state, spot, flows)

    def step(self, constants: ContractTerms, now: Day, state: StoreState, action, noise, smooth):
        spot = self.spot(constants, now, state)
        flows = self.flows(now, state, smooth, constants.rate_scale)
        injection = smooth.positive_part(flows.base, constants.rate_scale)
        withdrawal = injection - flows.base + action[1] * (flows.base - flows.minimum)
        injection = injection + action[0] * (flows.maximum - flows.base)
        if not self.process.proportional:
            # At a negative price fuel earns money: to inject and to withdraw at once would pay.
            net = injection - withdrawal
            injection, withdrawal = jnp.maximum(net, 0.0), jnp.maximum(-net, 0.0)
        gas = spot * now.gas_discount
        cost = (
            injection * now.injection_cost * now.injection_cost_discount
            + withdrawal * now.withdrawal_cost * now.withdrawal_cost_discount
            + state.inventory * now.inventory_cost * now.flow_discount
        )
        sold = volume_sold(now, injection, withdrawal)
        after = StoreState(
            flows.keep + injection - withdrawal,
            self.process.step(constants.price, now.price, state.price, noise),
        )
        return after, self._weighed(
            state,
            {
                "cash_flow": sold * gas - cost,
                "costs": cost,
                "injection": injection,
                "withdrawal": withdrawal,
                **self._control(constants, now, state, after, spot),
            },
        )

    def _weighed(self, state: StoreState, outputs: dict[str, Any]) -> dict[str, Any]:
        """The outputs times the likelihood ratio of the prices so far (see `Process.weight`)."""
        weight = self.process.weight(state.price)
        return {name: weight * output for name, output in outputs.items()}

    def in_mean(self):
        return self.process.in_mean()

    def _control(
        self, constants: ContractTerms, now: Day, state: StoreState, after: StoreState, spot
    ):
        """The part of the control variate on one day."""
        if now.innovation is not None:
            factors = self.process.gaussian(state.price)
            day = of_day(now.innovation, factors, state.inventory, after.inventory)
            return {"value_surprise": day}
        innovation = spot - self.process.forward(constants.price, now.price)
        return {"forward_hedge": now.hedge * now.gas_discount * innovation}

    def terminal(self, constants: ContractTerms, state: StoreState, smooth):
        def price():
            return self.process.level(constants.price, constants.end_price, state.price)

        terms = EndTerms(constants.end_levels, constants.end_values, constants.end_fraction)
        value = self.contract.at_end.end_value(terms, state.inventory, price)
        outputs = {"cash_flow": value * constants.end_discount}
        if constants.innovation is not None:
            factors = self.process.gaussian(state.price)
            outputs["value_surprise"] = of_end(constants.innovation, factors, state.inventory)
        return self._weighed(state, outputs) | {"fixed_costs": constants.fixed_costs}

    def spot(self, constants: ContractTerms, now: Day, state: StoreState) -> Float[Array, ""]:
        """The spot price of the day."""
        return self.process.level(constants.price, now.price, state.price)

    def flows(self, now: Day, state: StoreState, smooth, scale: Any = 1.0) -> FlowLimits:
        """The forced net flow of the day, and the feasible minimum and maximum."""
        kind = self.interpolation
        withdrawal = rate(now.levels, now.withdrawal_rate, state.inventory, kind, smooth)
        injection = rate(now.levels, now.injection_rate, state.inventory, kind, smooth)
        keep = state.inventory * (1 - now.inventory_loss)
        minimum = jnp.where(now.min_injection > 0, now.min_injection, -withdrawal)
        maximum = jnp.where(now.min_withdrawal > 0, -now.min_withdrawal, injection)
        minimum = smooth.maximum(minimum, now.next_low - keep, scale)
        maximum = smooth.minimum(maximum, now.next_high - keep, scale)
        # Rounding may leave least a hair above most: one feasible flow, then. Where they are equal,
        # as before an agreed end, XLA must not compute them twice, rounded in two ways: either side
        # of the maximum would pass for the smaller one, and the derivative be lost or doubled.
        maximum, minimum = jax.lax.optimization_barrier((maximum, minimum))
        maximum = jnp.maximum(maximum, minimum)
        base = smooth.minimum(smooth.maximum(0.0, minimum, scale), maximum, scale)
        return FlowLimits(keep, base, maximum, minimum)

    def control_variates(self) -> tuple[str, ...]:
        if self.innovations is not None:
            return ("value_surprise",)
        hedged = self.hedge is not None and self.process.martingale
        return ("forward_hedge",) if hedged else ()

    def slack(self, constants: ContractTerms, now: Day, state: StoreState, outputs):
        return {
            "min_inventory": state.inventory - now.next_low,
            "max_inventory": now.next_high - state.inventory,
            "injection": outputs["injection"],
            "withdrawal": outputs["withdrawal"],
        }


def simulator_of(problem: Problem) -> StorageSimulator:
    """The simulator of a storage problem."""
    simulator = problem.simulator
    if not isinstance(simulator, StorageSimulator):
        raise TypeError(f"{type(simulator).__name__} is not a gas store.")
    return simulator


def volume_sold(now: Day, injection, withdrawal):
    """The volume that is sold at the spot price of the day, less the volume that is bought, with
    fuel."""
    return withdrawal * (1 - now.withdrawal_fuel) - injection * (1 + now.injection_fuel)


def rate(levels, rates, inventory, interpolation: str, smooth):
    """The rate of the day at an inventory: linear between rows, or the rate of the row at or below
    it."""
    if levels.shape[0] == 1:
        return rates[0]
    if interpolation == "step":
        reached = 1 - smooth.indicator(
            levels[1:] - inventory, jnp.abs(levels[-1] - levels[0]) / 100
        )
        return rates[0] + jnp.sum(reached * jnp.diff(rates))
    width = jnp.diff(levels)
    slope = jnp.where(width > 0, jnp.diff(rates) / jnp.where(width > 0, width, 1.0), 0.0)
    return rates[0] + jnp.sum(slope * jnp.clip(inventory - levels[:-1], 0.0, width))
