"""The data of a network of places."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from snapo.case.given import CaseInput, FilePosition
from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable
from snapo.problem.record import Input

from ..demand.base import Demand, as_input


@dataclass(frozen=True)
class Site:
    """One place.

    - `supplier`: the number of the place from which it orders; None for an outside supplier, which
      always delivers.
    - `lead_time`: periods from an order to its arrival, before the demand of that period.
    - `sells`: whether it has customers; `seasonal`: whether their demand has a season.
    - `fixed`: whether an order has a fixed cost.
    """

    name: str
    supplier: int | None
    lead_time: int
    sells: bool
    seasonal: bool = False
    fixed: bool = False


@dataclass(frozen=True)
class Pool:
    """Places with customers that send goods to one another without a lead time (lateral
    transshipment).

    - `sites`: the numbers of the places; `one_way`: whether only the first of two places sends
      goods to the second.
    - `before`: whether goods are exchanged before the demand of a period is known, to balance the
      stocks; otherwise they are sent afterwards to places with a shortage.
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


@dataclass(frozen=True)
class SupplyNetwork:
    """The places of a network and the links between them, without costs and demands.

    - `integer`: whether orders and shipments are whole numbers.
    - `cheapest_first`: the numbers of the pools in the order in which they act.
    """

    sites: tuple[Site, ...]
    pools: tuple[Pool, ...]
    lost: bool
    integer: bool
    cheapest_first: tuple[int, ...] = ()

    @cached_property
    def sellers(self) -> tuple[int, ...]:
        """The numbers of the places with customers."""
        return tuple(i for i, site in enumerate(self.sites) if site.sells)

    @cached_property
    def fixed(self) -> tuple[int, ...]:
        """The numbers of the places with a fixed cost per order."""
        return tuple(i for i, site in enumerate(self.sites) if site.fixed)

    @property
    def seasonal(self) -> bool:
        """Whether periods differ, at any place."""
        return any(site.seasonal for site in self.sites)

    def moving(self, before: bool) -> tuple[int, ...]:
        """The numbers of the places in pools that act before (or after) demand is known."""
        return tuple(sorted({i for pool in self.pools if pool.before == before
                             for i in pool.sites}))  # fmt: skip

    @cached_property
    def serves(self) -> np.ndarray:
        """[n, n]: 1 if the place of the column is the place of the row or is supplied through it,
        else 0."""
        serves = np.eye(len(self.sites))
        for i in range(len(self.sites)):
            for item in self._way(i):
                serves[item, i] = 1.0
        return serves

    @cached_property
    def supplies(self) -> np.ndarray:
        """[n, n]: 1 if the place of the row is the supplier of the place of the column, else 0."""
        supplies = np.zeros((len(self.sites),) * 2)
        for i, site in enumerate(self.sites):
            if site.supplier is not None:
                supplies[site.supplier, i] = 1.0
        return supplies

    @cached_property
    def linked(self) -> np.ndarray:
        """[n, n]: 1 if decisions of one place may have an effect on the other place, else 0."""
        supplies = self.supplies + self.supplies.T + np.eye(len(self.sites))
        for pool in self.pools:
            supplies[np.ix_(pool.sites, pool.sites)] = 1.0
        return (np.linalg.matrix_power(supplies, len(self.sites)) > 0).astype(float)

    def lead_time_from_outside(self, i: int) -> int:
        """The number of periods, including the period of the sale, that goods need from outside to
        the customers of a place."""
        return sum(self.sites[j].lead_time + 1 for j in (i, *self._way(i)))

    @cached_property
    def cover(self) -> np.ndarray:
        """[n] the number of periods of demand from an order of a place until its goods can have
        reached the farthest customers."""
        local = np.array([site.lead_time + 1 for site in self.sites])
        ways = [self.lead_time_from_outside(i) for i in range(len(self.sites))]
        reach = [max(ways[i] for i in self.sellers if row[i]) for row in self.serves]
        above = [path - step for path, step in zip(ways, local)]
        return np.array(reach) - np.array(above)

    def _way(self, i: int) -> list[int]:
        """The suppliers of a place, with the nearest first."""
        results, here = [], self.sites[i].supplier
        while here is not None:
            results.append(here)
            here = self.sites[here].supplier
        return results

    @property
    def longest(self) -> int:
        """The longest lead time."""
        return max(site.lead_time for site in self.sites)


@dataclass(frozen=True, eq=False)
class NetworkCase:
    """The data that `snapo solve` needs from a case with places.

    - `demands`, `seasons`: demand and season of the places with customers, in the order of
      `network.sellers`; a season is None if all periods are equal.
    - `holding`: the cost of goods at each place and on their way from it; `shortage`: the cost for
      each place with customers; `transshipment`: the cost of a unit moved, for each pool;
      `ordering`: the cost of an order of any size, for each place in the order of `network.fixed`,
      None if orders cost nothing.
    - Other attributes as in `InventoryCase`.
    """

    file: Path
    notes: tuple[str, ...]
    title: str
    currency: str
    unit: str
    period: str
    network: SupplyNetwork
    demands: tuple[Demand, ...]
    seasons: tuple[CaseInput | None, ...]
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
        """The number of all periods, including the warm-up."""
        return self.warm_up + self.periods

    @property
    def weights(self) -> np.ndarray:
        """[T] the weight of each period's cost: the weight in an average, or a discount factor."""
        age = np.arange(self.horizon) - self.warm_up
        if self.discount == 1:
            return (age >= 0) / self.periods
        return np.where(age >= 0, self.discount ** np.maximum(age, 0), 0.0)

    @property
    def counted(self) -> np.ndarray:
        """[T] the weight of each period in the averages; the weights add up to 1."""
        return (np.arange(self.horizon) >= self.warm_up) / self.periods

    @property
    def value_unit(self) -> str:
        """The unit of the result."""
        return f"{self.currency}/{self.period}" if self.discount == 1 else self.currency

    @property
    def of_demand(self) -> dict[str, CaseInput]:
        """The parameters of the demand of every place, and its season, as "NAME.key"."""
        sellers = zip(self.network.sellers, self.demands, self.seasons)
        return {
            f"{self.network.sites[i].name}.{x.name}": x
            for i, demand, season in sellers
            for x in (*demand.inputs(), *([] if season is None else [season]))
        }

    @property
    def positions(self) -> dict[str, tuple[FilePosition, ...]]:
        """{input: the positions of its numbers} of the demand of every place."""
        return {name: x.positions for name, x in self.of_demand.items()}

    def inputs(self) -> dict[str, Input]:
        """Every number that has a sensitivity; the names of a place's demand parameters are
        "NAME.key"."""
        costs = [self.holding, self.shortage, self.ordering, self.transshipment]
        by_name = {cost.name: cost for cost in costs if cost is not None} | self.of_demand
        return {name: as_input(x) for name, x in by_name.items()}
