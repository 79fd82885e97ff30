"""The change of value between two runs in parts, and their names."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

DIGITS = 2  # decimals: cents


@dataclass(frozen=True)
class ChangePart:
    """One part of the change of value, in the currency.

    - `part`: the cause; `period`: the delivery period, only for parts of the curve.
    - `amount`: the amount, rounded so that the parts add up to the change; `standard_error`: None
      for an amount without sampling error.
    """

    part: str
    period: str
    amount: float
    standard_error: float | None
    note: str = ""


@dataclass(frozen=True)
class CurveMove:
    """The mean move of the forward prices of a delivery period, in currency per unit.

    - `days`: the number of its days within the contract.
    - `delta`: the discounted delta, in the unit of gas; None if the mean price did not move.
    """

    period: str
    days: int
    move: float
    delta: float | None


@dataclass(frozen=True, eq=False)
class ExplainedChange:
    """The change of value from the first run to the second one.

    - `values`, `errors`: the values of the two runs and their errors; `dates`: their valuation
      dates.
    - `cash`: the cash flow between the two dates; profit and loss is the change of value plus this
      cash flow.
    - `parts`: the parts, which add up to the change; the cash flow has a minus sign. `totals`: the
      same, with the sum over all periods of the curve; `moves`: the moves of the curve; `flows`:
      the flows on the days between the two dates.
    - `digits`: decimals of the amounts; `paths`: the number of paths on which the parts are
      computed.
    """

    runs: tuple[Path, Path]
    title: str
    currency: str
    unit: str
    dates: tuple[str, str]
    values: tuple[float, float]
    errors: tuple[float, float]
    cash: float
    parts: tuple[ChangePart, ...]
    totals: tuple[ChangePart, ...]
    moves: tuple[CurveMove, ...]
    flows: tuple[Any, ...]
    digits: int
    paths: int
    notes: tuple[str, ...] = ()

    @property
    def change(self) -> float:
        """The change of the value, rounded like the parts."""
        return round(self.values[1] - self.values[0], self.digits)

    @property
    def profit(self) -> float:
        """Profit and loss: the change of value plus the cash flow."""
        return round(self.change + self.cash, self.digits)


def decimals_of(value: float) -> int:
    """The number of decimals for the parts of a value: two, and more for a value below 1,000."""
    return max(DIGITS, 5 - math.floor(math.log10(value))) if 0 < value < 1000 else DIGITS
