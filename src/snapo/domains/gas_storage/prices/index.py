"""A spot price, and the month-ahead index of its market, which energy contracts may pay.

    I(m) = mean over the days d of month m of F(d, s),   s the last day before the month

with F(d, s) the forward price of d on day s. With one Gaussian factor f the index is a function of
f(s). The spot price and the index are therefore functions of two factors: f, and g, which equals
f(s) during the whole month. For prices of kind "one-factor" with volatility v and mean reversion a,

    F(d, s) = F(d, 0) exp(v e g - v^2 e^2 var f(s) / 2),   e = exp(-a (d - s)).

The index of a month that begins on the valuation date is the mean of today's curve.
"""

import datetime
from typing import Any, NamedTuple

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.process import Factors, integral
from snapo.problem.record import Schedule, TreeRecord
from snapo.problem.record.arrays import Array, Bool, Float, Int, jax, jnp

from .factors import FactorTable, GivenFactors
from .process import YEAR, Delivery, GaussianFactors, KnownPrices, PriceProcess, TwoPrices, use

ONE_FACTOR = ("one-factor", "one-factor-normal", "one-factor-shifted")  # kinds with an index


class IndexRows(NamedTuple):
    """The index of each of T + 1 dates: `fixed`, plus the sum of `weight` times the forward prices
    of its days, with `loading` on g and `variance`; leaves [T + 1, D], `fixed` [T + 1].

    `renewed` [T + 1]: whether, between the date before and this date, g is set to the value of f on
    the date before.
    """

    forward: Array
    loading: Array
    variance: Array
    weight: Array
    fixed: Array
    renewed: Array

    def expected(self) -> Array:
        """[T + 1] today's expectation of the index."""
        return (self.weight * self.forward).sum(axis=-1) + self.fixed


class PriceIndex(NamedTuple):
    """The index, as dynamic programs use it. g is the last factor, on which the spot price has no
    loading; `carry` [T + 1, F, F]: the shares of other factors that are carried into g before each
    date."""

    rows: IndexRows
    carry: np.ndarray
    renewed = True
    one_factor = True  # moves this price

    def price(self, of: GaussianFactors, t: int, g: np.ndarray) -> np.ndarray:
        """[n] the index on date t if g has these values [n]."""
        forward, loading, variance, weight, fixed, _ = (np.asarray(x[t]) for x in self.rows)
        noise = of.noise(loading[:, None] * g, variance[:, None])
        return weight @ of.spot(forward[:, None], noise) + fixed

    def at(self, of: GaussianFactors, t: int, factors: np.ndarray) -> np.ndarray:
        """[n] the index on date t if all factors have these values [F, n]."""
        return self.price(of, t, factors[-1])


class IndexMonths(TreeRecord):
    """The months of T + 1 dates; the index of the end date is that of the last day.

    - `days` [T + 1, D]: the dates of the month, by number; `weight`: the weight of each date, 0 for
      an entry without a date.
    - `ahead` [T + 1, D]: years from the day before the month to each date; `fixing_time` [T + 1]:
      years from the valuation date to the day before the month.
    - `renewed` [T + 1]: whether a month begins with the date; false for the first date.
    - `fixed` [T + 1]: 1 if the index was fixed before today, else 0.
    """

    days: Int[np.ndarray, "T+1 D"]
    weight: Float[np.ndarray, "T+1 D"]
    ahead: Float[np.ndarray, "T+1 D"]
    fixing_time: Float[np.ndarray, " T+1"]
    renewed: Bool[np.ndarray, " T+1"]
    fixed: Float[np.ndarray, " T+1"]

    @classmethod
    def of(cls, delivery: Delivery, fixed_first: bool) -> "IndexMonths":
        """The index of a delivery with all days of its months; `fixed_first`: whether days may be
        missing in the first month, since its index was fixed before today."""
        dates = list(delivery.dates)
        months = [(day.year, day.month) for day in dates[:-1]]
        count = len(dates)
        days, weight, ahead = (
            np.zeros((count, 31), int),
            np.zeros((count, 31)),
            np.zeros((count, 31)),
        )
        fixing_time, renewed, fixed = np.zeros(count), np.zeros(count, bool), np.zeros(count)
        for t in range(count - 1):
            first = months.index(months[t])
            last = count - 1 - months[::-1].index(months[t]) - 1
            every = np.arange(first, last + 1)
            before = dates[first].replace(day=1) - datetime.timedelta(1)
            fixing_time[t] = max((before - delivery.valuation).days, 0) / YEAR
            size = len(every)
            days[t, :size], weight[t, :size] = every, 1.0 / size
            years = np.array([(dates[i] - delivery.valuation).days for i in every]) / YEAR
            ahead[t, :size] = years - fixing_time[t]
            renewed[t] = t == first and t > 0
            if fixed_first and first == 0:
                fixed[t], weight[t] = 1.0, 0.0
        for x in (days, weight, ahead, fixing_time, fixed):
            x[-1] = x[-2]
        return cls(days, weight, ahead, fixing_time, renewed, fixed)


