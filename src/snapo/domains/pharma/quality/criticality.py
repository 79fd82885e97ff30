"""Which parameter moves which attribute, by how much of its room, and how sure that is."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from . import batches
from .limits import Limits

if TYPE_CHECKING:
    from ..flowsheet.process import Process

DRAWS, LEVELS = 64, (0.05, 0.95)


class Criticality(NamedTuple):
    """[Q, P]: half the `change` of an attribute as a parameter goes from the lower to the upper end
    of its normal range, by the nominal model, in the attribute's unit.

    - `low`, `high`: 5 % and 95 % of it over the variation that the case states.
    - `share`, `share_low`, `share_high`: of the room to the nearest limit at the set point, the
      size of the change; NaN without a limit, infinite on or beyond it.
    """

    change: np.ndarray
    low: np.ndarray
    high: np.ndarray
    share: np.ndarray
    share_low: np.ndarray
    share_high: np.ndarray


def criticality(process: "Process", seed: int, draws: int = DRAWS) -> Criticality:
    """Every parameter moved over its normal range: the nominal batch, and the same drawn ones."""
    case = process.case
    entries = batches.varied(case)
    here = batches.nominally(process, {})
    base = np.concatenate([here, batches.drawn(process, {}, draws, seed)])
    rows = []
    for each in case.parameters:
        column = entries.index((each.input, each.entry))
        for end in (each.normal_low, each.normal_high):
            moved = base.copy()
            moved[:, column] += end - here[0, column]
            rows.append(moved)
    values = batches.attributes(process, np.concatenate([here, *rows]))
    room = Limits.of(case).distance(values[0])[:, None]
    ends = values[1:].reshape(len(case.parameters), 2, 1 + draws, -1)
    half = (ends[:, 1] - ends[:, 0]).transpose(1, 2, 0) / 2  # draws, attributes, parameters
    low, high = np.nanquantile(half[1:], LEVELS, axis=0)
    sizes = np.stack([np.abs(half[0]), *np.nanquantile(np.abs(half[1:]), LEVELS, axis=0)])
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(room > 0, sizes / room, np.where(sizes > 0, np.inf, 0.0))
    shares = np.where(Limits.of(case).any()[:, None], shares, np.nan)
    return Criticality(half[0], low, high, *shares)
