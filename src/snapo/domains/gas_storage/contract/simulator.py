"""One path of a gas storage contract: prices, feasible flows, cash.

The action is two fractions: of the injection and of the withdrawal that are feasible today
beyond the forced flow. Feasible means within the day's rates and such that the inventory stays
where the contract can still be met, so no penalty is needed.

Signs: volumes are positive, `cash_flow` is received by the holder. Money is discounted to the
valuation date.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Box
from snapo.problem.problem import Problem
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

from ..policy.observation import curve_ahead, observation
from ..policy.surprise import Surprises, of_day, of_end
from ..policy.value_table import ValueTable
from ..prices.process import YEAR, PriceProcess, use
from .end import EndTerms
from .reachable import Limits, reachable
from .records import StorageCase
from .schedule import Day, Flows, State, Terms


class StorageSimulator(Simulator):
    """The contract of a case; see `snapo.domains.gas_storage.contract.records` for its terms.

    **Arguments:**

    - `case`: the resolved case, with its price process.
    - `guide`: the marginal values that the policy starts from (see `policy.value_table`).
    - `hedge`: [T] forward volumes of the control variate `forward_hedge`, fixed in advance; its
      total, the discounted sum of hedge x (spot - forward), is zero on average.
    - `surprises`: of a fitted value of the store: the control variate `value_surprise` in place of
      that of a hedge; its total is zero on average too.
    - `price_scale`, `rate_scale`: of the features: the mean forward price and the largest daily
      rate; by default those of the case.
    """

    case: StorageCase = eqx.field(static=True)
    guide: ValueTable | None = None
    hedge: Float[np.ndarray, " T"] | None = None
    surprises: Surprises | None = None
    action: Box = eqx.field(static=True, default=Box(0.0, 1.0, 2))
    # Arrays, so that code compiled for one curve serves another.
    price_scale: Float[np.ndarray, ""] | None = None
    rate_scale: Float[np.ndarray, ""] | None = None
    fully_observed = True

    def __post_init__(self):
        if self.price_scale is None:
            self.price_scale = np.asarray(mean_price(self.case, values_of(self.case)))
        if self.rate_scale is None:
            self.rate_scale = np.asarray(largest_rate(self.case, values_of(self.case)))

    @property
    def process(self) -> PriceProcess:
        """The price process of the case."""
        return self.case.model

    @property
    def horizon(self) -> int:
        return len(self.case.days)

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.process.noise_size

    @property
    def initial_noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.process.initial_noise_size

    def prepare(self, inputs: dict[str, Any]) -> Schedule:
        prices = self.process.prepare(inputs)
        last = jax.tree.map(lambda leaf: leaf[-1], prices.steps)
        steps = self._days(inputs, jax.tree.map(lambda leaf: leaf[:-1], prices.steps))
        return self._completed(Schedule(self._terms(inputs, prices.constants, last), steps))

    def prepared_apart(self):
        return replace(self, guide=None, hedge=None, surprises=None), self._completed

    def _completed(self, schedule: Schedule) -> Schedule:
        """With the guide, the hedge and the surprises, which no input makes here."""
        guide, hedge, found = self.guide, self.hedge, self.surprises
        steps = schedule.steps._replace(
            guide=None if guide is None else guide.knots,
            hedge=np.zeros(self.horizon) if hedge is None else hedge,
            surprise=None if found is None else found.days,
        )
        end = None if found is None else found.end
        return Schedule(schedule.constants._replace(surprise=end), steps)

    def _days(self, inputs: dict[str, Any], prices) -> Day:
        case, contract, market = self.case, self.case.contract, self.case.market
        t, discount = self.horizon, _discounts(case, inputs)
        forward, limits = use(inputs, market.forward_curve)[:t], self.limits(inputs)
        low, high = reachable(limits, *self.end_interval(inputs), contract.ratchets.interpolation)
        return Day(
            day=jnp.asarray(case.day, float),
            forward=forward,
            gas_discount=discount(market.gas_day),
            flow_discount=discount(case.day),
            injection_cost_discount=discount(contract.injection_cost_day),
            withdrawal_cost_discount=discount(contract.withdrawal_cost_day),
            inventory_loss=limits.inventory_loss,
            levels=limits.levels,
            withdrawal_rate=limits.withdrawal_rate,
            injection_rate=limits.injection_rate,
            min_injection=limits.min_injection,
            min_withdrawal=limits.min_withdrawal,
            low=low[:-1],
            high=high[:-1],
            next_low=low[1:],
            next_high=high[1:],
            price=prices,
            ahead=curve_ahead(forward, self.price_scale),
            **{name: use(inputs, getattr(contract, name)) for name in _PER_DAY},
        )

    def _terms(self, inputs: dict[str, Any], constants, last) -> Terms:
        case, contract = self.case, self.case.contract
        discount = _discounts(case, inputs)
        end = contract.at_end.terms(inputs)
        fixed = use(inputs, contract.fixed_costs) * discount(contract.fixed_cost_day)
        return Terms(
            inventory=use(inputs, contract.inventory),
            end_levels=end.levels,
            end_values=end.values,
            end_fraction=end.fraction,
            end_forward=use(inputs, case.market.forward_curve)[-1],
            end_discount=discount(np.asarray([case.end_day]))[0],
            fixed_costs=jnp.sum(fixed),
            last_day=jnp.asarray(float(case.end_day)),
            price=constants,
            end_price=last,
            price_scale=jnp.asarray(self.price_scale),
            rate_scale=jnp.asarray(self.rate_scale),
        )

    def limits(self, inputs: dict[str, Any]) -> Limits:
        """Inventory limits, rates after outages, losses and forced flows per day."""
        contract, rows = self.case.contract, self.case.contract.ratchets
        out, into = contract.withdrawal_factor[:, None], contract.injection_factor[:, None]
        return Limits(
            minimum=use(inputs, contract.min_inventory)[:-1],
            maximum=use(inputs, contract.max_inventory)[:-1],
            inventory_loss=use(inputs, contract.inventory_loss),
            levels=use(inputs, rows.inventory),
            withdrawal_rate=use(inputs, rows.withdrawal) * out,
            injection_rate=use(inputs, rows.injection) * into,
            min_injection=use(inputs, contract.min_injection),
            min_withdrawal=use(inputs, contract.min_withdrawal),
        )

    def end_interval(self, inputs: dict[str, Any]) -> tuple[Array, Array]:
        """The inventories allowed on the end date."""
        contract = self.case.contract
        low, high = (
            use(inputs, each)[-1] for each in (contract.min_inventory, contract.max_inventory)
        )
        return contract.at_end.interval(inputs, low, high)

    def initial(self, constants: Terms, noise) -> State:
        return State(constants.inventory, self.process.initial(constants.price, noise))

    def observe(self, constants: Terms, now: Day, state: State) -> Float[Array, " features"]:
        spot, flows = self.spot(constants, now, state), self.flows(now, state, Exact())
        return observation(self.process, constants, now, state, spot, flows)

    def step(self, constants: Terms, now: Day, state: State, action, noise, smooth):
        spot = self.spot(constants, now, state)
        flows = self.flows(now, state, smooth, constants.rate_scale)
        injection = smooth.positive_part(flows.base, constants.rate_scale)
        withdrawal = injection - flows.base + action[1] * (flows.base - flows.least)
        injection = injection + action[0] * (flows.most - flows.base)
        gas = spot * now.gas_discount
        cost = (
            injection * now.injection_cost * now.injection_cost_discount
            + withdrawal * now.withdrawal_cost * now.withdrawal_cost_discount
            + state.inventory * now.inventory_cost * now.flow_discount
        )
        sold = withdrawal * (1 - now.withdrawal_fuel) - injection * (1 + now.injection_fuel)
        after = State(
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

    def _weighed(self, state: State, outputs: dict[str, Any]) -> dict[str, Any]:
        """Outputs times the likelihood ratio of the prices so far (see `Process.weight`)."""
        weight = self.process.weight(state.price)
        return {name: weight * output for name, output in outputs.items()}

    def in_mean(self):
        return self.process.in_mean()

    def _control(self, constants: Terms, now: Day, state: State, after: State, spot):
        """The day's part of the control variate."""
        if now.surprise is not None:
            factors = self.process.gaussian(state.price)
            found = of_day(now.surprise, factors, state.inventory, after.inventory)
            return {"value_surprise": found}
        surprise = spot - self.process.forward(constants.price, now.price)
        return {"forward_hedge": now.hedge * now.gas_discount * surprise}

    def terminal(self, constants: Terms, state: State, smooth):
        def price():
            return self.process.level(constants.price, constants.end_price, state.price)

        terms = EndTerms(constants.end_levels, constants.end_values, constants.end_fraction)
        worth = self.case.contract.at_end.worth(terms, state.inventory, price)
        outputs = {"cash_flow": worth * constants.end_discount}
        if constants.surprise is not None:
            factors = self.process.gaussian(state.price)
            outputs["value_surprise"] = of_end(constants.surprise, factors, state.inventory)
        return self._weighed(state, outputs) | {"fixed_costs": constants.fixed_costs}

    def spot(self, constants: Terms, now: Day, state: State) -> Float[Array, ""]:
        """The day's spot price."""
        return self.process.level(constants.price, now.price, state.price)

    def flows(self, now: Day, state: State, smooth, scale: Any = 1.0) -> Flows:
        """The day's forced net flow, and the least and the most that is feasible."""
        kind = self.case.contract.ratchets.interpolation
        withdrawal = rate(now.levels, now.withdrawal_rate, state.inventory, kind, smooth)
        injection = rate(now.levels, now.injection_rate, state.inventory, kind, smooth)
        keep = state.inventory * (1 - now.inventory_loss)
        least = jnp.where(now.min_injection > 0, now.min_injection, -withdrawal)
        most = jnp.where(now.min_withdrawal > 0, -now.min_withdrawal, injection)
        least = smooth.maximum(least, now.next_low - keep, scale)
        most = smooth.minimum(most, now.next_high - keep, scale)
        # Rounding may leave least a hair above most: one feasible flow, then. Where they are equal,
        # as before an agreed end, XLA must not compute them twice, rounded in two ways: either side
        # of the maximum would pass for the smaller one, and the derivative be lost or doubled.
        most, least = jax.lax.optimization_barrier((most, least))
        most = jnp.maximum(most, least)
        base = smooth.minimum(smooth.maximum(0.0, least, scale), most, scale)
        return Flows(keep, base, most, least)

    def control_variates(self) -> tuple[str, ...]:
        if self.surprises is not None:
            return ("value_surprise",)
        hedged = self.hedge is not None and self.process.martingale
        return ("forward_hedge",) if hedged else ()

    def slack(self, constants: Terms, now: Day, state: State, outputs):
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


