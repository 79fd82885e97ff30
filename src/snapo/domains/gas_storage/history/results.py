"""The results of a back-test: records, tables, and text."""

import datetime
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.error import CaseError, counted
from snapo.solver.statistics import plus_minus
from snapo.solver.tables import write_csv

from .calibrate import INPUTS, ParameterRow
from .hedged import HedgeDay, HedgedStore, HedgePosition
from .recalibrate import DatedEstimate

DAYS, SOLUTIONS, ESTIMATES = "days.csv", "solutions.csv", "calibrations.csv"
REPORT = "report.html"
HEDGES, HEDGE_DAYS, POSITIONS = "hedges.csv", "hedge_days.csv", "hedge_positions.csv"
ESTIMATE_COLUMNS = ("date", "prices", "used", "reason", *ParameterRow._fields)


@dataclass(frozen=True)
class MarkedPosition:
    """A solution, and the position marked to the curve of its date.

    - `date`, `inventory`: the date and the gas in store; `cash`: the realised cash flow so far,
      discounted to the first valuation date.
    - `expected`, `standard_error`: the expected cash flow of the rest of the contract and its
      error, on paths of the model around the curve of the date; `intrinsic`: the cash flow of the
      best fixed plan for the rest. All are discounted to the same date. Both cash flows are after
      the fixed costs of the whole test, those of the past included, as `realised` is.
    """

    date: datetime.date
    inventory: float
    cash: float
    expected: float
    standard_error: float
    intrinsic: float


@dataclass(frozen=True, eq=False)
class StoreBacktest:
    """The result of a back-test over T days; money is discounted to the valuation date.

    - `days`, `spots`, `inventory` (after each day), `injection`, `withdrawal`, `cash` [T]: the
      results by day; `expected_cash` [T]: the mean on the first valuation date.
    - `band`: [T] 5 and 95 % quantiles of the cash flow so far on simulated histories.
    - `realised`: the sum of the cash and the value of the gas left, minus fixed costs.
    - `expected`, `error`: the mean of this sum on simulated histories of the model, and its
      standard error; `deviation`: the standard deviation of one history; `share`: the share of
      histories that earn less than `realised`.
    - `rolling`: the result of rolling intrinsic on the same curves; None without curves.
    - `marks`: for every solution, the position marked to the curve of its date. `mark_deviation`:
      the standard deviation of the change of the marked position from one solution to the next, NaN
      for fewer than two changes.
    - `estimates`: the estimates of the model, on their dates; `hedges`: the result with each hedge;
      `hedge_days`, `positions`: the results and the positions of the hedges by day.
    """

    days: tuple[datetime.date, ...]
    spots: np.ndarray
    inventory: np.ndarray
    injection: np.ndarray
    withdrawal: np.ndarray
    cash: np.ndarray
    expected_cash: np.ndarray
    band: tuple[np.ndarray, np.ndarray]
    realised: float
    expected: float
    error: float
    deviation: float
    share: float
    rolling: float | None
    marks: tuple[MarkedPosition, ...]
    mark_deviation: float
    estimates: tuple[DatedEstimate, ...] = ()
    hedges: tuple[HedgedStore, ...] = ()
    hedge_days: tuple[HedgeDay, ...] = ()
    positions: tuple[HedgePosition, ...] = ()


def write(folder: Path, result: StoreBacktest) -> None:
    head = (
        "date", "spot", "inventory", "injection", "withdrawal", "cash", "cash_so_far",
        "expected_so_far",
    )  # fmt: skip
    columns = (
        result.days,
        result.spots,
        result.inventory,
        result.injection,
        result.withdrawal,
        result.cash,
        np.cumsum(result.cash),
        np.cumsum(result.expected_cash),
    )
    names = ("date", "inventory", "cash_so_far", "expected", "standard_error", "intrinsic")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_csv(folder / DAYS, head, zip(*columns))
        write_csv(folder / SOLUTIONS, names, map(astuple, result.marks))
        if result.estimates:
            write_csv(folder / ESTIMATES, ESTIMATE_COLUMNS, _estimate_rows(result.estimates))
        if result.hedges:
            write_csv(folder / HEDGES, _names(HedgedStore), map(astuple, result.hedges))
            write_csv(folder / HEDGE_DAYS, HedgeDay._fields, result.hedge_days)
            write_csv(folder / POSITIONS, HedgePosition._fields, result.positions)
    except OSError as error:
        message = f"the folder cannot be written ({error.strerror})"
        raise CaseError(str(folder), "", None, message) from None


def _names(record: type) -> tuple[str, ...]:
    return tuple(item.name for item in fields(record))


