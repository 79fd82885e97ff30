"""The powers that a plant with a ramp uses: whole numbers of ramps from a limit.

    |q(t) - q(t - 1)| <= ramp while on;   at most top = max(min, ramp) in the first and last hour on

If it is fixed in which hours the plant runs, cash is linear in the powers q, and the limits apply
to powers and to differences of two powers. At a corner of these limits every power is therefore
min, max, top or the power before the first hour, plus a whole number of ramps: a step. Steps are
also the best powers if later prices are random. By backward induction, the value is convex in the
power of the hour before, between neighbouring steps, because maxima and means of convex functions
are convex. The best next power is then a step, or one ramp away from the power before, which is a
step too if the power before is one. No other powers are needed.
"""

from itertools import count
from typing import NamedTuple

import numpy as np

NEAR = 1e-9  # of the largest power: steps nearer to each other are one
TOLERANCE = 3e-5  # of the largest power: numbers moved by less have the same steps
LOW, HIGH, RAMP, BEFORE = np.eye(4, dtype=int)  # min, max, ramp, power before the first hour


class PowerStep(NamedTuple):
    """A power as multiples of `min`, `max`, `ramp` and the power before the first hour."""

    parts: tuple[int, ...]

    @property
    def name(self) -> str:
        """The power as text, such as "min + 2 ramp"."""
        *limits, ramps = (self.parts[i] for i in (0, 1, 3, 2))
        text = [name for name, part in zip(("min", "max", "before"), limits) if part]
        if not text:
            return f"{ramps} ramp"
        return " ".join(
            [*text, *([f"{'+' if ramps > 0 else '-'} {abs(ramps)} ramp"] * bool(ramps))]
        )


class PowerSteps(NamedTuple):
    """All steps of the power of a plant.

    - `steps`: the steps; `of_before`: the step before the first hour, -1 if the plant is off.
    - `at_ends` [steps]: whether a plant may start with this power and stop from it.
    - `next` [steps]: the steps that can follow each step.
    - `conditions`: rows whose products with (min, max, ramp, before) are at least zero as long as
      the other fields are valid.
    """

    steps: tuple[PowerStep, ...]
    of_before: int
    at_ends: tuple[bool, ...]
    next: tuple[tuple[int, ...], ...]
    conditions: tuple[tuple[int, ...], ...]


def power_steps(low: float, high: float, ramp: float, before: float | None) -> PowerSteps:
    """The steps for these limits; none if the ramp is at least `high` and therefore never binds."""
    if ramp >= high:
        return PowerSteps((), -1, (), (), (_plain(RAMP - HIGH),))
    numbers = np.array([low, high, ramp, before or 0.0])
    near, top = NEAR * high, RAMP if ramp > low else LOW
    anchors = [LOW, HIGH, top] + ([] if before is None else [BEFORE])
    parts: list[np.ndarray] = []
    conditions: list[np.ndarray] = [top - (LOW if ramp > low else RAMP)]

    def number_of(row: np.ndarray) -> int:
        """The number of the step with this value; a new step is added for a new value."""
        for i, other in enumerate(parts):
            if abs((row - other) @ numbers) <= near:
                conditions.extend([row - other, other - row])
                return i
        parts.append(row)
        return len(parts) - 1

    for anchor in anchors:
        for sign in (1, -1):
            for k in count():
                row = anchor + sign * k * RAMP
                outside = row - HIGH if sign > 0 else LOW - row
                if outside @ numbers > near:
                    conditions.append(outside)
                    break
                conditions.append(-outside)
                number_of(row)
    parts.sort(key=lambda row: float(row @ numbers))
    powers = np.array(parts) @ numbers
    at_ends = powers <= top @ numbers + near
    conditions += [top - row if possible else row - top for row, possible in zip(parts, at_ends)]
    joined = np.abs(powers[:, None] - powers) <= ramp + near
    for i, row in enumerate(parts):
        for j, other in enumerate(parts[:i]):
            conditions.append((RAMP - row + other) * (1 if joined[i, j] else -1))
    return PowerSteps(
        tuple(PowerStep(_plain(row)) for row in parts),
        -1 if before is None else number_of(BEFORE),
        tuple(map(bool, at_ends)),
        tuple(tuple(map(int, np.flatnonzero(row))) for row in joined),
        tuple(sorted({_plain(row) for row in conditions if row.any()})),
    )


def _plain(row: np.ndarray) -> tuple[int, ...]:
    return tuple(map(int, row))
