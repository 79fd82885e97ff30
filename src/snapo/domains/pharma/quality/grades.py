"""Whether set points do: by the nominal model, and with a probability that is required."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..given import Entry
from . import batches
from .design_space import at_points
from .limits import AttributeLimits

if TYPE_CHECKING:
    from ..flowsheet.process import Process

Changes = Mapping[Entry, float]  # of a set point, in the domain's unit


class GradedPoints(NamedTuple):
    """[n] whether points do; the number of the attribute that fails; whether they do even at the
    lower, and even at the upper end of their interval."""

    fine: np.ndarray
    fails: np.ndarray
    certain: np.ndarray
    possible: np.ndarray


Good = Callable[[Sequence[Changes]], GradedPoints]


def goods(process: "Process", required: float, samples: int, seed: int) -> tuple[Good, Good]:
    """By the model at its nominal numbers; and with the `required` probability of `samples` draws,
    a parameter with a distribution varying about its point."""
    case = process.case
    limits = AttributeLimits.of(case)
    margins = np.array([attribute.margin for attribute in case.attributes])

    def nominally(changes: Sequence[Changes]) -> GradedPoints:
        rows = [batches.nominally(process, item) for item in changes]
        values = batches.attributes(process, np.concatenate(rows))
        room = np.where(limits.any(), limits.distance(values), np.inf) / margins
        worst = np.argmin(np.nan_to_num(room, nan=-np.inf, posinf=np.inf), -1)
        fine = np.asarray(limits.hold(values).all(-1))
        return GradedPoints(fine, worst, fine, fine)

    def probably(changes: Sequence[Changes]) -> GradedPoints:
        points = at_points(process, changes, samples, seed)
        grades = (entry >= required for entry in (points.probability, points.low, points.high))
        fine, certain, possible = grades
        return GradedPoints(fine, points.binding, certain, possible)

    return nominally, probably
