"""Gaussian prices with one or several factors, with mean reversions, and volatilities by delivery
day.

The common part of all Gaussian factor prices comes first; each kind adds its parameters.
"""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from snapo.case.given import CaseInput, Copies, FilePosition
from snapo.case.quantity import Quantity, Range, stacked
from snapo.case.table import CaseTable, TableContext, doc, parse
from snapo.problem.process import FactorPrice, Factors, Gaps
from snapo.problem.record import AbstractVar, Schedule, field
from snapo.problem.record.arrays import Array, jnp

from .process import (
    REVERSION,
    VOLATILITY,
    Delivery,
    GaussianFactors,
    PriceProcess,
    Times,
    register,
    use,
)


class StorageStep(NamedTuple):
    """A row of `FactorStep` of the core, and the variance of ln S without the fast factor."""

    forward: Array
    loading: Array
    variance: Array
    next_decay: Array
    next_shock: Array
    slow_variance: Array


class StorageConstants(NamedTuple):
    """The `FactorConstants` of the core, and `before` [F, n F]: the matrix that maps the noise of
    the n days before the first date to the factors on that date, with the covariance of
    `first_shock`."""

    first_shock: Array
    size: Array
    before: Array


class FactorPrices(FactorPrice, PriceProcess):
    """Correlated mean-reverting factors around the forward curve; see `FactorPrice` of the core."""

    delivery: AbstractVar[Times]
    fast_factor: AbstractVar[int]  # which reverts fastest, among those that move prices
    proportional = True
    time_scale = 1.0

    @property
    def times(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.delivery.years

    @property
    def gaps(self) -> Gaps:
        return self.delivery.gaps

    @property
    def initial_steps(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.delivery.before

    @property
    def initial_noise_size(self) -> int:
        return max(self.initial_steps, 1) * self.noise_size

    def prepare(self, inputs) -> Schedule:
        numbers = self._when_nominated(self.parameters(inputs))
        rows = self.schedule(numbers)
        slow = numbers.loading * (np.arange(self.noise_size) != self.fast_factor)
        variance = jnp.einsum("ti,tij,tj->t", slow, self.covariance(numbers), slow)
        # The share of every earlier day's shock that is left on the first date.
        age = self.delivery.age[:, None]
        left = jnp.exp(-numbers.mean_reversion * jnp.maximum(age, 0.0)) * (age >= 0)
        before = jnp.einsum("nf,fg->fng", left, self.day_shock(numbers))
        before = before.reshape(self.noise_size, self.initial_noise_size)
        return Schedule(
            StorageConstants(**rows.constants._asdict(), before=before),
            StorageStep(**rows.steps._asdict(), slow_variance=variance),
        )

    def day_shock(self, numbers: Factors) -> Array:
        """[F, F] the shock of one of the days before the first date."""
        pair = numbers.mean_reversion[:, None] + numbers.mean_reversion[None, :]
        return self.delivery.day.shocks(numbers.correlation, pair)[0]

    @property
    def calendar(self) -> tuple[float, ...]:
        notice = self.delivery.notice
        return () if notice is None else tuple(notice.tolist())

    def _when_nominated(self, numbers: Factors) -> Factors:
        """The factors of prices if flows are nominated. At a time u before its date, a forward
        price has the loading of the spot price times exp(-a u)."""
        notice = self.delivery.notice
        if notice is None:
            return numbers
        left = jnp.exp(-numbers.mean_reversion * notice[:, None])
        return numbers._replace(loading=numbers.loading * left)

    def initial(self, constants, noise):
        return constants.before @ noise

    def state_at(self, constants, now, spot):
        loading = now.loading[self.fast_factor]
        moved = jnp.log(spot / now.forward) + now.variance / 2
        moved = moved / jnp.where(loading > 0, loading, 1.0)
        state = jnp.zeros(self.noise_size)
        return state.at[self.fast_factor].set(jnp.where(loading > 0, moved, 0.0))

    def fast(self, state):
        return state[self.fast_factor]

    def gaussian(self, state):
        return state

    def slow_level(self, constants, now, state):
        slow = np.arange(self.noise_size) != self.fast_factor
        if not slow.any():
            return jnp.asarray(1.0)
        return jnp.exp(jnp.sum((now.loading * state)[slow]) - now.slow_variance / 2)

    def factors(self, schedule):
        steps, first = schedule.steps, schedule.constants.first_shock
        return GaussianFactors(
            steps.loading,
            steps.variance,
            np.concatenate([np.ones_like(steps.next_decay[:1]), steps.next_decay[:-1]]),
            np.concatenate([first[None], steps.next_shock[:-1]]),
            self.fast_factor,
        )


class FactorTable(CaseTable):
    """A factor: { mean_reversion = 12.0, volatility = 0.6 }"""

    mean_reversion: CaseInput = REVERSION("speed at which a factor returns to zero")
    volatility: CaseInput = VOLATILITY("volatility of a factor, by delivery day", by="date")


CORRELATION = Quantity(
    range=Range(-1.0, 1.0),
    group="price model",
    move=0.01,
    meaning="correlation of the shocks of two factors",
)


class GivenFactors(FactorPrices):
    """Factors whose numbers are specified separately.

    - `mean_reversion`: 1/year, 0 allowed, index [F].
    - `volatility`: 1/sqrt(year), by delivery day, index [T + 1, F].
    - `correlation`: the strict lower triangle, row by row, index [F (F - 1) / 2].
    """

    delivery: Times
    mean_reversion: CaseInput
    volatility: CaseInput
    correlation: CaseInput
    noise_size: int = field(static=True)
    fast_factor: int = field(static=True)

    @classmethod
    def read(cls, section: TableContext, table: FactorTable, delivery: Delivery):
        return cls.of(delivery, **read_factors(section, [table], [], [], delivery))

    @classmethod
    def of(
        cls,
        delivery: Delivery,
        mean_reversion: CaseInput,
        volatility: CaseInput,
        correlation: CaseInput,
        **more: CaseInput,
    ):
        """The process with its number of factors and its fast factor; `more`: the fields of a
        subclass."""
        moves = volatility.used().max(axis=0) > 0
        fast = int(np.argmax(np.where(moves, mean_reversion.used(), -1.0)))
        numbers = mean_reversion, volatility, correlation
        size = len(mean_reversion.values)
        return cls(delivery.times, *numbers, size, fast, **more)  # pyright: ignore

    def parameters(self, inputs) -> Factors:
        size = self.noise_size
        lower = jnp.zeros((size, size))
        lower = lower.at[np.tril_indices(size, -1)].set(use(inputs, self.correlation))
        return Factors(
            self.delivery.forward(inputs),
            use(inputs, self.mean_reversion),
            use(inputs, self.volatility),
            lower + lower.T + jnp.eye(size),
        )


def read_factors(
    section: TableContext,
    factors: Sequence[FactorTable],
    correlation: Sequence[float],
    positions: Sequence[FilePosition],
    delivery: Delivery,
) -> dict[str, CaseInput]:
    """Reads the numbers of several factors, with the strict lower triangle of their
    correlations."""
    count, dates = len(factors), delivery.dates
    volatilities = [factor.volatility.on(dates, section.notes) for factor in factors]
    pairs = [f"{i},{j}" for i in range(2, count + 1) for j in range(1, i)]
    numbers = (
        stacked("mean_reversion", [factor.mean_reversion for factor in factors]),
        stacked("volatility", volatilities),
        CORRELATION.input("correlation", correlation, pairs, positions=tuple(positions)),
    )
    return {values.name: values for values in numbers}


class OneFactorTable(FactorTable):
    """`[model]` of kind "one-factor"."""

    kind: Literal["one-factor"] = doc("one mean-reverting factor")


@register
class OneFactor(GivenFactors):
    """S = F exp(s f - variance / 2), one Ornstein-Uhlenbeck factor."""

    kind = "one-factor"
    table = OneFactorTable

    def describe(self) -> str:
        return "One factor, mean-reverting, volatility by delivery day"


class MultiFactorTable(CaseTable):
    """`[model]` of kind "multi-factor"; each of `factors` is a `FactorTable`."""

    kind: Literal["multi-factor"] = doc("several correlated factors")
    factors: list[Any] = doc(
        "mean reversion and volatility of every factor",
        allowed="a list like [{ mean_reversion = 12.0, volatility = 0.6 }]", min_length=1,
    )  # fmt: skip
    correlation: list[list[float]] | None = doc(
        "correlations of the shocks of the factors", None,
        "a square matrix of numbers, like [[1.0, 0.3], [0.3, 1.0]]",
    )  # fmt: skip


@register
class MultiFactor(GivenFactors):
    """S = F exp(sum_i s_i f_i - variance / 2), correlated Ornstein-Uhlenbeck factors."""

    kind = "multi-factor"
    table = MultiFactorTable

    @classmethod
    def read(cls, section: TableContext, table: MultiFactorTable, delivery: Delivery):
        file = str(section.file)
        factors = [
            parse(
                FactorTable,
                entry,
                file,
                f"{section.name}.factors.{i + 1}",
                section.notes,
                (*section.keys, "factors", i),
            )
            for i, entry in enumerate(table.factors)
        ]
        correlation = _correlation(section, table.correlation, len(factors))
        key, count = (*section.keys, "correlation"), len(factors)
        pairs = [(i, j) for i in range(count) for j in range(i)]
        positions = [Copies(((*key, i, j), (*key, j, i))) for i, j in pairs]
        return cls.of(delivery, **read_factors(section, factors, correlation, positions, delivery))

    def describe(self) -> str:
        return "Correlated mean-reverting factors"


def _correlation(section: TableContext, values, size: int) -> list[float]:
    """The strict lower triangle of a matrix; refuses a matrix that is not a correlation matrix."""
    if values is None and size == 1:
        return []
    if values is None:
        message = f"{size} factors need a correlation matrix of {size} rows and {size} columns"
        raise section.error("correlation", None, message)
    if len(values) != size or any(len(row) != size for row in values):
        message = f"{size} factors need {size} rows and {size} columns"
        raise section.error("correlation", values, message)
    matrix = np.array(values, np.float64)
    for i in range(size):
        if matrix[i, i] != 1:
            raise section.error(f"correlation.{i + 1},{i + 1}", matrix[i, i], "it must be 1")
        for j in range(i):
            if matrix[i, j] != matrix[j, i]:
                message = f"the matrix must be symmetric, but {j + 1},{i + 1} is {matrix[j, i]:g}"
                raise section.error(f"correlation.{i + 1},{j + 1}", matrix[i, j], message)
            if not -1 <= matrix[i, j] <= 1:
                message = "it must be a number from -1 to 1"
                raise section.error(f"correlation.{i + 1},{j + 1}", matrix[i, j], message)
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest <= 1e-12:
        message = (
            "a correlation matrix must be positive definite, but the smallest eigenvalue of this "
            f"one is {smallest:.3g}; combine factors that always move together into one factor"
        )
        raise section.error("correlation", values, message)
    return list(matrix[np.tril_indices(size, -1)])
