"""A price process of a gas store: the `Process` of the core, with additions for storage contracts.

Everything that depends on the kind of price is in its class: its table in the case file, its
parameters, noise, dynamics, forward price and description. Nothing outside the class depends on the
kind.
"""

import abc
import datetime
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.plausible import Plausible
from snapo.case.quantity import NOT_NEGATIVE, Quantity, Range, on_dates
from snapo.case.table import CaseTable, TableContext
from snapo.problem.form import Use
from snapo.problem.process import Gaps, Process
from snapo.problem.record import AbstractClassVar, AbstractVar, TreeRecord, field
from snapo.problem.record.arrays import Array, Float, jnp

from .spikes import Spikes

if TYPE_CHECKING:
    from snapo.problem.scenarios import Sources

YEAR = 365.0
FEWEST = 32  # days of noise before the first date, where they are several

SPEED = "it is per year: ln 2 divided by the half-life in years"
VOLATILITY = Quantity(
    "1/sqrt(year)",
    NOT_NEGATIVE,
    "volatility",
    move=0.01,
    display_unit="volatility point",
    display_factor=100.0,
    limits=Range(0.0, 50.0, note=" (5,000 % a year)"),
    plausible=Plausible(0.005, 5.0, "a fraction is expected (0.85 is 85 %)"),
)
REVERSION = Quantity(
    "1/year",
    NOT_NEGATIVE,
    "price model",
    move=1.0,
    limits=Range(0.0, 1e5, note=" (a half-life of 4 minutes)"),
    plausible=Plausible(0.05, 1000.0, SPEED),
)


class SingleFactorTable(CaseTable):
    """The factor of a price with one factor: { mean_reversion = 12.0, volatility = 0.6 }"""

    mean_reversion: CaseInput = REVERSION("speed at which the factor returns to zero")
    volatility: CaseInput = VOLATILITY("volatility of the factor, by delivery day", by="date")


class Delivery(NamedTuple):
    """The days for which a process has prices, and their market.

    - `days`: the T decision days; `end`: the end date, which follows them as number T.
    - `price_days`: the days that need a price; they include the end date only if remaining gas is
      paid at its price.
    - `valuation`: the date of the curve.
    - `curve`: the forward price of each of `price_days`.
    - `nominated`: [T + 1] the day on which the flow of each date is fixed; None if it is fixed on
      that date.
    """

    days: Sequence[datetime.date]
    price_days: Sequence[datetime.date]
    end: datetime.date
    valuation: datetime.date
    curve: CaseInput
    nominated: Sequence[datetime.date] | None = None

    @property
    def dates(self) -> tuple[datetime.date, ...]:
        """[T + 1] the decision days and the end date."""
        return (*self.days, self.end)

    @property
    def ahead(self) -> tuple[int, ...]:
        """[T + 1] the days from the valuation date to each date, or to the nomination of its flow;
        not negative."""
        return self._days_to(self.dates if self.nominated is None else self.nominated)

    def _days_to(self, dates: Sequence[datetime.date]) -> tuple[int, ...]:
        return tuple(max((date - self.valuation).days, 0) for date in dates)

    @property
    def times(self) -> "Times":
        """The part of the delivery that a process keeps: times and prices."""
        notice = None
        if self.nominated is not None:
            notice = np.subtract(self._days_to(self.dates), self.ahead) / YEAR
        return Times.of(self.ahead, YEAR, self.curve, notice)


