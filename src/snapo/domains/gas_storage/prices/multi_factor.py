"""`[model]` of kind "multi-factor": correlated factors, each with a volatility by delivery day."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from snapo.case.given import Copies
from snapo.case.table import CaseTable, TableContext, parse

from .given_factors import FactorTable, GivenFactors, read_factors
from .process import Delivery, register


class MultiFactorTable(CaseTable):
    """`[model]` of kind "multi-factor"; each of `factors` is a `FactorTable`."""

    kind: Literal["multi-factor"]
    factors: Annotated[list[Any], Field(min_length=1)] = Field(
        description="a list like [{ mean_reversion = 12.0, volatility = 0.6 }]"
    )
    correlation: list[list[float]] | None = Field(
        None, description="a square matrix of numbers, like [[1.0, 0.3], [0.3, 1.0]]"
    )


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
    """The strict lower triangle of a matrix that is checked to be a correlation matrix."""
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
            raise section.error(f"correlation.{i + 1},{i + 1}", matrix[i, i], "allowed is 1")
        for j in range(i):
            if matrix[i, j] != matrix[j, i]:
                message = f"the matrix must be symmetric, and {j + 1},{i + 1} is {matrix[j, i]:g}"
                raise section.error(f"correlation.{i + 1},{j + 1}", matrix[i, j], message)
            if not -1 <= matrix[i, j] <= 1:
                message = "allowed is a number from -1 to 1"
                raise section.error(f"correlation.{i + 1},{j + 1}", matrix[i, j], message)
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest <= 1e-12:
        message = (
            "a correlation matrix must be positive definite, and the least eigenvalue of this "
            f"one is {smallest:.3g}; factors that move as one are one factor"
        )
        raise section.error("correlation", values, message)
    return list(matrix[np.tril_indices(size, -1)])
