"""`[demand]` of kind "empirical": periods drawn from a history."""

from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float
from pydantic import Field

from snapo.case.csv import FileReference, read_rows
from snapo.case.error import CaseError
from snapo.case.table import CaseTable, TableContext

from .base import DEVIATION, MEAN, Demand, deviation_given, mean_given, register

FEWEST, MAXIMUM = 8, 520  # periods of a history: two weeks short of two months, ten years of weeks


class EmpiricalTable(CaseTable):
    """`[demand]` of kind "empirical"."""

    kind: Literal["empirical"]
    history: Annotated[str, Field(min_length=1)] = Field(
        description="the name of a CSV file with columns period,demand, and factor if need be"
    )
    mean: Annotated[float, Field(gt=0)] | None = Field(
        None, description="a number above 0: the history is moved to this mean"
    )
    deviation: Annotated[float, Field(gt=0)] | None = Field(
        None, description="a number above 0: the history is stretched to this standard deviation"
    )


@register
class EmpiricalDemand(Demand):
    """A period of the history, by chance.

    Where the history has a column `factor`, its demand is divided by it, and a period drawn is
    multiplied by its own factor. The mean moves all numbers alike, the deviation stretches them.
    """

    kind = "empirical"
    table = EmpiricalTable
    numbers: tuple[float, ...]
    unit: str
    mean: float | None = None
    spread: float | None = None

    @classmethod
    def read(cls, section: TableContext, table: EmpiricalTable, unit: str, maximum: float):
        reference = FileReference(section, "history", table.history)
        rows = read_rows(reference, ["period", "demand"], ["factor"])
        if not FEWEST <= len(rows) <= MAXIMUM:
            message = f"there are {len(rows)} periods; allowed are {FEWEST} to {MAXIMUM}"
            raise CaseError(table.history, "", None, message)
        with_factor = "factor" in rows[0].cells
        numbers = [
            row.number("demand", 0.0) / (row.number("factor", 1e-3, 1e3) if with_factor else 1.0)
            for row in rows
        ]
        if max(numbers) == min(numbers):
            message = "demand is the same in all periods: there is nothing to draw from"
            raise CaseError(table.history, "", None, message)
        return cls(tuple(sorted(numbers)), unit, table.mean, table.deviation)

    def inputs(self):
        mean, spread = self._moments()
        return mean_given(mean, self.unit), deviation_given(spread, self.unit)

    def _moments(self) -> tuple[float, float]:
        """Mean and standard deviation: the history's own, or those that the case moves it to."""
        numbers = np.array(self.numbers)
        mean = float(numbers.mean()) if self.mean is None else self.mean
        return mean, float(numbers.std()) if self.spread is None else self.spread

    def prepare(self, parameters, factors):
        numbers = np.array(self.numbers)
        scores = jnp.asarray((numbers - numbers.mean()) / numbers.std())
        levels = parameters[MEAN] + parameters[DEVIATION] * scores
        return {
            "factor": factors,
            "levels": jnp.broadcast_to(levels, (*factors.shape, len(numbers))),
        }

    def draw(self, now: Any, normal: Float[Array, ""], spread: bool) -> Float[Array, ""]:
        levels, n = now["levels"], len(self.numbers)
        position = ndtr(normal) * n
        k = jnp.clip(jnp.floor(position).astype(jnp.int32), 0, n - 1)
        return now["factor"] * levels[k]

    def deviation(self, parameters, factors):
        return parameters[DEVIATION] * factors

    def probabilities(self, parameters, factor=1.0):
        complete = np.round(self.numbers).astype(int)
        return np.bincount(complete) / len(complete)

    def integral(self) -> bool:
        return self.in_pieces() and self.mean is None and self.spread is None

    def in_pieces(self) -> bool:
        return all(x == round(x) for x in self.numbers)

    def describe(self) -> str:
        mean, spread = self._moments()
        return (
            f"drawn from {len(self.numbers)} periods, mean {mean:.4g}, "
            f"standard deviation {spread:.4g}"
        )
