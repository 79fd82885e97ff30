"""Factors whose volatilities and mean reversions are given one by one, by delivery day."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from snapo.case.given import CaseInput, FilePosition
from snapo.case.quantity import Quantity, Range, stacked
from snapo.case.table import CaseTable, TableContext
from snapo.problem.process import Factors

from .factor_prices import FactorPrices
from .process import REVERSION, VOLATILITY, Delivery, Times, use


class FactorTable(CaseTable):
    """A factor: { mean_reversion = 12.0, volatility = 0.6 }"""

    mean_reversion: CaseInput = REVERSION("speed at which a factor returns to zero")
    volatility: CaseInput = VOLATILITY("of a factor, by delivery day", by="date")


CORRELATION = Quantity(
    range=Range(-1.0, 1.0), group="price model", move=0.01, meaning="of the shocks of two factors"
)


class GivenFactors(FactorPrices):
    """Factors whose numbers are given one by one.

    - `mean_reversion`: 1/year, 0 allowed, index [F].
    - `volatility`: 1/sqrt(year), by delivery day, index [T + 1, F].
    - `correlation`: the strict lower triangle, row by row, index [F (F - 1) / 2].
    """

    delivery: Times
    mean_reversion: CaseInput
    volatility: CaseInput
    correlation: CaseInput
    noise_size: int = eqx.field(static=True)
    fast_factor: int = eqx.field(static=True)

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
    ):
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


def read_factors(
    section: TableContext,
    factors: Sequence[FactorTable],
    correlation: Sequence[float],
    positions: Sequence[FilePosition],
    delivery: Delivery,
) -> dict[str, CaseInput]:
    """The numbers of several factors, with the strict lower triangle of their correlations."""
    count, dates = len(factors), delivery.dates
    volatilities = [factor.volatility.on(dates, section.notes) for factor in factors]
    pairs = [f"{i},{j}" for i in range(2, count + 1) for j in range(1, i)]
    numbers = (
        stacked("mean_reversion", [factor.mean_reversion for factor in factors]),
        stacked("volatility", volatilities),
        CORRELATION.input("correlation", correlation, pairs, positions=tuple(positions)),
    )
    return {values.name: values for values in numbers}
