"""A gas-storage case as resolved data: frozen records of NumPy arrays, every date settled.

T is the number of decision days (`StorageCase.days`), K the number of ratchet rows of a day (1
without ratchets), F the number of price factors. Index T stands for the end date. Days are
integers since the valuation date and may be negative for a payment that lies before it. A
`Given` keeps the numbers as they were given; the per-day array is `given.values[given.index]`.
"""

import datetime
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from snapo.case.given import Given
from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable


@dataclass(frozen=True, eq=False)
class Ratchets:
    """How fast gas may move, by day and by inventory at the start of the day.

    Rows of a day rise in inventory; a block with fewer than K rows repeats its last one. With
    "linear" the rates are interpolated between rows, with "step" the row at or below holds.
    Plain `max_injection` and `max_withdrawal` are K = 1: one row, at inventory 0, for any level.

    - `inventory`: levels in volume, index [T, K].
    - `withdrawal`, `injection`: most volume per day, not negative, index [T, K]; before outages.
    """

    inventory: Given
    withdrawal: Given
    injection: Given
    interpolation: Literal["linear", "step"]


@dataclass(frozen=True, eq=False)
class LevelAtEnd:
    """The inventory that must be in store on the end date: one number, index []."""

    inventory: Given


@dataclass(frozen=True, eq=False)
class PriceAtEnd:
    """Gas left on the end date is worth `fraction` of that day's spot price: one number, index [].

    It is paid on the end date. With a fraction of 0 what is left is worthless, and the end date
    needs no price.
    """

    fraction: Given


@dataclass(frozen=True, eq=False)
class ValueAtEnd:
    """What the inventory on the end date is worth: linear between M points, paid on that date.

    - `inventory`: levels, strictly rising, index [M]; `value`: currency, index [M].
    """

    inventory: Given
    value: Given


EndRule = LevelAtEnd | PriceAtEnd | ValueAtEnd


@dataclass(frozen=True, eq=False)
class Contract:
    """What may be done, and what it costs. All volumes are in `StorageCase.volume_unit`.

    - `inventory`: in store at the start of the first decision day, index [].
    - `min_inventory`, `max_inventory`: limits at the START of day t, and on the end date,
      index [T + 1].
    - `ratchets`: rates before outages.
    - `injection_factor`, `withdrawal_factor`: [T] share of the rates left by outages, 0 to 1.
    - `min_injection`, `min_withdrawal`: forced flows per day, index [T]; never both on one day.
    - `injection_cost`, `withdrawal_cost`: currency per unit, index [T].
    - `injection_cost_day`, `withdrawal_cost_day`: [T] day on which that cost is paid.
    - `injection_fuel`, `withdrawal_fuel`: fraction of the volume, at spot, index [T].
    - `inventory_loss`: fraction of the inventory per day, index [T].
    - `inventory_cost`: currency per unit and day, paid on the day, index [T].
    - `fixed_costs`: amounts in currency, index [n] those not before the valuation date;
      `fixed_cost_day`: [n] day on which each of them is paid.
    """

    inventory: Given
    min_inventory: Given
    max_inventory: Given
    ratchets: Ratchets
    injection_factor: np.ndarray
    withdrawal_factor: np.ndarray
    min_injection: Given
    min_withdrawal: Given
    injection_cost: Given
    withdrawal_cost: Given
    injection_cost_day: np.ndarray
    withdrawal_cost_day: np.ndarray
    injection_fuel: Given
    withdrawal_fuel: Given
    inventory_loss: Given
    inventory_cost: Given
    at_end: EndRule
    fixed_costs: Given
    fixed_cost_day: np.ndarray