class Times(TreeRecord):
    """The dates on which a process has prices, and today's expectations of these prices.

    - `years` [T + 1]: the time of each date from the valuation date, Act/365; `gaps`: the times
      between the dates.
    - `curve`: the forward price of each date, except of an end date that needs no price.
    - `age` [n]: the time from the end of each of the n days after the valuation date to the first
      date. It is negative for days after the first date, which are included so that code is
      compiled for only a few numbers n. `before`: n, or 0 if the first date is the valuation date.
    - `notice` [T + 1]: if flows are nominated, `years` is the time of the nomination, and `notice`
      the time from the nomination to the date; the price is then the forward price of the date.
    - `day`: the interval of one of these n days, which are hours in an hourly contract.
    """

    years: Float[np.ndarray, " T+1"]
    gaps: Gaps
    curve: CaseInput
    age: Float[np.ndarray, " n"]
    before: int = field(static=True)
    notice: Float[np.ndarray, " T+1"] | None
    day: Gaps

    @classmethod
    def of(cls, ahead: Sequence[int], year: float, curve: Any, notice: Any) -> "Times":
        """The times of dates that come `ahead` [T + 1] days or hours after the valuation date;
        `year`: the number of these in a year."""
        years, before = np.array(ahead) / year, ahead[0]
        rows = before if before < 2 else max(FEWEST, 1 << (before - 1).bit_length())
        age = (before - 1 - np.arange(max(rows, 1))) / year
        day = Gaps.of([(before + 1) / year - before / year])  # in floats, as a step of `years`
        return cls(years, Gaps.of(years.tolist()), curve, age, rows, notice, day)

    def forward(self, inputs: dict[str, Any]) -> Float[Array, " T+1"]:
        """The forward price of each date; an end date without a price gets the last price."""
        return self.on_dates(use(inputs, self.curve))

    def on_dates(self, prices: Any) -> Any:
        """[T + 1] the forward prices of the curve on all dates."""
        return prices[np.minimum(np.arange(len(self.years)), max(len(prices) - 1, 0))]


