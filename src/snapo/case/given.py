"""Numbers that the owner of a case gave, with their meaning and units."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from snapo.problem.form import Use
    from snapo.problem.inputs import Input

SAID = ("bump", "move", "trade_unit", "trade_factor", "group", "words")


@dataclass(frozen=True, eq=False)
class Given:
    """Numbers that the owner of the case gave, and where each of them is used.

    The per-day array is always `values[index]`: a simulator makes `values` an `Input` with this
    name, unit and labels, and takes `[index]` inside `prepare`, so that the sensitivity to every
    number that was given comes out under its own label.

    **Attributes:**

    - `name`: the key in the case, "max_inventory".
    - `values`: [n] float64, in `unit`.
    - `labels`: [n] a date, a month, a ratchet row …; `("",)` for a single plain number.
    - `unit`: "MWh/day", "EUR/MWh", "1/year", or "1" for a pure number.
    - `index`: integers of any shape into `values`; unused numbers are not referred to.
    - `low`, `high`: what the numbers may be at all; infinite where there is no limit.
    - `bump`, `move`, `trade_unit`, `trade_factor`, `group`, `words`: as in `Input`.
    """

    name: str
    values: np.ndarray
    labels: tuple[str, ...]
    unit: str
    index: np.ndarray
    bump: float | None = None
    move: float | None = None
    trade_unit: str = ""
    trade_factor: float = 1.0
    group: str = ""
    words: str = ""
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self):
        if len(self.labels) != len(self.values):
            raise ValueError(f"{self.name}: {len(self.values)} values, {len(self.labels)} labels.")

    def used(self) -> np.ndarray:
        """`values[index]`, the numbers where they are used."""
        return self.values[self.index]

    def use(self) -> "Use":
        """Where the numbers are used, for a simulator: see `snapo.problem.form`."""
        from snapo.problem.form import Use

        return Use.of(self.name, len(self.values), self.index)

    def input(self) -> "Input":
        """The numbers as a differentiable input, with all that is said about them."""
        from snapo.problem.inputs import Input  # JAX: a case is read, and refused, without it

        said = {name: getattr(self, name) for name in SAID}
        return Input(self.values, self.unit, self.labels, **said)
