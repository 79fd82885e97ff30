"""Adjoint against central differences: at the set point and at points of normal operation."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..given import every_entry
from ..quality import batches
from .jacobian import matrix

if TYPE_CHECKING:
    from ..flowsheet.process import PharmaProcess

POINTS, STEP = 3, 0.01  # random points; steps as shares of half the normal range
TOLERANCE = 1e-5  # of the largest entry in the row, or of a margin in half a range
KINK, NOTABLE = 0.75, 1e-3


class Checked(NamedTuple):
    """One point; all arrays are [Q, P], per domain unit of the parameter.

    - `adjoint`: the derivative from the adjoint; `difference`: the same by fourth-order central
      differences. `error`: the gap between these two, divided by the largest entry of the row, or
      by one margin per half of the normal range if that is larger.
    - `kink`: whether forward and backward differences remain different as the step is halved, so
      that the derivative there is one-sided.
    """

    point: np.ndarray
    adjoint: np.ndarray
    difference: np.ndarray
    error: np.ndarray
    kink: np.ndarray

    @property
    def passed(self) -> bool:
        return bool((np.where(self.kink, 0.0, self.error) <= TOLERANCE).all())


def certify(process: "PharmaProcess", seed: int) -> list[Checked]:
    """The set point first, then `POINTS` random ones within the normal operating ranges."""
    case = process.case
    low = np.array([parameter.normal_low for parameter in case.parameters])
    high = np.array([item.normal_high for item in case.parameters])
    here = np.array([process.inputs[entry.input][entry.entry] for entry in case.parameters])
    random = np.random.Generator(np.random.Philox(key=seed)).random((POINTS, len(here)))
    points = np.vstack([here, low + random * (high - low)])
    step = STEP * (high - low) / 2
    values = _moved_values(process, points, step)
    return [_check(process, *value, step) for value in zip(points, values)]


def _moved_values(process: "PharmaProcess", points: np.ndarray, step: np.ndarray) -> np.ndarray:
    """[points, 4 P + 1, Q] attributes two steps and one step below and above, and at the point."""
    entries = [(parameter.input, parameter.entry) for parameter in process.case.parameters]
    size = len(step)
    moves = np.concatenate([k * np.diag(step) for k in (-2, -1, 1, 2)] + [np.zeros((1, size))])
    rows = [
        batches.nominally(process, dict(zip(entries, point + move)))
        for point in points
        for move in moves
    ]
    return batches.attributes(process, np.concatenate(rows)).reshape(len(points), len(moves), -1)


def _check(
    process: "PharmaProcess", point: np.ndarray, values: np.ndarray, step: np.ndarray
) -> Checked:
    entries = [(parameter.input, parameter.entry) for parameter in process.case.parameters]
    inputs = batches.inputs_with(process, dict(zip(entries, point)))
    # By all numbers, which costs the adjoint nothing: the same function gives the run's table.
    every = every_entry(process.inputs)
    adjoint = matrix(process, inputs, entries=every, mode="adjoint").jacobian
    adjoint = adjoint[:, [every.index(entry) for entry in entries]]
    size = len(point)
    far_low, low, high, far_high = (values[k * size : (k + 1) * size].T for k in range(4))
    difference = (8 * (high - low) - (far_high - far_low)) / (12 * step)
    row = np.abs(adjoint).max(1, keepdims=True)
    # An attribute close to zero has no slope to compare: the unit is a margin in half a range.
    margins = np.array([attribute.margin for attribute in process.case.attributes])[:, None]
    half = np.array([(p.normal_high - p.normal_low) / 2 for p in process.case.parameters])
    row = np.maximum(row, margins / half)
    here = values[-1][:, None]
    bend = np.abs(high + low - 2 * here) / step
    far_bend = np.abs(far_high + far_low - 2 * here) / (2 * step)
    return Checked(
        point=point,
        adjoint=adjoint,
        difference=difference,
        error=np.abs(adjoint - difference) / row,
        kink=(bend > NOTABLE * row) & (bend > KINK * far_bend),
    )
