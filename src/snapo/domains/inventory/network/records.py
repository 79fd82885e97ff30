"""A network of places, as it was read."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from snapo.case.given import CaseInput, FilePosition
from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable

from ..demand.base import Demand


@dataclass(frozen=True, eq=False)
class Site:
    """One place.

    - `supplier`: the number of the place that it orders from; None: outside, which always delivers.
    - `lead_time`: periods from an order to its arrival, before the demand of that period.
    - `demand`: of customers; None where there are none.
    - `season`: factors of its mean demand by place in the season; None where periods are alike.
    - `fixed`: whether an order costs something whatever its size.
    """

    name: str
    supplier: int | None
    lead_time: int
    demand: Demand | None
    season: CaseInput | None = None
    fixed: bool = False

    def inputs(self) -> tuple[CaseInput, ...]:
        """The parameters of its demand, and its season where there is one."""
        demand = () if self.demand is None else self.demand.inputs()
        return demand if self.season is None else (*demand, self.season)


@dataclass(frozen=True)
class Pool:
    """Places with customers that send one another goods, at once: lateral transshipment.

    - `sites`: their numbers; `one_way`: only from the first of two to the second.
    - `before`: whether they do so before the demand of a period is known, to balance their
      stocks; otherwise afterwards, to where a place is short.
    """

    sites: tuple[int, ...]
    one_way: bool
    before: bool

    @property
    def givers(self) -> tuple[int, ...]:
        """The places that may send."""
        return self.sites[:1] if self.one_way else self.sites

    @property
    def takers(self) -> tuple[int, ...]:
        """The places that may receive."""
        return self.sites[1:] if self.one_way else self.sites


@dataclass(frozen=True, eq=False)
class NetworkCase:
    """What `snapo solve` needs of a case with places.

    - `integer`: whether orders and all that is sent are whole numbers.
    - `holding`: by place, of goods there and on their way from there; `shortage`: by place that
      sells, in the order of `sellers`; `transshipment`: by pool, of a unit moved; `ordering`: of
      an order of any size, by place in the order of `fixed`, None where no order costs anything.
    - Other attributes as in `InventoryCase`.
    """

    file: Path
    notes: tuple[str, ...]
    title: str
    currency: str
    unit: str
    period: str
    lost: bool
    integer: bool
    sites: tuple[Site, ...]
    pools: tuple[Pool, ...]
    holding: CaseInput
    shortage: CaseInput
    transshipment: CaseInput | None
    periods: int
    warm_up: int
    discount: float
    objective: ObjectiveTable
    training: TrainingTable
    evaluation: EvaluationTable
    ordering: CaseInput | None = None
    other_leads: bool = False

    @property
    def horizon(self) -> int:
        """All periods."""
        return self.warm_up + self.periods

    @cached_property
    def sellers(self) -> tuple[int, ...]:
        """The numbers of the places with customers."""
        return tuple(i for i, position in enumerate(self.sites) if position.demand is not None)

    @cached_property
    def fixed(self) -> tuple[int, ...]:
        """The numbers of the places where an order costs something whatever its size."""
        return tuple(i for i, position in enumerate(self.sites) if position.fixed)

    @property
    def seasonal(self) -> bool:
        """Whether periods differ, at any place."""
        return any(position.season is not None for position in self.sites)

    def moving(self, before: bool) -> tuple[int, ...]:
        """The numbers of the places that are in a pool before, or after demand is known."""
        return tuple(sorted({i for pool in self.pools if pool.before == before
                             for i in pool.sites}))  # fmt: skip

    @cached_property
    def serves(self) -> np.ndarray:
        """[n, n]: 1 where the place of the column is that of the row, or supplied through it."""
        serves = np.eye(len(self.sites))
        for i in range(len(self.sites)):
            for item in self._way(i):
                serves[item, i] = 1.0
        return serves

    @cached_property
    def supplies(self) -> np.ndarray:
        """[n, n]: 1 where the place of the row is the supplier of that of the column."""
        supplies = np.zeros((len(self.sites),) * 2)
        for i, position in enumerate(self.sites):
            if position.supplier is not None:
                supplies[position.supplier, i] = 1.0
        return supplies

    @cached_property
    def linked(self) -> np.ndarray:
        """[n, n]: 1 where what one place does may have an effect on the other."""
        supplies = self.supplies + self.supplies.T + np.eye(len(self.sites))
        for pool in self.pools:
            supplies[np.ix_(pool.sites, pool.sites)] = 1.0
        return (np.linalg.matrix_power(supplies, len(self.sites)) > 0).astype(float)

    def lead_time_from_outside(self, i: int) -> int:
        """Periods that goods need from outside to the customers of a place, its own included."""
        return sum(self.sites[j].lead_time + 1 for j in (i, *self._way(i)))

    @cached_property
    def cover(self) -> np.ndarray:
        """[n] periods of demand from an order to the last customer that it can reach in time."""
        local = np.array([position.lead_time + 1 for position in self.sites])
        ways = [self.lead_time_from_outside(i) for i in range(len(self.sites))]
        reach = [max(ways[i] for i in self.sellers if row[i]) for row in self.serves]
        above = [path - step for path, step in zip(ways, local)]
        return np.array(reach) - np.array(above)

    def _way(self, i: int) -> list[int]:
        """The suppliers of a place, the nearest first."""
        results, here = [], self.sites[i].supplier
        while here is not None:
            results.append(here)
            here = self.sites[here].supplier
        return results

    @property
    def weights(self) -> np.ndarray:
        """[T] the weight of each period's cost: of an average, or discount factors."""
        age = np.arange(self.horizon) - self.warm_up
        if self.discount == 1:
            return (age >= 0) / self.periods
        return np.where(age >= 0, self.discount ** np.maximum(age, 0), 0.0)

    @property
    def counted(self) -> np.ndarray:
        """[T] the weight of each period in the averages; they add up to 1."""
        return (np.arange(self.horizon) >= self.warm_up) / self.periods

    @property
    def value_unit(self) -> str:
        """The unit of the result."""
        return f"{self.currency}/{self.period}" if self.discount == 1 else self.currency

    @property
    def positions(self) -> dict[str, tuple[FilePosition, ...]]:
        """{input: the positions of its numbers} of the demand of every place."""
        return {f"{site.name}.{x.name}": x.positions for site in self.sites for x in site.inputs()}
