"""Deltas by delivery day and month, next to the volumes of the intrinsic plan."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from snapo.report import charts
from snapo.report.drawing import days as date_numbers
from snapo.report.drawing import draw
from snapo.report.missing import why_missing
from snapo.report.page import Block, Chart, Table
from snapo.report.quantity import SPACE, decimals, long_month, number
from snapo.solver.derivatives.interval import Reported
from snapo.study.chapter import Chapter, Floats, Number, floats
from snapo.study.study import StudyRun

from ..setup import case_of
from .position import POSITION
from .run import StorageRun
from .value import INTRINSIC

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIGN = (
    "In a month with a positive delta the storage is long (it will withdraw): the hedge sells that "
    "volume of futures. If the delta is negative, the hedge buys the volume."
)


@dataclass(frozen=True)
class DailyDeltas:
    """Deltas [T] by decision day, in the unit of gas.

    - `discounted`: the deltas of the present value, with `low` and `high` of their 95 % intervals
      and the `standard_error` of the held derivative; `undiscounted`: the volumes of futures.
    - `moved`: the change of the deltas in the second half of training; `intrinsic`: the deltas of
      the intrinsic plan.
    """

    discounted: Floats = floats()
    low: Floats = floats()
    high: Floats = floats()
    standard_error: Floats = floats()
    undiscounted: Floats = floats()
    moved: Floats = floats()
    intrinsic: Floats = floats()


@dataclass(frozen=True)
class MonthDelta:
    """The delta of a delivery `month`, such as "2021-04"; other fields as in `DailyDeltas`.

    - `sampling`, `policy`: the parts of the half-width of the discounted interval; `source`: see
      `solver.derivatives.interval.Reported`; `smooth`: the delta under the smooth rules, with the
      policy reacting.
    """

    month: str
    discounted: Number = np.nan
    low: Number = np.nan
    high: Number = np.nan
    sampling: Number = np.nan
    policy: Number = np.nan
    source: str = ""
    standard_error: Number = np.nan
    undiscounted: Number = np.nan
    undiscounted_low: Number = np.nan
    undiscounted_high: Number = np.nan
    moved: Number = np.nan
    smooth: Number = np.nan
    intrinsic: Number = np.nan

    @property
    def half_width(self) -> float:
        """Half the width of the interval of the undiscounted delta."""
        return (self.undiscounted_high - self.undiscounted_low) / 2

    @property
    def hedge(self) -> str:
        """The hedging trade in futures of the month."""
        if not np.isfinite(self.undiscounted) or self.undiscounted == 0:
            return ""
        return "sell" if self.undiscounted > 0 else "buy"


@dataclass(frozen=True)
class CurveDeltas:
    """The deltas by day and by month."""

    deltas_daily: DailyDeltas = field(default_factory=DailyDeltas)
    deltas_monthly: tuple[MonthDelta, ...] = ()


def measure(run: StudyRun) -> CurveDeltas:
    """The reported derivatives with respect to the forward curve; writes profile.csv."""
    setup, table, plan = run.setup, run.solution.sensitivities, INTRINSIC.of(run)
    case, steps = case_of(setup), setup.problem.schedule.steps
    count, curve = len(case.days), case.market.forward_curve.name
    if table is None or plan is None:
        return CurveDeltas()
    delta = table.of(curve)
    moved = np.zeros(delta.value.size) if table.moved is None else table.moved[curve].value
    smooth = None if table.smooth is None else table.smooth[curve]
    net = plan.net
    sold = -net * np.where(net < 0, 1 - steps.withdrawal_fuel, 1 + steps.injection_fuel)
    numbers = delta.numbers()[:count]
    daily = DailyDeltas(
        delta.value[:count],
        np.array([interval.low for interval in numbers]),
        np.array([interval.high for interval in numbers]),
        table.held[curve].standard_error[:count],
        delta.value[:count] / steps.gas_discount,
        moved[:count],
        sold,
    )
    months = np.array([day.strftime("%Y-%m") for day in case.days])
    monthly = []
    for month in dict.fromkeys(months):
        days = np.zeros(delta.value.size)
        days[:count] = months == month
        monthly.append(
            MonthDelta(
                month,
                *delta.along(days),
                delta.source,
                table.held[curve].along(days)[1],
                *futures_along(delta, days, steps.gas_discount),
                float(moved @ days),
                np.nan if smooth is None else smooth.along(days)[0],
                float(sold @ days[:count]),
            )
        )
    run.write_csv("profile.csv", *_profile(run, daily))
    return CurveDeltas(daily, tuple(monthly))


def futures_along(
    delta: Reported, weights: np.ndarray, discount: np.ndarray
) -> tuple[float, float, float]:
    """The undiscounted derivative along `weights` of the numbers of a curve, and its 95 % interval:
    the volume of futures that hedges it. `discount` [T]: discount factors of the payments of the
    days."""
    rate = np.ones(delta.value.size)
    rate[: len(discount)] = discount
    futures = delta.along(weights / rate)
    return futures.value, futures.low, futures.high


def _profile(run: StudyRun, daily: DailyDeltas) -> tuple[tuple[str, ...], Iterable[tuple]]:
    """Header and rows of profile.csv, one row per decision day."""
    days, position = run.get("days"), POSITION.of(run)
    assert position is not None
    columns = {"date": days, "forward": run.get("forward")}
    for name, band in (("inventory", position.inventory), ("flow", position.flow)):
        for line in ("mean", "p05", "p95"):
            columns[f"{name}_{line}"] = getattr(band, line)[: len(days)]
    columns["trigger_injection"] = position.trigger_injection
    columns["trigger_withdrawal"] = position.trigger_withdrawal
    columns["delta"] = daily.discounted
    columns["delta_undiscounted"] = daily.undiscounted
    return tuple(columns), zip(*columns.values())


def show(run: StorageRun, deltas: CurveDeltas) -> Sequence[Block]:
    """Deltas by delivery month with their intervals, next to the intrinsic volumes."""
    months = deltas.deltas_monthly
    if not any(np.isfinite(x.undiscounted) for x in months):
        return [why_missing(run, DELTAS.name)]
    bars = [f"{long_month(x.month)} {number(x.undiscounted, 0)}" for x in months]
    alt = f"Bars of the delta per delivery month in {run.volume}: " + ", ".join(bars) + "."
    svg = draw("deltas-by-month", alt, month_painter(run, months), 280)
    caption = (
        f"Volumes to trade in futures (undiscounted). {SIGN} Whiskers: 95 % intervals of the "
        "sampling error and the error of the policy together. The sum over the months is not the "
        "gas in store: the rule buys at low prices and sells at high ones, and each volume is "
        "weighted by the ratio of its price to the forward price."
    )
    days = _daily(run, deltas.deltas_daily)
    return [Chart(svg, caption), _month_table(run, months), *days, _parts_table(run, months)]


def month_painter(run: StorageRun, months: Sequence[MonthDelta]) -> "Callable[[Axes], None]":
    """Draws the monthly deltas into one `Axes`; it is also used for the separate picture."""
    columns = [(x.undiscounted, x.half_width, x.intrinsic) for x in months]
    values, halves, intrinsic = np.array(columns, np.float64).T
    options = {
        "names": ("Long: sell", "Short: buy"),
        "half": np.nan_to_num(halves) if np.isfinite(halves).any() else None,
        "compare": ("Intrinsic plan", intrinsic) if np.isfinite(intrinsic).any() else None,
    }
    labels = _month_labels([x.month for x in months])
    return lambda axes: charts.signed_bars(axes, labels, values, run.volume, **options)


def _month_labels(months: Sequence[str]) -> list[str]:
    """ "Apr" for each month, or for every second, third … if there are many; with the year where a
    year begins."""
    step = next((step for step in (1, 2, 3, 6, 12) if len(months) <= 18 * step), 24)
    labels, last = [""] * len(months), ""
    for i in range(0, len(months), step):
        name, _, year = long_month(months[i]).partition(SPACE)
        labels[i] = name if year == last else f"{name}\n{year}"
        last = year
    return labels


def _month_table(run: StorageRun, months: Sequence[MonthDelta]) -> Table:
    digits = decimals([x for month in months for x in (month.undiscounted, month.intrinsic)], 4)
    rows = [
        (
            long_month(x.month),
            x.hedge,
            *(number(v, digits) for v in (x.undiscounted, x.undiscounted_low, x.undiscounted_high)),
            number(x.intrinsic, digits),
        )
        for x in months
    ]
    delta, plan = (
        number(np.nansum([getattr(x, name) for x in months]), digits)
        for name in ("undiscounted", "intrinsic")
    )
    rows.append(("All months", "", delta, "", "", plan))
    names = ("Delta", "95 % low", "95 % high", "Intrinsic")
    head = [("Delivery", ""), ("Hedge", ""), *((name, run.volume) for name in names)]
    return Table(head, rows, texts=2, strong=frozenset([len(rows) - 1]))


def _parts_table(run: StorageRun, months: Sequence[MonthDelta]) -> Table:
    """The parts of the intervals, the change of the deltas late in training, and the deltas under
    the smooth rules."""
    names = ("discounted", "moved", "smooth")
    digits = decimals([getattr(x, name) for x in months for name in names], 4)
    rows = [
        (
            long_month(x.month),
            number(x.discounted, digits),
            *(number(v, max(digits, 1)) for v in (x.sampling, x.policy)),
            number(x.moved, digits, sign=True),
            number(x.smooth, digits),
        )
        for x in months
    ]
    total = number(np.nansum([x.discounted for x in months]), digits)
    rows.append(("All months", total, "", "", "", ""))
    heads = ("Discounted", "± sampling", "± policy", "Late change", "Through the smooth rules")
    caption = (
        "Deltas of the present value; the two parts of the half-width of their 95 % intervals; "
        "their change in the second half of training (a diagnostic: the interval includes the "
        "error of the policy); and the deltas under the smooth rules, with the policy reacting"
    )
    head = [("Delivery", ""), *((name, run.volume) for name in heads)]
    folded = "Discounted deltas, parts of the intervals, change in training"
    return Table(head, rows, caption, strong=frozenset([len(rows) - 1]), folded=folded)


def _daily(run: StorageRun, by_day: DailyDeltas) -> Sequence[Chart]:
    """The same deltas by delivery day: one thin bar a day."""
    values, days = by_day.undiscounted, run.days
    if days is None or not np.isfinite(values).any():
        return ()
    half, compare = None, None
    if by_day.low.size and by_day.discounted.size:
        discounted = by_day.discounted
        factor = np.divide(values, discounted, out=np.ones_like(values), where=discounted != 0)
        half = np.nan_to_num((by_day.high - by_day.low) / 2 * np.abs(factor))
    if by_day.intrinsic.size:
        compare = ("Intrinsic plan", by_day.intrinsic)
    when, names = date_numbers(days), ("Long: sell", "Short: buy")
    svg = draw(
        "deltas-by-day",
        f"Delta of each of {len(values)} delivery days, from {run.gas(np.nanmin(values))} to"
        f" {run.gas(np.nanmax(values))}.",
        lambda axes: charts.signed_strip(
            axes, when, values, run.volume, names, half=half, compare=compare
        ),
        height=220,
    )
    caption = (
        "Volumes to trade in futures of each delivery day. Whiskers: 95 % intervals. The numbers"
        " are in profile.csv."
    )
    return (Chart(svg, caption, folded="Deltas by delivery day"),)


DELTAS = Chapter("deltas", "Deltas by delivery month", CurveDeltas, measure, show, "Deltas",
                 needs=("intrinsic value", "training", "profile"))  # fmt: skip