def _estimate_rows(estimates: Sequence[DatedEstimate]) -> Iterator[tuple]:
    """A row for each parameter of each estimate; a row without a parameter if there is no
    estimate."""
    for x in estimates:
        about = x.date, x.prices, "no" if x.reason else "yes", x.reason
        for *numbers, unknown in x.parameters:
            yield (*about, *numbers, "yes" if unknown else "no")
        if not x.parameters:
            yield (*about, *("" for _ in ParameterRow._fields))


def answer_of(result: StoreBacktest) -> dict[str, Any]:
    return {
        "status": "ok",
        "first": result.days[0].isoformat(),
        "last": result.days[-1].isoformat(),
        "days": len(result.days),
        "realised": result.realised,
        "expected": result.expected,
        "standard_error": result.error,
        "deviation": result.deviation,
        "share": result.share,
        "rolling_intrinsic": result.rolling,
        "intrinsic": result.marks[0].intrinsic,
        "solutions": [asdict(mark) | {"date": mark.date.isoformat()} for mark in result.marks],
        "mark_deviation": _finite(result.mark_deviation),
        "estimates": [estimate.as_data() for estimate in result.estimates],
        "hedges": [asdict(x) | {"deviation": _finite(x.deviation)} for x in result.hedges],
    }


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None


def summary(answer: Mapping[str, Any]) -> str:
    """The answer for a reader."""
    return "\n".join(_lines(answer))


def _lines(answer: Mapping[str, Any]) -> Iterator[str]:
    yield f"{counted(answer['days'], 'day')} from {answer['first']} to {answer['last']}"
    less = f"{answer['share']:.0%} of simulated histories earn less"
    yield f"{'realised':<20}{answer['realised']:>16,.2f}   {less}"
    interval = plus_minus(answer["standard_error"])
    spread = f"{interval} (95 %); standard deviation of one history {answer['deviation']:,.2f}"
    yield f"{'expected':<20}{answer['expected']:>16,.2f}   {spread}"
    if answer["rolling_intrinsic"] is not None:
        yield f"{'rolling intrinsic':<20}{answer['rolling_intrinsic']:>16,.2f}"
    yield f"{'intrinsic at start':<20}{answer['intrinsic']:>16,.2f}"
    yield from _table(answer["solutions"])
    if answer["estimates"]:
        yield from _estimates(answer["estimates"])
    if answer["hedges"]:
        yield from _hedges(answer)
    yield f"by day: {answer['folder'] / DAYS}"
    yield f"report: {answer['folder'] / REPORT}"


def _table(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield f"{'solved on':<12}{'inventory':>14}{'cash so far':>16}{'expected rest':>16}{'sum':>16}"
    for row in rows:
        numbers = (row["cash"], row["expected"], row["cash"] + row["expected"])
        text = "".join(f"{x:>16,.2f}" for x in numbers)
        yield f"{row['date']:<12}{row['inventory']:>14,.2f}{text}"


def _estimates(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The estimated parameters that a case has as keys, with their 95 % intervals."""
    parts = {x["parameter"] for row in rows for x in row["parameters"]}
    names = [name for name in dict.fromkeys(INPUTS.values()) if name in parts]
    yield f"{'estimated on':<14}{'prices':>8}  " + "".join(f"{name:<32}" for name in names)
    for row in rows:
        cells = {x["parameter"]: x for x in row["parameters"]}
        text = "".join(f"{_interval(cells.get(name)):<32}" for name in names)
        yield f"{row['date']:<14}{row['prices']:>8,}  {text}".rstrip()
        if row["reason"]:
            yield f"{'':<24}the previous model is used: {row['reason']}"


def _interval(row: Mapping[str, Any] | None) -> str:
    if row is None:
        return ""
    return f"{row['estimate']:.4g} ({row['low']:.4g} to {row['high']:.4g})"


def _hedges(answer: Mapping[str, Any]) -> Iterator[str]:
    """The result of the contract, of the hedge, and of both. The deviation is that of the change of
    the marked total from one solution to the next."""
    yield (
        f"{'hedge':<52}{'contract':>14}{'hedge':>14}{'both':>14}{'deviation':>14}{'traded':>14}"
        f"{'cost':>12}"
    )
    contract = answer["realised"]
    none = {"hedge": "None", "products": "", "gain": 0.0, "total": contract, "traded": 0.0}
    for row in (none | {"cost": 0.0, "deviation": answer["mark_deviation"]}, *answer["hedges"]):
        name = f"{row['hedge']}: {row['products']}" if row["products"] else row["hedge"]
        deviation = "" if row["deviation"] is None else f"{row['deviation']:,.0f}"
        numbers = "".join(f"{x:>14,.0f}" for x in (contract, row["gain"], row["total"]))
        yield f"{name:<52}{numbers}{deviation:>14}{row['traded']:>14,.0f}{row['cost']:>12,.0f}"
