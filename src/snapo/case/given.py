"""Numbers that the user entered, with their meaning and units."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.form import Use
from snapo.problem.record import Input

from .error import CaseError

SHARED = ("bump", "judge_bump", "move", "display_unit", "display_factor", "group", "meaning")


class SheetCell(NamedTuple):
    """The position of a number in a CSV of a case; `line` counts from 1."""

    file: str
    line: int
    column: str

    def __str__(self) -> str:
        return f"{self.file}, line {self.line}, column {self.column}"


class Copies(NamedTuple):
    """The positions of a number that is written several times, such as the two entries of a
    correlation."""

    positions: tuple["FilePosition", ...]


class QuantityKey(NamedTuple):
    """The position of a number that is written with its unit in a text, "313.15 K".

    - `path`: the keys that lead to it. `unit`: the unit of the input, in which another number is
      written.
    """

    path: tuple[str | int, ...]
    unit: str


class KeyedUnit(NamedTuple):
    """The position of a number whose unit has separate keys.

    - `path`: the keys that lead to it. `units`: the paths of the keys of its unit, and their values
      for a number in the unit of the input. These keys apply to all numbers of the position.
    """

    path: tuple[str | int, ...]
    units: tuple[tuple[tuple[str | int, ...], str], ...]


class ConvertedNumber(NamedTuple):
    """The position of a number that is converted when it is read, such as an annual rate to a
    continuous one.

    - `read`: the function that is applied to the number in the file; `written`: its inverse, up to
      rounding.
    """

    position: "FilePosition"
    read: Callable[[float], float]
    written: Callable[[float], float]

    def inverse(self, number: float) -> float:
        """The number to write so that exactly this number is read. If there is no such float, the
        number that is read is a neighbouring float."""
        near = self.written(number)
        steps = [np.nextafter(near, math.inf), np.nextafter(near, -math.inf)]
        steps += [np.nextafter(steps[0], math.inf), np.nextafter(steps[1], -math.inf)]
        exact = (float(x) for x in (near, *steps) if self.read(x) == number)
        return next(exact, float(near))


class NoPosition(NamedTuple):
    """The reason why a new number cannot be written to the files of the case."""

    reason: str


# The position of a number: a cell, the keys that lead to it in the TOML file, or none.
FilePosition = (
    SheetCell
    | Copies
    | QuantityKey
    | KeyedUnit
    | ConvertedNumber
    | NoPosition
    | tuple[str | int, ...]
    | None
)


def positions(path: tuple[str | int, ...], shape: tuple[int, ...]) -> tuple[FilePosition, ...]:
    """The positions of the entries of an array under a key, in C order; for a single number, the
    position of the key."""
    return tuple((*path, *index) for index in np.ndindex(shape))


@dataclass(frozen=True, eq=False)
class CaseInput:
    """Numbers that the user entered, and where each of them is used.

    The per-day array is always `values[index]`: a simulator makes `values` an `Input` with this
    name, unit and labels, and takes `[index]` inside `prepare`, so that every number entered has a
    sensitivity with its label.

    **Attributes:**

    - `name`: the key in the case, "max_inventory".
    - `values`: [n] float64, in `unit`.
    - `labels`: [n] a date, a month, a ratchet row … for each number; `("",)` for a single plain
      number.
    - `unit`: "MWh/day", "EUR/MWh", "1/year", or "1" for a pure number.
    - `index`: integers of any shape, the positions in `values`; numbers that are not used do not
      occur in it.
    - `low`, `high`: the range of valid numbers; infinite if there is no limit.
    - `bump`, `judge_bump`, `move`, `display_unit`, `display_factor`, `group`, `meaning`: as in
      `Input`.
    - `positions`: [n] the position of each number in the files of the case; () if no reader
      recorded it.
    - `starts`: [n] day numbers from which the numbers apply, if they change with time.
    - `quantity`: the declaration of the numbers (`snapo.case.quantity`), if there is one.
    """

    name: str
    values: np.ndarray
    labels: tuple[str, ...]
    unit: str
    index: np.ndarray
    bump: float | None = None
    judge_bump: float | None = None
    move: float | None = None
    display_unit: str = ""
    display_factor: float = 1.0
    group: str = ""
    meaning: str = ""
    low: float = -math.inf
    high: float = math.inf
    positions: tuple[FilePosition, ...] = ()
    starts: np.ndarray | None = None
    quantity: Any = None

    def __post_init__(self):
        if len(self.labels) != len(self.values):
            raise ValueError(f"{self.name}: {len(self.values)} values, {len(self.labels)} labels.")

    def used(self) -> np.ndarray:
        """`values[index]`, the numbers where they are used."""
        return self.values[self.index]

    def use(self) -> Use:
        """The way in which a simulator uses the numbers; see `snapo.problem.form`."""
        return Use.of(self.name, len(self.values), self.index)

    @property
    def written(self) -> float | str:
        """The value of its key in the case: a number, or the name of a file."""
        position = self.positions[0] if self.positions else None
        return position.file if isinstance(position, SheetCell) else float(self.values[0])

    def input(self) -> Input:
        """The numbers as a differentiable input, with all their metadata."""
        metadata = {name: getattr(self, name) for name in SHARED}
        return Input(self.values, self.unit, self.labels, **metadata)

    def on(self, days: Sequence[date], notes: list[str]) -> "CaseInput":
        """The numbers that apply on rising dates, with an index [len(days)]; each number applies
        from its own date on.

        **Raises:** `CaseError` if the dates begin before the numbers do.
        """
        if self.starts is None:
            return replace(self, index=np.zeros(len(days), np.int64))
        day_numbers = np.array([day.toordinal() for day in days], np.int64)
        late = len(days) and self.starts[0] > day_numbers[0]
        numbers = self._from(days[0], notes) if late else self
        assert numbers.starts is not None
        index = np.searchsorted(numbers.starts, day_numbers, side="right") - 1
        return replace(numbers, index=index)

    def _from(self, day: date, notes: list[str]) -> "CaseInput":
        """Adds the number that applies before the first date of the numbers."""
        assert self.starts is not None
        first, before, position = self.labels[0], self.quantity.before, self.positions[0]
        assert isinstance(position, SheetCell)
        if before is None:
            message = f"{self.name} is needed from {day.isoformat()} on; add a row with that date"
            where = f"line {position.line}, column {self.quantity.by}"
            raise CaseError(position.file, where, first, message)
        notes.append(f"{position.file} begins on {first}; until then {self.name} is {before:g}.")
        return replace(
            self,
            values=np.insert(self.values, 0, before),
            labels=(f"before {first}", *self.labels),
            starts=np.insert(self.starts, 0, day.toordinal()),
            positions=(None, *self.positions),
        )


@dataclass(frozen=True, eq=False)
class SourceNumbers:
    """Numbers of a case that are not an input of its simulator, but from which an input is made:
    the quotes of a forward curve.

    - `numbers` [n]: the numbers with their positions; `input`: the name of the input, which is
      `matrix` [N, n] times the numbers.
    - `periods` [n]: the first and the last day to which each number applies.
    - `implied` [m]: numbers of the same file that must be `weights` [m, n] times `numbers`.
    """

    numbers: CaseInput
    input: str
    matrix: np.ndarray
    periods: tuple[tuple[date, date], ...]
    implied: CaseInput
    weights: np.ndarray
