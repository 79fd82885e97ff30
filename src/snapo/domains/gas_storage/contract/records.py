"""A gas-storage case after reading: frozen records of NumPy arrays, in which dates are numbers of
days.

T is the number of decision days (`StorageCase.days`), K the number of ratchet rows of a day (1
without ratchets). Index T is the end date. Days are
integers since the valuation date and may be negative for a payment that lies before it. A
`CaseInput` has the numbers as entered; the per-day array is `given.values[given.index]`. A
simulator has only contract and model without these numbers (see `snapo.problem.form`).
"""

import abc
import datetime
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from snapo.case.given import CaseInput, SourceNumbers
from snapo.case.quantity import by_name, numbers_in
from snapo.case.settings import EvaluationTable, FittedTable, ObjectiveTable
from snapo.problem.record import Input, TreeRecord, field
from snapo.problem.record.arrays import Array, Float, jnp

from ..curves.quotes import QuotedCurve
from ..hedges.table import Hedges
from ..history.table import BacktestPlan
from ..ladder.products import TradedProducts
from ..prices.process import PriceProcess


class EndTerms(NamedTuple):
    """The value of the remaining inventory: linear between `levels`, plus `fraction` times its
    value at the spot price. `levels`, `values` [M] are zeros without a table of values;
    undiscounted, in currency.
    """

    levels: Float[Array | np.ndarray, " M"]
    values: Float[Array | np.ndarray, " M"]
    fraction: Float[Array | np.ndarray, ""]


def _no_table() -> tuple[Any, Any]:
    return np.zeros(2), np.zeros(2)


class EndRule(TreeRecord):
    """A rule for the end date; prices and amounts are those of the end date, undiscounted. After
    reading it has the numbers of the case; in a simulator it has no numbers. `owed`, `needs_price`
    and `value_known` are for the reader and the study only.
    """

    @property
    def owed(self) -> float | None:
        """The inventory that must be in store; None if any inventory is allowed."""
        return None

    @property
    def needs_price(self) -> bool:
        """Whether the value depends on the spot price of the end date."""
        return False

    def interval(self, at: Callable[[Any], Any], low: Any, high: Any) -> tuple[Any, Any]:
        """The inventories that are allowed on the end date, from those within its limits; `at`:
        returns the numbers of an input in the form in which they are used."""
        return low, high

    @abc.abstractmethod
    def terms(self, at: Callable[[Any], Any]) -> EndTerms:
        """The numbers of the value at the end, for the schedule."""

    @abc.abstractmethod
    def end_value(self, terms: EndTerms, inventory: Array, price: Callable[[], Array]) -> Array:
        """The value of the remaining inventory on one path; `price` returns the spot price of that
        day."""

    @abc.abstractmethod
    def value_known(self, inventory: float, price: float) -> float:
        """The same value in NumPy, at a fixed price and inventory, if no decision is left."""


class LevelAtEnd(EndRule):
    """The inventory that must be in store on the end date: one number, index []."""

    inventory: CaseInput

    @property
    def owed(self) -> float:
        return float(self.inventory.used())

    def interval(self, at, low, high):
        level = at(self.inventory)
        return level, level

    def terms(self, at):
        return EndTerms(*_no_table(), np.zeros(()))

    def end_value(self, terms, inventory, price):
        return jnp.zeros_like(inventory)

    def value_known(self, inventory: float, price: float) -> float:
        return 0.0


class PriceAtEnd(EndRule):
    """A unit of gas left on the end date is paid on that date at `fraction` of the spot price.
    `fraction` is one number, index []. If it is 0, the gas left has no value, and no price is
    needed on the end date.
    """

    fraction: CaseInput

    @property
    def needs_price(self) -> bool:
        return bool(self.fraction.values[0] != 0)

    def terms(self, at):
        return EndTerms(*_no_table(), at(self.fraction))

    def end_value(self, terms, inventory, price):
        return inventory * terms.fraction * price()

    def value_known(self, inventory: float, price: float) -> float:
        return float(self.fraction.used()) * inventory * price if self.needs_price else 0.0


class ValueAtEnd(EndRule):
    """The value of the inventory on the end date: linear between M points, paid on that date.

    - `inventory`: levels, strictly rising, index [M]; `value`: currency, index [M].
    """

    inventory: CaseInput
    value: CaseInput

    def terms(self, at):
        return EndTerms(at(self.inventory), at(self.value), np.zeros(()))

    def end_value(self, terms, inventory, price):
        return jnp.interp(inventory, terms.levels, terms.values)

    def value_known(self, inventory: float, price: float) -> float:
        return float(np.interp(inventory, self.inventory.used(), self.value.used()))


class Ratchets(TreeRecord):
    """The rates at which gas may flow, by day and by inventory at the start of the day.

    The rows of a day rise in inventory; a day with fewer than K rows repeats its last row. With
    "linear" the rates are interpolated between rows; with "step" the rates of the row at or below
    the inventory apply. Without ratchets, `max_injection` and `max_withdrawal` are one row (K = 1)
    at inventory 0 that applies to any level.

    - `inventory`: levels in volume, index [T, K].
    - `withdrawal`, `injection`: the largest volume per day, not negative, before outages, index [T,
      K].
    """

    inventory: CaseInput
    withdrawal: CaseInput
    injection: CaseInput
    interpolation: Literal["linear", "step"] = field(static=True)


