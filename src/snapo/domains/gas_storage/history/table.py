"""`[backtest]`: when a back-test estimates the model again, and from which prices.

[backtest]
calibrate = "month"
window = 730
prices = "spot and curves"
"""

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from snapo.case.table import CaseTable, Range, TableContext, doc, parse

NEVER, SPOT, BOTH = "never", "spot", "spot and curves"
PERIODS = {"month": 1, "quarter": 3, "year": 12}  # in months
CALENDARS = '"never", "month", "quarter", "year", or a number of days'


class BacktestTable(CaseTable):
    """`[backtest]`: the estimates of `snapo backtest`."""

    calibrate: Any = doc("when the model is estimated again", NEVER, CALENDARS)
    window: Annotated[int, Range(30, noun="a number of days")] | None = doc(
        "days of history that an estimate uses, by default all", None
    )
    prices: Literal["spot", "spot and curves"] = doc(
        "prices from which the model is estimated", SPOT
    )
    season: Literal[0, 1, 2] = doc("number of waves of the seasonal pattern in an estimate", 0)


class BacktestPlan(NamedTuple):
    """The numbers of the table; `calibrate`: a key of PERIODS, a number of days, or NEVER."""

    calibrate: str | int = NEVER
    window: int | None = None
    prices: str = SPOT
    season: Literal[0, 1, 2] = 0

    def due(self, days: Sequence[datetime.date]) -> frozenset[int]:
        """The indices in `days` of the days on which the model is estimated."""
        if self.calibrate == NEVER:
            return frozenset()
        if isinstance(self.calibrate, int):
            return frozenset(range(0, len(days), self.calibrate))
        length = PERIODS[self.calibrate]
        period = [(day.year * 12 + day.month - 1) // length for day in days]
        return frozenset(t for t in range(len(days)) if not t or period[t] != period[t - 1])


def plan_of(file: Path, data: Any, notes: list[str]) -> BacktestPlan:
    """The plan of the table [backtest]; the default plan if `data` is None.

    **Raises:** `CaseError` if a key is wrong.
    """
    if data is None:
        return BacktestPlan()
    table = parse(BacktestTable, data, str(file), "backtest", notes)
    if not is_calendar(table.calibrate):
        section = TableContext(file, "backtest", notes)
        raise section.error("calibrate", table.calibrate, f"it must be {CALENDARS}")
    return BacktestPlan(table.calibrate, table.window, table.prices, table.season)


def is_calendar(value: Any) -> bool:
    """Whether a value is a calendar of estimates."""
    if isinstance(value, str):
        return value == NEVER or value in PERIODS
    return isinstance(value, int) and not isinstance(value, bool) and value >= 1