class IndexedStep(NamedTuple):
    """A row of the process of the spot price, a row of the index, and whether the next date renews
    g."""

    spot: Any
    index: IndexRows
    renew_next: Array


class IndexedConstants(NamedTuple):
    """The constants of the process of the spot price. `before` [1, n]: the weights, in g on the
    first date, of the noise of the days before; `first` [2]: the variance of g on that date, and
    the share of g in the mean of f."""

    spot: Any
    before: Array
    first: Array


class IndexedState(NamedTuple):
    """The state of the process of the spot price, and g [1]."""

    spot: Any
    at_fixing: Array


class IndexedPrices(TwoPrices):
    """A spot price with one factor, and the month-ahead index; see the top of this file.

    - `spot`: the process of the spot price; `months`: the months of the index.
    - `fixing`: the index of the first month, fixed before today; None if it follows from the curve.
    """

    spot: GivenFactors
    months: IndexMonths
    fixing: CaseInput | None
    kind = "indexed"
    table = FactorTable
    martingale = True

    @property
    def proportional(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.spot.proportional

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.spot.noise_size

    @property
    def initial_noise_size(self) -> int:
        return self.spot.initial_noise_size

    @property
    def initial_steps(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.spot.initial_steps

    def prepare(self, inputs: Any) -> Schedule:
        spot, months = self.spot.prepare(inputs), self.months
        numbers = self.spot.parameters(inputs)
        speed = numbers.mean_reversion[0]
        left = jnp.exp(-speed * months.ahead)
        loading = spot.steps.loading[:, 0][months.days] * left
        variance = loading**2 * integral(2 * speed, jnp.asarray(months.fixing_time))[:, None]
        fixing = jnp.zeros(()) if self.fixing is None else use(inputs, self.fixing)
        rows = IndexRows(
            spot.steps.forward[months.days],
            loading,
            variance,
            jnp.asarray(months.weight),
            jnp.asarray(months.fixed) * fixing,
            jnp.asarray(months.renewed),
        )
        following = jnp.append(months.renewed[1:], False)
        constants = IndexedConstants(spot.constants, *self._first(numbers))
        return Schedule(constants, IndexedStep(spot.steps, rows, following))

    def second_price(self) -> KnownPrices:
        months, none = self.months, np.zeros(0)
        forward = self.spot.delivery.on_dates(self.spot.delivery.curve.used())
        fixed = months.fixed * (0.0 if self.fixing is None else self.fixing.used())
        rows: Any = forward[months.days], none, none, months.weight, fixed, months.renewed
        return KnownPrices(IndexRows(*rows))

    def _first(self, numbers: Factors) -> tuple[Array, Array]:
        """The fields `before` and `first` of `IndexedConstants`."""
        months, age, speed = self.months, self.spot.delivery.age, numbers.mean_reversion[0]
        free = 1.0 - months.fixed[0]
        # A day's shock moves g where it came before the last day before the month.
        earlier = age - (self.spot.delivery.years[0] - months.fixing_time[0])
        share = jnp.exp(-speed * jnp.maximum(earlier, 0.0)) * (earlier > -0.5 / YEAR) * free
        before = share * self.spot.day_shock(numbers)[0, 0]
        variance = free * integral(2 * speed, jnp.asarray(months.fixing_time[0]))
        decay = jnp.exp(-speed * (self.spot.delivery.years[0] - months.fixing_time[0]))
        return before[None], jnp.stack([variance, decay])

    def initial(self, constants, noise):
        return IndexedState(self.spot.initial(constants.spot, noise), constants.before @ noise)

    def step(self, constants, now, state, noise):
        at_fixing = jnp.where(now.renew_next, state.spot, state.at_fixing)
        return IndexedState(self.spot.step(constants.spot, now.spot, state.spot, noise), at_fixing)

    def level(self, constants, now, state):
        return self.spot.level(constants.spot, now.spot, state.spot)

    def index(self, constants, now, state) -> Array:
        """The index of the date."""

        def price_on_fixing(forward, loading, variance):
            row = now.spot._replace(forward=forward, loading=loading[None], variance=variance)
            return self.spot.level(constants.spot, row, state.at_fixing)

        row = now.index
        return (
            row.weight @ jax.vmap(price_on_fixing)(row.forward, row.loading, row.variance)
            + row.fixed
        )

    def forward(self, constants, now):
        return self.spot.forward(constants.spot, now.spot)

    def observe(self, constants, now, state):
        pair = state.spot, state.at_fixing
        return jnp.concatenate([self.spot.observe(constants.spot, now.spot, x) for x in pair])

    def state_at(self, constants, now, spot):
        state = self.spot.state_at(constants.spot, now.spot, spot)
        return IndexedState(state, jnp.zeros_like(state))

    def fast(self, state):
        return self.spot.fast(state.spot)

    def gaussian(self, state):
        return jnp.concatenate([state.spot, state.at_fixing])

    def price_scale(self, prices, values):
        return self.spot.price_scale(prices, values)

    def price_spread(self, prices, values):
        return self.spot.price_spread(prices, values)

    def factors(self, schedule):
        steps, rows = schedule.steps.spot, schedule.steps.index
        of = self.spot.factors(Schedule(schedule.constants.spot, steps))
        none, renewed = np.zeros_like(of.loading), np.asarray(rows.renewed)
        shock, carry = np.zeros((len(none), 2, 2)), np.zeros((len(none), 2, 2))
        shock[:, :1, :1], carry[renewed, 1, 0] = of.shock, 1.0
        shock[0] = _joint(of.shock[0, 0, 0], *schedule.constants.first)
        return of._replace(
            loading=np.concatenate([of.loading, none], axis=1),
            decay=np.concatenate([of.decay, 1.0 - renewed[:, None]], axis=1),
            shock=shock,
            index=PriceIndex(rows, carry),
        )

    def describe(self) -> str:
        return f"{self.spot.describe()}; with a month-ahead index"


def _joint(deviation: float, variance: float, share: float) -> np.ndarray:
    """[2, 2] the lower Cholesky factor of the covariance of f, with this standard deviation, and
    g."""
    below = share * variance / deviation if deviation > 0 else 0.0
    return np.array([[deviation, 0.0], [below, np.sqrt(max(variance - below**2, 0.0))]])


def indexed(prices: PriceProcess, delivery: Delivery, fixing: CaseInput | None) -> IndexedPrices:
    """The prices of a case, which have one factor, with the month-ahead index added."""
    if not isinstance(prices, GivenFactors) or prices.noise_size != 1:
        raise TypeError(f"{type(prices).__name__} has no month-ahead index")
    months = IndexMonths.of(delivery, fixing is not None)
    return IndexedPrices(prices, months, fixing)  # pyright: ignore[reportCallIssue]