@dataclass(frozen=True, eq=False)
class Market:
    """Prices and discounting, seen from the valuation date.

    - `forward_curve`: one price per decision day, currency per unit, labelled by the day, index
      [T]; where `StorageCase.has_end_price`, one more for the end date, index [T + 1].
    - `zero_rate`: continuous, Act/365, index [n] all nodes; linear in days, flat outside.
    - `zero_rate_day`: [n] integer days of the nodes, strictly rising (one 0 for a plain number).
    - `gas_day`: [T] day on which the gas of day t is paid.

    A payment on day d is discounted by exp(-r(d) d / 365), and not at all where d <= 0.
    """

    forward_curve: Given
    zero_rate: Given
    zero_rate_day: np.ndarray
    gas_day: np.ndarray


@dataclass(frozen=True, eq=False)
class FactorModel:
    """S(T) = F(T) exp(sum_i s_i(T) f_i(T) - variance / 2), correlated Ornstein-Uhlenbeck factors.

    Kinds "one-factor" (F = 1) and "multi-factor". df_i = -a_i f_i dt + dW_i, f_i = 0 on the
    valuation date, dW_i dW_j = rho_ij dt; the volatility s_i belongs to the delivery day.

    - `mean_reversion`: 1/year, 0 allowed, index [F].
    - `volatility`: 1/sqrt(year), index [T + 1, F].
    - `correlation`: the strict lower triangle, row by row, index [F (F - 1) / 2].
    """

    kind: Literal["one-factor", "multi-factor"]
    mean_reversion: Given
    volatility: Given
    correlation: Given

    def correlation_matrix(self) -> np.ndarray:
        """The full matrix [F, F] of the correlations given."""
        size = len(self.mean_reversion.values)
        lower = np.zeros((size, size))
        lower[np.tril_indices(size, -1)] = self.correlation.values
        return lower + lower.T + np.eye(size)


@dataclass(frozen=True, eq=False)
class SeasonalModel:
    """Kind "three-factor-seasonal": independent spot, long-term and seasonal factors.

    Loadings: s_spot (mean reversion a), s_long (none), s_seas(T) = `seasonal_volatility` / 2 x
    `season`(T) (none). Source: the multi-factor seasonal model of the package cmdty-storage.

    - `spot_mean_reversion` (1/year), `spot_volatility`, `long_term_volatility`,
      `seasonal_volatility` (1/sqrt(year)): one number each, index [].
    - `season`: [T + 1] cos(2 pi d / 365.25), d = days from 1 February of the valuation year.
    """

    spot_mean_reversion: Given
    spot_volatility: Given
    long_term_volatility: Given
    seasonal_volatility: Given
    season: np.ndarray
    kind: Literal["three-factor-seasonal"] = "three-factor-seasonal"


@dataclass(frozen=True, eq=False)
class SuppliedModel:
    """Kind "supplied": price paths from two different files, one to train on, one to evaluate on.

    With `rescaled` the arrays are the noise: each day divided by its mean over the paths of its
    own file, to be multiplied by the forward curve. Without, they are prices in currency per unit.

    - `training`, `evaluation`: [paths, T], or [paths, T + 1] where `StorageCase.has_end_price`.
    """

    training: np.ndarray
    evaluation: np.ndarray
    rescaled: bool
    kind: Literal["supplied"] = "supplied"


Model = FactorModel | SeasonalModel | SuppliedModel


@dataclass(frozen=True, eq=False)
class StorageCase:
    """Everything that a gas-storage case says.

    - `file`: the case file; `title`, `volume_unit`, `currency`: for reports.
    - `days`: [T] decision dates, from `start` (or the valuation date, or the day after it) to the
      day before `end`; empty when the valuation leaves none.
    - `day`: [T] the same as integer days since the valuation date; `end_day`: of the end date.
    - `expired`: the valuation date lies after the end date; the value is zero.
    - `notes`: remarks for the owner of the case, one sentence each.
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
    market: Market
    model: Model
    objective: ObjectiveTable
    training: TrainingTable
    evaluation: EvaluationTable
    notes: tuple[str, ...] = ()

    kind = "gas-storage"

    @property
    def has_end_price(self) -> bool:
        """Whether the value of the gas left depends on the spot price of the end date."""
        at_end = self.contract.at_end
        return isinstance(at_end, PriceAtEnd) and bool(at_end.fraction.values[0] != 0)
