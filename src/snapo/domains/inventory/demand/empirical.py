"""`[demand]` of kind "empirical": periods drawn from a history."""

from typing import Any, Literal

import numpy as np

from snapo.case.csv import FileReference, read_rows
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.quantity import POSITIVE, quantity_of
from snapo.case.table import CaseTable, Nonempty, TableContext, doc
from snapo.problem.record import field
from snapo.problem.record.arrays import Array, Float, jax, jnp

from .base import DEVIATION, MEAN, Demand, deviation_key, mean_key, register

FEWEST, MAXIMUM = 8, 520  # periods of a history: two weeks short of two months, ten years of weeks
MOVED = POSITIVE._replace(note=": the history is shifted to this mean")
STRETCHED = ": the history is stretched to this standard deviation"


class EmpiricalTable(CaseTable):
    """`[demand]` of kind "empirical"."""

    kind: Literal["empirical"] = doc("demand drawn from a history")
    history: Nonempty = doc(
        "past demand of each period, in units",
        allowed="the name of a CSV file with columns period,demand, and optionally factor",
    )
    mean: CaseInput | None = mean_key(MOVED, None)
    deviation: CaseInput | None = deviation_key(STRETCHED, None)


@register
class EmpiricalDemand(Demand):
    """The demand of a period of the history that is drawn at random.

    If the history has a column `factor`, past demand is divided by its factor, and a drawn demand
    is multiplied by the factor of the simulated period. A change of the mean shifts all numbers by
    the same amount; the deviation stretches them.

    - `numbers`: the numbers of the history, sorted; `scores`: the same numbers, scaled to mean 0
      and standard deviation 1.
    - `whole`: whether all numbers are whole; `moved`: whether the case changes the mean or the
      standard deviation.
    """

    kind = "empirical"
    table = EmpiricalTable
    mean: CaseInput
    spread: CaseInput
    numbers: Float[np.ndarray, " n"]
    scores: Float[np.ndarray, " n"]
    whole: bool = field(static=True)
    moved: bool = field(static=True)

    @classmethod
    def read(cls, section: TableContext, table: EmpiricalTable, maximum: float):
        reference = FileReference(section, "history", table.history)
        rows = read_rows(reference, ["period", "demand"], ["factor"])
        if not FEWEST <= len(rows) <= MAXIMUM:
            message = f"there are {len(rows)} periods; {FEWEST} to {MAXIMUM} are allowed"
            raise CaseError(table.history, "", None, message)
        with_factor = "factor" in rows[0].cells
        numbers = [
            row.number("demand", 0.0) / (row.number("factor", 1e-3, 1e3) if with_factor else 1.0)
            for row in rows
        ]
        if max(numbers) == min(numbers):
            message = "demand is the same in all periods, so there is no distribution to draw from"
            raise CaseError(table.history, "", None, message)
        numbers = np.sort(numbers)
        return cls(
            mean=table.mean or _moment(section, "mean", numbers.mean()),
            spread=table.deviation or _moment(section, "deviation", numbers.std()),
            numbers=numbers,
            scores=(numbers - numbers.mean()) / numbers.std(),
            whole=all(x == round(x) for x in numbers),
            moved=table.mean is not None or table.deviation is not None,
        )

    def prepare(self, parameters, factors):
        levels = parameters[MEAN] + parameters[DEVIATION] * jnp.asarray(self.scores)
        return {
            "factor": factors,
            "levels": jnp.broadcast_to(levels, (*factors.shape, *self.scores.shape)),
        }

    def draw(self, now: Any, normal: Float[Array, ""], spread: bool) -> Float[Array, ""]:
        levels, n = now["levels"], now["levels"].shape[0]
        position = jax.scipy.special.ndtr(normal) * n
        k = jnp.clip(jnp.floor(position).astype(jnp.int32), 0, n - 1)
        return now["factor"] * levels[k]

    def deviation(self, parameters, factors):
        return parameters[DEVIATION] * factors

    def probabilities(self, parameters, factor=1.0):
        complete = np.round(self.numbers).astype(int)
        return np.bincount(complete) / len(complete)

    def integral(self) -> bool:
        return self.whole and not self.moved

    def in_pieces(self) -> bool:
        return self.whole

    def describe(self) -> str:
        mean, spread = self.mean.values[0], self.spread.values[0]
        return (
            f"drawn from {len(self.numbers)} periods, mean {mean:.4g}, "
            f"standard deviation {spread:.4g}"
        )


def _moment(section: TableContext, key: str, value: float) -> CaseInput:
    """A moment of the history, which is used if the case has no number at `key`; a new number is
    written there."""
    quantity = quantity_of(EmpiricalTable.model_fields[key])
    assert quantity is not None
    return quantity.input(quantity.name, [value], positions=((*section.keys, key),))
