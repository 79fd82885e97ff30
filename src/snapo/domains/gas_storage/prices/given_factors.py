"""Factors whose volatilities and mean reversions are given one by one, by delivery day."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from pydantic import Field

from snapo.case.dates import dated
from snapo.case.given import Given
from snapo.case.table import Section, Table
from snapo.problem.process import Factors

from ..read.tables import AMOUNT, FileName, NotNegative
from .factor_prices import FactorPrices
from .process import REVERSION, VOLATILITY, Delivery, Times, use


class FactorTable(Table):
    """A factor: { mean_reversion = 12.0, volatility = 0.6 }"""

    mean_reversion: NotNegative = Field(description="a number of at least 0")
    volatility: NotNegative | FileName = Field(description=AMOUNT)


class GivenFactors(FactorPrices):
    """Factors whose numbers are given one by one.

    - `mean_reversion`: 1/year, 0 allowed, index [F].
    - `volatility`: 1/sqrt(year), by delivery day, index [T + 1, F].
    - `correlation`: the strict lower triangle, row by row, index [F (F - 1) / 2].
    """

    delivery: Times
    mean_reversion: Given
    volatility: Given
    correlation: Given
    noise_size: int = eqx.field(static=True)
    fast_factor: int = eqx.field(static=True)

    @classmethod
    def of(cls, delivery: Delivery, mean_reversion: Given, volatility: Given, correlation: Given):
        """With the number of factors, and the fast one among them."""
        moves = volatility.used().max(axis=0) > 0
        fast = int(np.argmax(np.where(moves, mean_reversion.used(), -1.0)))
        numbers = mean_reversion, volatility, correlation
        size = len(mean_reversion.values)
        return cls(delivery.times, *numbers, size, fast)  # pyright: ignore[reportCallIssue]

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

    def correlation_matrix(self) -> np.ndarray:
        """The full matrix [F, F] of the correlations given."""
        size = self.noise_size
        lower = np.zeros((size, size))
        lower[np.tril_indices(size, -1)] = self.correlation.values
        return lower + lower.T + np.eye(size)


def read_factors(section: Section, factors, correlation, delivery: Delivery, numbered: bool):
    """Puts the factors' numbers end to end; `index` says which of them day t and factor i use."""
    values, labels, columns = [], [], []
    for number, factor in enumerate(factors, 1):
        key = f"factors.{number}.volatility" if numbered else "volatility"
        unit = VOLATILITY["unit"]
        given = dated(section, key, factor.volatility, unit, delivery.dates, low=0.0)
        columns.append(given.index + len(values))
        values.extend(given.values)
        labels.extend(f"{number} {label}".strip() if numbered else label for label in given.labels)
    index, count = np.stack(columns, axis=1), len(factors)
    names = tuple(str(number) if numbered else "" for number in range(1, count + 1))
    reversions = np.array([factor.mean_reversion for factor in factors])
    pairs = tuple(f"{i},{j}" for i in range(2, count + 1) for j in range(1, i))
    return (
        Given(
            "mean_reversion",
            reversions,
            names,
            index=np.arange(count),
            words="speed at which a factor returns to zero",
            **REVERSION,
        ),
        Given(
            "volatility",
            np.array(values),
            tuple(labels),
            index=index,
            words="of a factor, by delivery day",
            **VOLATILITY,
        ),
        Given(
            "correlation",
            np.array(correlation, np.float64),
            pairs,
            "1",
            np.arange(len(pairs)),
            move=0.01,
            group="price model",
            words="of the shocks of two factors",
        ),
    )