class Contract(TreeRecord):
    """Rights, obligations and costs. All volumes are in `StorageCase.volume_unit`.

    - `inventory`: gas in store at the start of the first decision day, index [].
    - `min_inventory`, `max_inventory`: limits at the START of day t, and on the end date, index [T
      + 1].
    - `ratchets`: rates before outages.
    - `injection_factor`, `withdrawal_factor`: [T] the share of the rates that is available in
      outages, 0 to 1.
    - `min_injection`, `min_withdrawal`: forced flows per day, index [T]; never both on one day.
    - `injection_cost`, `withdrawal_cost`: currency per unit, index [T].
    - `injection_cost_day`, `withdrawal_cost_day`: [T] day on which that cost is paid.
    - `injection_fuel`, `withdrawal_fuel`: fraction of the volume, paid at the spot price, index
      [T].
    - `inventory_loss`: fraction of the inventory per day, index [T].
    - `inventory_cost`: currency per unit in store and day, paid on the day, index [T].
    - `fixed_costs`: amounts in currency, without those before the valuation date, index [n];
      `fixed_cost_day`: [n] the day on which each is paid.
    """

    inventory: CaseInput
    min_inventory: CaseInput
    max_inventory: CaseInput
    ratchets: Ratchets
    injection_factor: np.ndarray
    withdrawal_factor: np.ndarray
    min_injection: CaseInput
    min_withdrawal: CaseInput
    injection_cost: CaseInput
    withdrawal_cost: CaseInput
    injection_cost_day: np.ndarray
    withdrawal_cost_day: np.ndarray
    injection_fuel: CaseInput
    withdrawal_fuel: CaseInput
    inventory_loss: CaseInput
    inventory_cost: CaseInput
    at_end: EndRule
    fixed_costs: CaseInput
    fixed_cost_day: np.ndarray


class GasMarket(TreeRecord):
    """Forward prices and interest rates on the valuation date.

    - `forward_curve`: one price per decision day, currency per unit, labelled by the day, index
      [T]; if `StorageCase.has_end_price`, one more price for the end date, index [T + 1].
    - `zero_rate`: continuous rates, Act/365, index [n] of all nodes; linear in days between nodes,
      flat outside.
    - `zero_rate_day`: [n] integer days of the nodes, strictly rising; [0] for a single rate.
    - `gas_day`: [T] day on which the gas of day t is paid.

    A payment on day d is discounted by exp(-r(d) d / 365), and not discounted if d <= 0.
    """

    forward_curve: CaseInput
    zero_rate: CaseInput
    zero_rate_day: np.ndarray
    gas_day: np.ndarray


@dataclass(frozen=True, eq=False)
class StorageCase:
    """All data of a gas-storage case.

    - `file`: the case file; `title`, `volume_unit`, `currency`: for reports.
    - `days`: [T] decision dates, from `start` (or the valuation date, or the day after it) to the
      day before `end`; empty if none is left after the valuation date.
    - `day`: [T] the same dates as integer days since the valuation date; `end_day`: the end date in
      these days.
    - `expired`: whether the valuation date is after the end date; the value is then zero.
    - `notes`: remarks for the user of the case, one sentence each.
    - `quotes`: the quotes from which the forward curve is made; None for a curve by day or month.
    - `products`: the traded products; None if the case names none. `hedges`: the hedges of its
      [hedge].
    - `backtest`: the plan of its [backtest].
    """

    file: Path
    title: str
    volume_unit: str
    currency: str
    valuation_date: datetime.date
    start: datetime.date
    end: datetime.date
    days: tuple[datetime.date, ...]
    day: np.ndarray
    end_day: int
    expired: bool
    contract: Contract
    market: GasMarket
    model: PriceProcess
    objective: ObjectiveTable
    training: FittedTable
    evaluation: EvaluationTable
    notes: tuple[str, ...] = ()
    quotes: QuotedCurve | None = None
    products: TradedProducts | None = None
    hedges: Hedges | None = None
    backtest: BacktestPlan = BacktestPlan()

    kind = "gas-storage"

    @property
    def sources(self) -> tuple[SourceNumbers, ...]:
        """The numbers of the case from which inputs are made."""
        return () if self.quotes is None else (self.quotes.source,)

    @property
    def has_end_price(self) -> bool:
        """Whether the value of the gas left depends on the spot price of the end date."""
        return self.contract.at_end.needs_price


def storage_inputs(case: StorageCase) -> dict[str, Input]:
    """{name: Input} of the contract, the market and the prices: forward prices, rates, ratchets,
    costs …"""
    return {name: entry.input() for name, entry in numbers_by_name(case).items()}


def numbers_by_name(case: StorageCase) -> dict[str, CaseInput]:
    """{name: CaseInput} of the numbers of the case."""
    return by_name(numbers_of(case))


def numbers_of(case: StorageCase) -> Iterator[CaseInput]:
    """Every number of the contract, the market and the prices."""
    return numbers_in((case.contract, case.market, case.model))
