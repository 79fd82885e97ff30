"""An optimisation of the open-loop recipe as resolved data; conventions as in `records`."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Decision:
    """One decision: one entry of one `CaseInput`.

    - `name`: "crystalliser.temperature[1]"; `input`, `entry`: the `CaseInput` and the position.
    - `unit`: the case's unit; domain value = `scale` * case's value + `offset`.
    - `low`, `high`, `start`: bounds and start in the domain's unit; the start is the case's number.
    """

    name: str
    input: str
    entry: int
    unit: str
    scale: float
    offset: float
    low: float
    high: float
    start: float

    def in_case_unit(self, value: float) -> float:
        """A number of the domain in the case's unit."""
        return (value - self.offset) / self.scale


@dataclass(frozen=True)
class Term:
    """`weight` times a measure, or times a number of the case, in the user's `unit`.

    - `of`: "unit.measure" or "unit.field"; `entry`: the position in the `CaseInput`'s values, None
      for a measure. `scale`: number in the case's unit = `scale` times that in the domain's (0 is
      0 in both).
    """

    of: str
    entry: int | None
    unit: str
    scale: float
    weight: float


@dataclass(frozen=True)
class Optimise:
    """Goal = sum of `terms`, divided by the sum of `per` if there is one; at the nominal model.

    - `sense`: 1 to maximise the goal, -1 to minimise it.
    - `reserve`, `deviations`: the numbers of margins, and of standard deviations of the batches
      around the case's recipe, by which attributes stay within their limits.
    - `starts`: the number of starting points: the case's recipe, and random ones within the bounds.
    """

    sense: Literal[-1, 1]
    terms: tuple[Term, ...]
    per: tuple[Term, ...]
    decisions: tuple[Decision, ...]
    reserve: float
    starts: int
    deviations: float = 0.0