Values = Mapping[str, np.ndarray]  # {input: its numbers}


def values_of(case: StorageCase) -> Values:
    """The numbers of the inputs that the scales of features are made from."""
    rows = case.contract.ratchets
    scaled = (case.market.forward_curve, rows.withdrawal, rows.injection)
    return {series.name: series.values for series in scaled}


def mean_price(case: StorageCase, values: Values) -> float:
    """The mean size of the forward prices."""
    curve = case.market.forward_curve
    return float(np.mean(np.abs(values[curve.name][curve.index])))


def largest_rate(case: StorageCase, values: Values) -> float:
    """The largest volume that may move on a day."""
    rows = case.contract.ratchets
    rates = (
        np.max(values[series.name][series.index], initial=0.0)
        for series in (rows.withdrawal, rows.injection)
    )
    return float(max(*rates, 1e-9))


_PER_DAY = (
    "injection_cost",
    "withdrawal_cost",
    "inventory_cost",
    "injection_fuel",
    "withdrawal_fuel",
)


def rate(levels, rates, inventory, interpolation: str, smooth):
    """The day's rate at an inventory: linear between rows, or that of the row at or below."""
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


def _discounts(case: StorageCase, inputs: dict[str, Any]):
    """Discount factors of payments on integer days: continuous zero rates, linear in days."""
    nodes = case.market.zero_rate_day.astype(float)
    rates = use(inputs, case.market.zero_rate)

    def discount(day: np.ndarray):
        day = np.maximum(day, 0).astype(float)
        # The days are known, so the weights of the nodes are numbers: one product, soon compiled.
        weights = np.stack([np.interp(day, nodes, one) for one in np.eye(len(nodes))], axis=-1)
        return jnp.exp(-(weights @ rates) * day / YEAR)

    return discount
