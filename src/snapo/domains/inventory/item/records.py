"""An inventory case as read from its file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable
from snapo.problem.record import Input

from ..demand.base import Demand, as_input


@dataclass(frozen=True, eq=False)
class Item:
    """One item in one place.

    - `lost`: whether demand that exceeds the stock is lost; otherwise it waits.
    - `lead_time`: periods from an order to its arrival.
    - `integer`: whether orders are whole numbers; `maximum`: the largest order, infinite if orders
      are not limited.
    - `holding`, `shortage`, `purchase`, `ordering`: the costs of a unit held, a unit short, a unit
      ordered, and an order.
    - `stock`, `coming`: the stock at the start and the first arrivals; None for the default.
    """

    lost: bool
    lead_time: int
    integer: bool
    maximum: float
    holding: CaseInput
    shortage: CaseInput
    purchase: CaseInput
    ordering: CaseInput
    stock: CaseInput | None
    coming: CaseInput | None

    @property
    def fixed(self) -> bool:
        """Whether an order has a fixed cost."""
        return bool(self.ordering.values[0] > 0)

    def inputs(self) -> tuple[CaseInput, ...]:
        """The numbers of the item as inputs; the cost of an order is included only if it is above
        0."""
        costs = (self.holding, self.shortage, self.purchase)
        starts = [item for item in (self.stock, self.coming) if item is not None]
        return (*costs, *([self.ordering] if self.fixed else []), *starts)

    def cost(self, name: str) -> float:
        """One of the item's costs as a number."""
        return float(getattr(self, name).values[0])


@dataclass(frozen=True, eq=False)
class InventoryCase:
    """The data that `snapo solve` needs from a case.

    - `currency`, `unit`, `period`: names, such as "EUR", "piece", "week".
    - `periods`: the number of periods that count; `warm_up`: the number of periods before them,
      which do not count; `discount`: the discount factor of a period, 1 for the average of a
      period.
    - `season`: factors of demand by position in the season.
    - `other_leads`: whether a run also trains with lead times that are one period longer and
      shorter.
    """

    file: Path
    notes: tuple[str, ...]
    title: str
    currency: str
    unit: str
    period: str
    item: Item
    periods: int
    warm_up: int
    discount: float
    demand: Demand
    season: CaseInput
    objective: ObjectiveTable
    training: TrainingTable
    evaluation: EvaluationTable
    other_leads: bool = True

    @property
    def horizon(self) -> int:
        """The number of all periods, including the warm-up."""
        return self.warm_up + self.periods

    @property
    def counted(self) -> np.ndarray:
        """[T] the weight of each period in the averages; the weights add up to 1."""
        return (np.arange(self.horizon) >= self.warm_up) / self.periods

    @property
    def weights(self) -> np.ndarray:
        """[T] the weight of each period's cost: the weight in an average, or a discount factor."""
        if self.discount == 1:
            return self.counted
        age = np.arange(self.horizon) - self.warm_up
        return np.where(age >= 0, self.discount ** np.maximum(age, 0), 0.0)

    @property
    def value_unit(self) -> str:
        """The unit of the result: money per period, or money over the whole horizon."""
        return f"{self.currency}/{self.period}" if self.discount == 1 else self.currency

    @property
    def seasonal(self) -> bool:
        """Whether periods differ."""
        return len(self.season.values) > 1

    def inputs(self) -> dict[str, Input]:
        """Every number that has a sensitivity."""
        season = [self.season] if self.seasonal else []
        numbers = [*self.item.inputs(), *self.demand.inputs(), *season]
        return {x.name: as_input(x) for x in numbers}
