"""Fade: the capacity of a store falls as energy is taken from it.

    E_after <= max(E_before, energy - by x n),    n = max(ceil(taken / every) - 1, 0)

`taken` is counted over the whole life of the store. n rises when the energy taken exceeds a
multiple of `every`. The limit applies only to charging: energy above the limit may stay in store,
and can be taken.
"""

from typing import Annotated

import numpy as np

from snapo.case.quantity import NOT_NEGATIVE, CaseInput, Quantity
from snapo.case.table import CaseTable, Range, TableContext, doc
from snapo.problem.record import TreeRecord
from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

FADE = "fade"


class FadeTable(CaseTable):
    """{ every = 30.0, by = 0.5 }: after every 30 MWh taken the store can hold 0.5 MWh less."""

    every: Annotated[float, Range(0.0, endpoints="()", note=": MWh taken")] = doc(
        "energy that is taken before the store can hold less, in MWh"
    )
    by: CaseInput = Quantity("MWh", NOT_NEGATIVE, "contract", move=0.1, name=FADE)(
        "usable energy lost each time a further `every` MWh have been taken"
    )
    taken: Annotated[float, Range(0.0, note=": MWh taken before the start")] = doc(
        "energy taken since the store was new, in MWh", 0.0
    )


class StoreFade(TreeRecord):
    """The terms of fade, in MWh: see `FadeTable`. `by`: index []."""

    every: Float[np.ndarray, ""]
    by: CaseInput
    taken: Float[np.ndarray, ""]

    def reach(self, count: int, stored: Array, charge: Array, discharge: Array) -> Array:
        """An upper limit on the energy taken in `count` steps, in each of which at most `charge` is
        stored or at most `discharge` is taken. It is computed for a whole number of steps, so that
        it is a multiple of the common divisor of the volumes."""
        steps = (stored / charge + count) * charge / (charge + discharge)
        return discharge * xp.minimum(xp.ceil(steps), count)


def read_fade(where: TableContext, raw: dict, energy: float) -> StoreFade:
    """The table `fade` of a store of `energy` MWh.

    **Raises:** `CaseError` if the first fall would leave no energy.
    """
    table = where.nested(FadeTable, raw, FADE)
    by = float(table.by.values[0])
    if by > energy:
        raise where.error(f"{FADE}.by", by, f"it must be at most energy, {energy:g}")
    return StoreFade(np.array(table.every), table.by, np.array(table.taken))  # pyright: ignore
