"""One path of a gas storage contract: prices, feasible flows, cash.

The action is two fractions: of the injection and of the withdrawal that are feasible today
beyond what must flow. Feasible means within the day's rates and such that the inventory stays
where the contract can still be met, so no penalty is needed.

Signs: volumes are positive, `cash_flow` is what the holder receives. Money is discounted to the
valuation date.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Box
from snapo.problem.simulator import Schedule, Simulator
from snapo.problem.smooth import Exact

from . import prices
from .guide import Guide
from .observation import curve_ahead, observation
from .prices import use
from .reachable import Limits, reachable
from .records import LevelAtEnd, PriceAtEnd, StorageCase, ValueAtEnd


class Day(NamedTuple):
    """One decision day, the same for all paths; every leaf has a leading axis T in the schedule.

    Prices in currency per unit, volumes in units per day, discount factors to the valuation date.
    `low`, `high` bound the inventory at the start of the day, `next_low`, `next_high` at its end;
    the factor fields are those of `prices.PriceSchedule`. `slow_variance` is the
    variance of ln S without the fastest factor; `price_features` scales the factors to order one
    and `ahead` tells the curve's shape, for the network. `guide` holds the marginal value of gas
    that the policy starts from, `hedge` the forward volume of the control variate.
    """

    day: Array
    forward: Array
    gas_discount: Array
    flow_discount: Array
    injection_cost: Array
    withdrawal_cost: Array
    injection_cost_discount: Array
    withdrawal_cost_discount: Array
    inventory_cost: Array
    injection_fuel: Array
    withdrawal_fuel: Array
    inventory_loss: Array
    levels: Array
    withdrawal_rate: Array
    injection_rate: Array
    min_injection: Array
    min_withdrawal: Array
    low: Array
    high: Array
    next_low: Array
    next_high: Array
    loading: Array
    variance: Array
    decay: Array
    shock: Array
    next_decay: Array
    next_shock: Array
    slow_variance: Array
    price_features: Array
    ahead: Array
    guide: Any = None
    hedge: Any = 0.0


class Terms(NamedTuple):
    """What holds for the whole contract: start, end and fixed costs.

    `end_levels`, `end_values` [M]: currency for the gas left, on top of `end_fraction` of its
    spot value; `fixed_costs` is a present value.
    """

    inventory: Array
    end_levels: Array
    end_values: Array
    end_fraction: Array
    end_forward: Array
    end_discount: Array
    end_loading: Array
    end_variance: Array
    fixed_costs: Array
    first_shock: Array
    last_day: Array
    price_scale: Array
    rate_scale: Array


class State(NamedTuple):
    """Inventory at the start of the day, and the state of the prices on that day [F]."""

    inventory: Float[Array, ""]
    price: Float[Array, " F"]


class Flows(NamedTuple):
    """What must and what may flow on a day: `keep` is the inventory left without any flow."""

    keep: Array
    base: Array
    most: Array
    least: Array


class StorageSimulator(Simulator):
    """The contract of a case; see `snapo.domains.gas_storage.records` for its terms.

    **Arguments:**

    - `case`: the resolved case.
    - `guide`: the marginal values that the policy starts from (see `guide.py`).
    - `hedge`: [T] forward volumes of the control variate `forward_hedge`, fixed in advance; its
      total, the discounted sum of hedge x (spot - forward), is zero on average.
    """

    case: StorageCase = eqx.field(static=True)
    guide: Guide | None = None
    hedge: Float[np.ndarray, " T"] | None = None
    action: Box = eqx.field(static=True, default=Box(2, 0.0, 1.0))

    @property
    def horizon(self) -> int:
        return len(self.case.days)

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return prices.factors(self.case)

    @property
    def initial_noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return prices.factors(self.case)

    def prepare(self, inputs: dict[str, Any]) -> Schedule:
        case, contract, market = self.case, self.case.contract, self.case.market
        t = self.horizon
        discount = _discounts(case, inputs)
        forward = use(inputs, market.forward_curve)
        limits = self.limits(inputs)
        low, high = reachable(limits, *self.end_interval(inputs), contract.ratchets.interpolation)
        factors, last = prices.price_schedule(case, inputs)
        scale = float(np.mean(np.abs(market.forward_curve.used())))
        per_day = {name: use(inputs, getattr(contract, name)) for name in _PER_DAY}
        steps = Day(
            day=jnp.asarray(case.day, float),
            forward=forward[:t],
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
            ahead=curve_ahead(forward[:t], scale),
            guide=None if self.guide is None else jax.tree.map(jnp.asarray, self.guide.knots),
            hedge=jnp.zeros(t) if self.hedge is None else jnp.asarray(self.hedge),
            **per_day,
            **factors._asdict(),
        )
        levels, values, fraction = self._end_value(inputs)
        end_discount = discount(np.asarray([case.end_day]))[0]
        terms = Terms(
            inventory=use(inputs, contract.inventory),
            end_levels=levels,
            end_values=values,
            end_fraction=fraction,
            end_forward=forward[-1],
            end_discount=end_discount,
            end_loading=last.loading[0],
            end_variance=last.variance[0],
            fixed_costs=jnp.sum(
                use(inputs, contract.fixed_costs) * discount(contract.fixed_cost_day)
            ),
            first_shock=factors.shock[0],
            last_day=jnp.asarray(float(case.end_day)),
            price_scale=jnp.asarray(scale),
            rate_scale=jnp.asarray(float(self._largest_rate())),
        )
        return Schedule(terms, steps)

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
        if isinstance(contract.at_end, LevelAtEnd):
            level = use(inputs, contract.at_end.inventory)
            return level, level
        limits = contract.min_inventory, contract.max_inventory
        return use(inputs, limits[0])[-1], use(inputs, limits[1])[-1]

    def _end_value(self, inputs: dict[str, Any]):
        at_end = self.case.contract.at_end
        nothing = jnp.zeros(2), jnp.zeros(2)
        if isinstance(at_end, ValueAtEnd):
            return use(inputs, at_end.inventory), use(inputs, at_end.value), jnp.asarray(0.0)
        fraction = (
            use(inputs, at_end.fraction) if isinstance(at_end, PriceAtEnd) else jnp.asarray(0.0)
        )
        return *nothing, fraction

    def _largest_rate(self) -> float:
        rows = self.case.contract.ratchets
        return max(
            np.max(rows.withdrawal.used(), initial=0),
            np.max(rows.injection.used(), initial=0),
            1e-9,
        )

    def initial(self, constants: Terms, noise) -> State:
        price = prices.first_price(self.case, constants.first_shock, noise)
        return State(constants.inventory, price)

    def observe(self, constants: Terms, now: Day, state: State) -> Float[Array, " features"]:
        spot, flows = self.spot(now, state), self.flows(now, state, Exact())
        return observation(self.case, constants, now, state, spot, flows)

    def step(self, constants: Terms, now: Day, state: State, action, noise, smooth):
        spot, flows = self.spot(now, state), self.flows(now, state, smooth, constants.rate_scale)
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
            prices.next_price(self.case, now, state.price, noise),
        )
        return after, {
            "cash_flow": sold * gas - cost,
            "costs": cost,
            "injection": injection,
            "withdrawal": withdrawal,
            "forward_hedge": now.hedge * now.gas_discount * (spot - now.forward),
        }

    def terminal(self, constants: Terms, state: State, smooth):
        worth = jnp.interp(state.inventory, constants.end_levels, constants.end_values)
        if isinstance(self.case.contract.at_end, PriceAtEnd):
            end = constants.end_forward, constants.end_loading, constants.end_variance
            price = prices.spot(self.case, *end, state.price)
            worth = state.inventory * constants.end_fraction * price
        elif isinstance(self.case.contract.at_end, LevelAtEnd):
            worth = jnp.zeros_like(state.inventory)
        return {"cash_flow": worth * constants.end_discount, "fixed_costs": constants.fixed_costs}

    def spot(self, now: Day, state: State) -> Float[Array, ""]:
        """The day's spot price."""
        return prices.spot(self.case, now.forward, now.loading, now.variance, state.price)

    def flows(self, now: Day, state: State, smooth, scale: Any = 1.0) -> Flows:
        """What must flow (`base`, net) and between what (`least`, `most`) the net flow may lie."""
        kind = self.case.contract.ratchets.interpolation
        withdrawal = rate(now.levels, now.withdrawal_rate, state.inventory, kind, smooth)
        injection = rate(now.levels, now.injection_rate, state.inventory, kind, smooth)
        keep = state.inventory * (1 - now.inventory_loss)
        least = jnp.where(now.min_injection > 0, now.min_injection, -withdrawal)
        most = jnp.where(now.min_withdrawal > 0, -now.min_withdrawal, injection)
        least = smooth.maximum(least, now.next_low - keep, scale)
        most = smooth.minimum(most, now.next_high - keep, scale)
        # Rounding may leave least a hair above most: one feasible flow, then.
        most = jnp.maximum(most, least)
        base = smooth.minimum(smooth.maximum(0.0, least, scale), most, scale)
        return Flows(keep, base, most, least)

    def control_variates(self) -> tuple[str, ...]:
        hedged = self.hedge is not None and self.martingale
        return ("forward_hedge",) if hedged else ()

    @property
    def martingale(self) -> bool:
        """Whether the spot's expectation is the forward price."""
        return not isinstance(self.case.model, prices.SuppliedModel)

    def slack(self, constants: Terms, now: Day, state: State, outputs):
        return {
            "min_inventory": state.inventory - now.next_low,
            "max_inventory": now.next_high - state.inventory,
            "injection": outputs["injection"],
            "withdrawal": outputs["withdrawal"],
        }

    def state_scale(self, constants: Terms) -> State:
        return State(jnp.asarray(1.0), jnp.ones(self.noise_size))


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
        return jnp.exp(-jnp.interp(day, nodes, rates) * day / prices.YEAR)

    return discount
