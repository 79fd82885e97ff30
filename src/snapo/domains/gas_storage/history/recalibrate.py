"""The model of a back-test, estimated again on some days from the prices up to each of these
days."""

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.case.table import TableContext, parse

from ..read.case import read_case
from .calibrate import INPUTS, ParameterRow, model_table, parameter_rows
from .maximum import fit
from .observed import ObservedMarket
from .read import (
    LONGEST,
    Calibration,
    GaussianTable,
    HistoryTable,
    ObservedPrice,
    calibration_of,
    observed_price,
)
from .table import BOTH, BacktestPlan

NEEDED = frozenset(INPUTS.values())  # by a case: its curve is that of the market


@dataclass(frozen=True)
class DatedEstimate:
    """An estimate on a date; `prices`: the number of prices up to that date.

    - `parameters`: the estimates; none if there are too few prices.
    - `model`: the table `[model]` from this date on; `reason`: why this is the previous model, ""
      if it is the new model.
    """

    date: datetime.date
    prices: int
    parameters: tuple[ParameterRow, ...]
    model: Mapping[str, Any]
    reason: str = ""

    def as_data(self) -> dict[str, Any]:
        """The estimate as data for JSON."""
        rows = [row._asdict() for row in self.parameters]
        return asdict(self) | {"date": self.date.isoformat(), "parameters": rows}


@dataclass(eq=False)
class ModelHistory:
    """The tables of a case with the last estimated model, and all estimates so far.

    **Raises:** `CaseError` if the plan needs estimates, but the model of the case cannot be
    estimated.
    """

    file: Path
    data: Mapping[str, Any]
    observed: ObservedMarket
    plan: BacktestPlan
    estimates: list[DatedEstimate] = field(default_factory=list)

    def __post_init__(self):
        model = self.data["model"]
        about = {key: model[key] for key in ("kind", "shift") if key in model}
        # An unknown kind is refused with the list of those that can be estimated.
        self.kind = parse(GaussianTable, about, str(self.file), "model").kind
        self.shift = float(about.get("shift", 0.0))
        self.prices = list(_prices(self.observed, self.plan.prices == BOTH))

    def estimate(self, day: datetime.date) -> DatedEstimate:
        """Estimates the model on a day; `data` has this model from then on if the history
        determines it."""
        prices = self._until(day)
        rows, table, reason = (), self.data["model"], ""
        try:
            result = fit(self._calibration(prices))
            rows = parameter_rows(result.estimate)
            unknown = [x.parameter for x in rows if x.unknown and x.parameter in NEEDED]
            if not result.estimate.converged:
                reason = "the search did not reach a maximum"
            elif unknown:
                reason = f"the history does not determine {' and '.join(unknown)}"
            else:
                changed = dict(self.data) | {"model": model_table(result)}
                read_case(self.file, changed)  # whether the case can have it
                self.data, table = changed, changed["model"]
        except CaseError as error:
            reason = error.allowed
        self.estimates.append(DatedEstimate(day, len(prices), rows, table, reason))
        return self.estimates[-1]

    def _until(self, day: datetime.date) -> list[ObservedPrice]:
        first = datetime.date.min
        if self.plan.window is not None:
            first = day - datetime.timedelta(self.plan.window - 1)
        return [price for price in self.prices if first <= price.day <= day]

    def _calibration(self, prices: Sequence[ObservedPrice]) -> Calibration:
        settings = {"spot": "spot.csv", "season": self.plan.season}
        table = parse(HistoryTable, settings, str(self.file), "history")
        if not prices:
            raise CaseError(str(self.file), "history", None, "there is no price up to that date")
        section = TableContext(self.observed.folder, "history", [])
        return calibration_of(section, table, self.kind, self.shift, prices)


def _prices(observed: ObservedMarket, curves: bool):
    """All prices: spot prices, and prices of products whose delivery has not begun and is not too
    long."""
    for day, price in zip(observed.spot_days, observed.spot_prices):
        yield observed_price(day, "spot", day, price)
    for day in observed.curve_days if curves else ():
        for first, last, price in observed.curves[day]:
            if day <= first and (last - first).days < LONGEST:
                yield observed_price(day, "quotes", first + (last - first) / 2, price)
