"""What the value gains or loses when an input moves by the amount that its owner has in mind."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from snapo.problem.inputs import Input
from snapo.solver.sensitivity import Sensitivities
from snapo.solver.statistics import Estimate

from ..study import Part, StudyRun

SHARE = 0.01  # of every number of an input that does not say its `move`


def work(run: StudyRun) -> dict[str, Any]:
    """ "moves": one row per input, all of its numbers moved together, the largest effects first.

    - `amount`, `unit`: by how much every number moves, in the unit of its owner; `amount` is None
      where each moves by `share` of itself.
    - `effect`, `standard_error`: on the value, to first order, with the decisions held.
    - `smooth`, `smooth_error`: through the policy's reaction.
    """
    table = run.solution.sensitivities
    if table is None:
        return {"moves": []}
    rows = [_row(name, given, table) for name, given in table.inputs.items()]
    return {"moves": sorted(rows, key=lambda row: -abs(row["effect"]))}


MOVES = Part("moves", work, needs=("training",))


def direction(given: Input) -> np.ndarray:
    """How every number of an input moves, shaped like it."""
    if given.move is None:
        return SHARE * given.value
    return np.full(given.value.shape, given.move)


def _row(name: str, given: Input, table: Sensitivities) -> dict[str, Any]:
    along = direction(given)
    effect, error = table.held[name].along(along)
    smooth, smooth_error = _along(table.smooth, name, along)
    return {
        "input": name,
        "words": given.words,
        "group": given.group,
        "numbers": given.value.size,
        "amount": None if given.move is None else given.move * given.trade_factor,
        "share": SHARE if given.move is None else None,
        "unit": given.trade_unit or given.unit,
        "effect": effect,
        "standard_error": error,
        "smooth": smooth,
        "smooth_error": smooth_error,
    }


def _along(
    found: Mapping[str, Estimate] | None, name: str, along: np.ndarray
) -> tuple[float | None, float | None]:
    return (None, None) if found is None else found[name].along(along)
