"""`[demand]` of kind "empirical": periods drawn from a history."""

from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float
from pydantic import Field

from snapo.case.csv import Mention, read_rows
from snapo.case.error import CaseError
from snapo.case.table import Section, Table

from .base import DEVIATION, MEAN, Demand, deviation_given, mean_given, register

FEWEST, MOST = 8, 520  # periods of a history: two weeks short of two months, ten years of weeks


class EmpiricalTable(Table):
    """`[demand]` of kind "empirical"."""

    kind: Literal["empirical"]
    history: Annotated[str, Field(min_length=1)] = Field(
        description="the name of a CSV file with columns period,demand, and factor if need be"
    )


@register
class Empirical(Demand):
    """A period of the history, by chance.

    Where the history has a column `factor`, its demand is divided by it, and a period drawn is
    multiplied by its own factor. The mean moves all numbers alike, the deviation stretches them.
    """

    kind = "empirical"
    table = EmpiricalTable
    numbers: tuple[float, ...]
    unit: str

    @classmethod
    def read(cls, section: Section, table: EmpiricalTable, unit: str, most: float):
        mention = Mention(section, "history", table.history)
        rows = read_rows(mention, ["period", "demand"], ["factor"])
        if not FEWEST <= len(rows) <= MOST:
            what = f"there are {len(rows)} periods; allowed are {FEWEST} to {MOST}"
            raise CaseError(table.history, "", None, what)
        with_factor = "factor" in rows[0].cells
        found = [
            row.number("demand", 0.0) / (row.number("factor", 1e-3, 1e3) if with_factor else 1.0)
            for row in rows
        ]
        if max(found) == min(found):
            what = "demand is the same in all periods: there is nothing to draw from"
            raise CaseError(table.history, "", None, what)
        return cls(tuple(sorted(found)), unit)

    def given(self):
        found = np.array(self.numbers)
        return mean_given(found.mean(), self.unit), deviation_given(found.std(), self.unit)

    def prepare(self, parameters, factors):
        found = np.array(self.numbers)
        scores = jnp.asarray((found - found.mean()) / found.std())
        levels = parameters[MEAN] + parameters[DEVIATION] * scores
        return {"factor": factors, "levels": jnp.broadcast_to(levels, (*factors.shape, len(found)))}

    def draw(self, now: Any, normal: Float[Array, ""], spread: bool) -> Float[Array, ""]:
        levels, n = now["levels"], len(self.numbers)
        place = ndtr(normal) * n
        k = jnp.clip(jnp.floor(place).astype(jnp.int32), 0, n - 1)
        return now["factor"] * levels[k]

    def deviation(self, parameters, factors):
        return parameters[DEVIATION] * factors

    def chances(self, parameters, factor=1.0):
        whole = np.round(self.numbers).astype(int)
        return np.bincount(whole) / len(whole)

    def integral(self) -> bool:
        return all(x == round(x) for x in self.numbers)

    def words(self) -> str:
        found = np.array(self.numbers)
        return (
            f"drawn from {len(found)} periods, mean {found.mean():.4g}, "
            f"standard deviation {found.std():.4g}"
        )
