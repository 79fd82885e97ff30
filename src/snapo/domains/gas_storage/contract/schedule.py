"""The state of one path of a store, discount factors, and simulators of contracts whose only noise
is in the prices."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from snapo.problem.form import without_uses
from snapo.problem.simulator import Schedule, Simulator

from ..prices.process import YEAR, PriceProcess
from .records import StorageCase


class StoreState(NamedTuple):
    """Inventory at the start of the day, and the state of the price process on that day."""

    inventory: Float[Array, ""]
    price: PyTree


class FlowLimits(NamedTuple):
    """The required net flow of a day (`base`), and the bounds of the allowed net flow.

    `keep` is the inventory at the end of the day without any flow.
    """

    keep: Array
    base: Array
    maximum: Array
    minimum: Array


class Discount(eqx.Module):
    """Discount factors of n payments from continuous zero rates, which are linear in days between
    nodes and constant outside them.

    - `day` [n]: the day of each payment since the valuation date, not negative.
    - `weight` [n, nodes]: the weight of the rate of each node in the rate of the payment.
    """

    day: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, "n nodes"]

    @classmethod
    def of(cls, day: np.ndarray, nodes: np.ndarray) -> "Discount":
        """The discount factors of payments on integer days, with interest rates on the days
        `nodes`."""
        later, at = np.maximum(day, 0).astype(float), nodes.astype(float)
        weights = [np.interp(later, at, one) for one in np.eye(len(nodes))]
        return cls(later, np.stack(weights, axis=-1))

    def __call__(self, rates: Float[Array, " nodes"]) -> Float[Array, " n"]:
        """exp(-r(d) d / 365)."""
        return jnp.exp(-(self.weight @ rates) * self.day / YEAR)


class Discounts(eqx.Module):
    """Discount factors of the gas, of the flow and of its costs on every day [T], of fixed costs
    [n], and of the end date."""

    gas: Discount
    flow: Discount
    injection_cost: Discount
    withdrawal_cost: Discount
    fixed: Discount
    end: Discount

    @classmethod
    def of(cls, case: StorageCase) -> "Discounts":
        """The discount factors of a case."""
        contract, market = case.contract, case.market
        days = (
            market.gas_day,
            case.day,
            contract.injection_cost_day,
            contract.withdrawal_cost_day,
            contract.fixed_cost_day,
            np.asarray([case.end_day]),
        )
        return cls(*(Discount.of(day, market.zero_rate_day) for day in days))


def of_prices(schedule: Schedule) -> Schedule:
    """The schedule of the price process, with T + 1 rows in NumPy, taken from the schedule of the
    problem."""
    days, last = schedule.steps.price, schedule.constants.end_price
    rows = jax.tree.map(lambda leaf, end: np.concatenate([leaf, np.asarray(end)[None]]), days, last)
    return Schedule(schedule.constants.price, rows)


class PricedSimulator(Simulator):
    """A simulator whose only noise is the noise of its price `process`."""

    process: eqx.AbstractVar[PriceProcess]

    def on_step(self):
        return without_uses(self)

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.process.noise_size

    @property
    def initial_noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.process.initial_noise_size

    @property
    def initial_steps(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.process.initial_steps

    @property
    def calendar(self) -> tuple[float, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.process.calendar