class GaussianFactors(NamedTuple):
    """Factors of the spot price as a dynamic program uses them, on the T days and the end date.

        S = (F + shift) exp(loading f - variance / 2) - shift, or with `additive` S = F + loading f.

    - `loading` [T + 1, F], `variance` [T + 1] of loading f.
    - `decay` [T + 1, F] and `shock` [T + 1, F, F] (lower Cholesky factor) apply from the previous
      date to each date. The date before the first is the valuation date, on which all factors are
      0.
    - `fast`: the factor that a one-factor dynamic program uses.
    - `exact`: whether these factors are the whole process, so that a lattice gives the exact value.
    - `spikes`: the spikes of ln S in addition to the factors; they are a further coordinate after
      the factors.
    - `index`: a second price of a contract, with a separate factor (a `PriceIndex`).
    """

    loading: np.ndarray
    variance: np.ndarray
    decay: np.ndarray
    shock: np.ndarray
    fast: int = 0
    exact: bool = True
    additive: bool = False
    shift: float = 0.0
    spikes: Spikes | None = None
    index: Any = None

    @property
    def transition(self) -> np.ndarray:
        """[T + 1, F, F] the matrices that map the factors of the date before to their means on each
        date."""
        local = self.decay[:, :, None] * np.eye(self.decay.shape[1])
        return local if self.index is None else local + self.index.carry

    @property
    def covariance(self) -> np.ndarray:
        """[T + 1, F, F] the covariance of the factors on each date."""
        covariance, covariances = np.zeros(self.shock.shape[1:]), []
        for move, shock in zip(self.transition, self.shock, strict=True):
            covariance = move @ covariance @ move.T + shock @ shock.T
            covariances.append(covariance)
        return np.array(covariances)

    @property
    def proportional(self) -> bool:
        """Whether every price is the forward price times noise."""
        return not self.additive and self.shift == 0

    def noise(self, moved: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """The random part of a price; `moved`: loading times f, with this variance."""
        return moved if self.additive else np.exp(moved - variance / 2)

    def spot(self, forward: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """The price, from its forward price and this noise."""
        if self.additive:
            return forward + noise
        return (forward + self.shift) * noise - self.shift

    def by_forward(self, noise: np.ndarray) -> np.ndarray:
        """The derivative of `spot` with respect to the forward price."""
        return np.ones_like(noise) if self.additive else noise


class PriceProcess(Process):
    """A price process of a store, with further members in addition to those of `Process` of the
    core. After reading it has the numbers of the case; in a simulator it has no numbers (see
    `snapo.problem.form`), and methods for paths read the numbers from their `inputs`.

    The level is the spot price in currency per unit; the state contains the prices only. `prepare`
    returns T + 1 rows: the decision days, and the end date.

    **Class attributes:** `kind`, the name in `[model]`; `table`, its keys.

    **Attributes:** `proportional`: whether every price is the forward price times noise, so that it
    scales with the curve (which must then be positive). `initial_steps`: the initial state is
    computed from the noise of this number of days after the valuation date; if it is 0, the initial
    state is drawn separately.
    """

    initial_steps: ClassVar[int] = 0

    kind: AbstractClassVar[str]
    table: AbstractClassVar[type[CaseTable]]
    proportional: AbstractVar[bool]

    @classmethod
    def read(cls, section: TableContext, table: Any, delivery: Delivery) -> Self:
        """The process with the numbers of its table in the case file, on the delivery days."""
        return cls.of(delivery, **on_dates(table, delivery.dates, section.notes))

    @classmethod
    def of(cls, delivery: Delivery, **numbers: CaseInput) -> Self:
        """The process with these numbers, {field: numbers}, on the days of a delivery."""
        return cls(delivery.times, **numbers)  # pyright: ignore

    @property
    def lowest(self) -> float:
        """The number that all spot and forward prices are above."""
        return 0.0 if self.proportional else -np.inf

    @property
    def calendar(self) -> tuple[float, ...]:
        """[T + 1] the time from each nomination to its date, if flows are nominated; otherwise
        ()."""
        return ()

    @abc.abstractmethod
    def state_at(self, constants, now, spot: Float[Array, ""]):
        """The state with this spot price, in which only the fast factor differs from zero."""

    def fast(self, state) -> Float[Array, ""]:
        """The coordinate of the state that the one-factor dynamic program uses; 0 if there is
        none."""
        return jnp.zeros(())

    def gaussian(self, state) -> Float[Array, " F"]:
        """The values of the factors that `factors` describes, and of its spikes."""
        return jnp.atleast_1d(self.fast(state))

    def slow_level(self, constants, now, state) -> Float[Array, ""]:
        """The price level without the fast factor, relative to the forward curve; it is about 1."""
        return jnp.ones(())

    def factors(self, schedule) -> GaussianFactors | None:
        """Factors for dynamic programs, from the prepared schedule of the process. None if there
        are none; the policy then begins without the values of a dynamic program."""
        return None

    def price_scale(self, prices: np.ndarray, values: Mapping[str, np.ndarray]) -> float:
        """The typical size of a price, from the forward prices and the values of all inputs."""
        return float(np.mean(np.abs(prices)))

    def price_spread(self, prices: np.ndarray, values: Mapping[str, np.ndarray]) -> float | None:
        """The possible distance of spot prices from the forward price, in money; None if this
        distance is proportional to the forward price."""
        return None

    def second_price(self) -> "KnownPrices | None":
        """The second price of a case at its forward prices, in NumPy; None without a second
        price."""
        return None

    def sources(self, seed: int) -> "Sources | None":
        """Separate scenarios for training, validation and evaluation, instead of normal draws; None
        if normals are drawn."""
        return None


class KnownPrices(NamedTuple):
    """`index`: the rows of a second price that today's expectation needs."""

    index: Any


class TwoPrices(PriceProcess):
    """A spot price, and a second price on which the cash of a contract depends."""

    @abc.abstractmethod
    def second_price(self) -> KnownPrices: ...

    @abc.abstractmethod
    def index(self, constants, now, state) -> Float[Array, ""]:
        """The second price of the date; its numbers are in `index` of the row `now`."""


def use(inputs: dict[str, Any], series: CaseInput | Use):
    """The numbers of an input in the form in which they are used: its values at their index."""
    return (series if isinstance(series, Use) else series.use())(inputs)


def in_numpy(values: Mapping[str, np.ndarray], series: CaseInput | Use) -> np.ndarray:
    """The numbers of an input in the form in which they are used, in NumPy."""
    return (series if isinstance(series, Use) else series.use()).in_numpy(values)


KINDS: dict[str, type[PriceProcess]] = {}


Registered = TypeVar("Registered", bound=PriceProcess)


def register(process: type[Registered]) -> type[Registered]:
    """Registers a process under its `kind`; refuses an incomplete class."""
    missing = missing_members(process)
    if missing:
        raise TypeError(f"price process {process.__name__} has no {', '.join(missing)}")
    if process.kind in KINDS:
        raise TypeError(f"price process {process.__name__}: {process.kind!r} is registered already")
    KINDS[process.kind] = process
    return process


def missing_members(process: type[PriceProcess]) -> list[str]:
    """The names of the required methods and attributes that a class does not define."""
    marks = ("__abstractmethods__", "__abstractvars__", "__abstractclassvars__")
    return sorted(name for mark in marks for name in getattr(process, mark, ()))
