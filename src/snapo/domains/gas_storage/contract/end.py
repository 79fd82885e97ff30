"""The gas left on the end date: a level that is owed, or its worth. One class for each rule."""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.case.given import CaseInput

from ..prices.process import use


class EndTerms(NamedTuple):
    """Worth of the inventory left: linear between `levels`, plus `fraction` of its spot value.

    `levels`, `values` [M] are zeros where no table is given; undiscounted, in currency.
    """

    levels: Float[Array, " M"]
    values: Float[Array, " M"]
    fraction: Float[Array, ""]


def _no_table() -> tuple[Array, Array]:
    return jnp.zeros(2), jnp.zeros(2)


class EndRule(eqx.Module):
    """A rule for the end date; prices and money are those of the end date, undiscounted.

    As it is read it has the numbers of the case, and in a simulator it has none: `owed`,
    `needs_price` and `value_known` are for the reader and the study.
    """

    @property
    def owed(self) -> float | None:
        """The inventory that must be in store; None where any is allowed."""
        return None

    @property
    def needs_price(self) -> bool:
        """Whether the worth depends on the spot price of the end date."""
        return False

    def interval(self, inputs: dict[str, Any], low: Array, high: Array) -> tuple[Array, Array]:
        """The inventories allowed on the end date, out of those within its limits."""
        return low, high

    @abc.abstractmethod
    def terms(self, inputs: dict[str, Any]) -> EndTerms:
        """The numbers of the worth, for the schedule."""

    @abc.abstractmethod
    def end_value(self, terms: EndTerms, inventory: Array, price: Callable[[], Array]) -> Array:
        """Worth of the inventory left on one path; `price` gives that day's spot price."""

    @abc.abstractmethod
    def value_known(self, inventory: float, price: float) -> float:
        """The same in NumPy where price and inventory are known: no decision is left."""


class LevelAtEnd(EndRule):
    """The inventory that must be in store on the end date: one number, index []."""

    inventory: CaseInput

    @property
    def owed(self) -> float:
        return float(self.inventory.used())

    def interval(self, inputs, low, high):
        level = use(inputs, self.inventory)
        return level, level

    def terms(self, inputs):
        return EndTerms(*_no_table(), jnp.asarray(0.0))

    def end_value(self, terms, inventory, price):
        return jnp.zeros_like(inventory)

    def value_known(self, inventory: float, price: float) -> float:
        return 0.0


class PriceAtEnd(EndRule):
    """Gas left on the end date is worth `fraction` of that day's spot price: one number, index [].

    It is paid on the end date. With a fraction of 0 the gas left is worthless, and the end date
    needs no price.
    """

    fraction: CaseInput

    @property
    def needs_price(self) -> bool:
        return bool(self.fraction.values[0] != 0)

    def terms(self, inputs):
        return EndTerms(*_no_table(), use(inputs, self.fraction))

    def end_value(self, terms, inventory, price):
        return inventory * terms.fraction * price()

    def value_known(self, inventory: float, price: float) -> float:
        return float(self.fraction.used()) * inventory * price if self.needs_price else 0.0


class ValueAtEnd(EndRule):
    """Worth of the inventory on the end date: linear between M points, paid on that date.

    - `inventory`: levels, strictly rising, index [M]; `value`: currency, index [M].
    """

    inventory: CaseInput
    value: CaseInput

    def terms(self, inputs):
        return EndTerms(use(inputs, self.inventory), use(inputs, self.value), jnp.asarray(0.0))

    def end_value(self, terms, inventory, price):
        return jnp.interp(inventory, terms.levels, terms.values)

    def value_known(self, inventory: float, price: float) -> float:
        return float(np.interp(inventory, self.inventory.used(), self.value.used()))
