"""The report of a back-test: the realised result compared with the expectation, with and without
hedges."""

import datetime
from string import ascii_uppercase
from typing import NamedTuple

import numpy as np

from snapo import __version__
from snapo.report import charts
from snapo.report.drawing import days as date_numbers
from snapo.report.drawing import draw
from snapo.report.page import (
    Block,
    Chart,
    Facts,
    Headline,
    Mark,
    Page,
    Section,
    Text,
    render,
)
from snapo.report.quantity import (
    PLUS_MINUS,
    decimals,
    long_date,
    measured,
    money,
    number,
    percent,
)
from snapo.report.rows import Bar, Column, WithError, ladder, table

from ..contract.records import StorageCase
from .hedged import HedgeDay, HedgedStore, HedgePosition
from .results import StoreBacktest

TAIL = 0.025  # of simulated histories, below or above which the realised cash flow is improbable
COLOURS = ("withdraw", "good", "inject", "limit", "other")  # of the hedges in a chart
FEW = len(COLOURS)  # hedges that a chart can show
METHOD = (
    "Each day was decided with the prices up to that day. The expectation is the mean result of "
    "the same rule on histories that the model draws on the valuation date; the result of one "
    "history may be far from it."
)


class Month(NamedTuple):
    """A month of the contract; money is discounted to the valuation date."""

    name: str
    spot: float
    injection: float
    withdrawal: float
    inventory: float
    cash: float
    expected: float
    gains: tuple[float, ...]


def page(result: StoreBacktest, case: StorageCase, history: str) -> str:
    """The report as HTML; `history`: the folder of the prices."""
    about = [
        ("Contract", f"{long_date(result.days[0])} to {long_date(result.days[-1])}"),
        ("Prices", history),
        ("Model", case.model.describe()),
    ]
    sections = [_outcome(result, case), _cash(result, case), _positions(result, case)]
    sections += [_months(result, case), _solutions(result, case), _estimates(result)]
    footer = f"Made by snapo {__version__} from a case and past prices; the page uses no network."
    return render(Page(f"Back-test: {case.title}", about, sections, footer))


def _key(hedge: HedgedStore | HedgeDay | HedgePosition) -> str:
    return f"{hedge.hedge}: {hedge.products}"


def _letters(result: StoreBacktest) -> dict[str, str]:
    """{hedge: its name in charts}; the table of hedges explains these names."""
    return {_key(x): f"Hedge {ascii_uppercase[i % 26]}" for i, x in enumerate(result.hedges)}


def _outcome(result: StoreBacktest, case: StorageCase) -> Section:
    currency, digits = case.currency, decimals([result.realised, result.expected], 6)
    less = percent(result.share, 0)
    discounted = f"discounted to {long_date(case.valuation_date)}"
    note = f"{less} of simulated histories earn less; {discounted}"
    difference, half = measured(result.realised - result.expected, result.error, digits, sign=True)
    context = f"{difference} {half} compared with the expectation; {PLUS_MINUS}."
    realised = money(result.realised, currency, digits)
    top = Headline("Realised", realised, "", f"{note}.", marks=_marks(result, case, digits),
                   context=context)  # fmt: skip
    expected, half = measured(result.expected, result.error, digits)
    spread = f"{half}; standard deviation of one history {number(result.deviation)}"
    facts = [("Expected", f"{currency} {expected}", spread)]
    if result.rolling is not None:
        facts.append(
            ("Rolling intrinsic", money(result.rolling, currency, digits), "on the same curves")
        )
    facts.append(
        (
            "Intrinsic at start",
            money(result.marks[0].intrinsic, currency, digits),
            "at the first curve",
        )
    )
    bars = [Bar("Contract", result.realised, strong=True), Bar("Expected", result.expected,
            result.error)]  # fmt: skip
    if result.rolling is not None:
        bars.append(Bar("Rolling intrinsic", result.rolling))
    names = _letters(result)
    bars += [Bar(f"Contract and hedge {names[_key(x)][-1]}", x.total) for x in result.hedges]
    caption = f"Cash flow of the whole test, {currency}, with and without hedges"
    blocks: list[Block] = [top, Facts(facts), ladder("outcome", bars, caption, digits)]
    if result.hedges:
        blocks.append(_hedges(result, case))
    return Section("outcome", "Realised and expected", "Result", [*blocks, Text(METHOD, True)])


def _marks(result: StoreBacktest, case: StorageCase, digits: int) -> list[Mark]:
    """Marks: whether the history is probable in the model, and whether rolling intrinsic did
    better."""
    probable = TAIL <= result.share <= 1 - TAIL
    where = "within" if probable else "outside"
    marks = [Mark(probable, f"{where} the range of 95 % of simulated histories")]
    if result.rolling is not None and result.rolling > result.realised:
        more = money(result.rolling - result.realised, case.currency, digits)
        marks.append(Mark(False, f"rolling intrinsic earned {more} more"))
    return marks


class HedgeLine(NamedTuple):
    """A row of the table of hedges."""

    name: str
    gain: float
    total: float
    deviation: float | None
    traded: float
    cost: float


def _hedges(result: StoreBacktest, case: StorageCase) -> Block:
    def deviation(value: float) -> float | None:
        return value if np.isfinite(value) else None

    rows = [
        HedgeLine(
            "Without a hedge", 0.0, result.realised, deviation(result.mark_deviation), 0.0, 0.0
        )
    ]
    names = _letters(result)
    rows += [
        HedgeLine(
            f"{names[_key(x)][-1]}  {_key(x)}",
            x.gain,
            x.total,
            deviation(x.deviation),
            x.traded,
            x.cost,
        )
        for x in result.hedges
    ]
    columns = [
        Column("Hedge", "name"),
        Column("Gain of the hedge", "gain", case.currency, sign=True),
        Column("Contract and hedge", "total", case.currency),
        Column("Standard deviation", "deviation", case.currency),
        Column("Volume traded", "traded", case.volume_unit),
        Column("Cost", "cost", case.currency),
    ]
    caption = (
        "Profit and loss with each hedge, after its costs. The standard deviation is that of the "
        "change of contract and hedge together from one solution to the next, marked to the curve"
    )
    return table(rows, columns, caption)


def _gains(result: StoreBacktest) -> dict[str, np.ndarray]:
    """{name of a hedge in charts: [T] its gain on each day, minus costs}; the gain before the first
    day is added to that of the first day."""
    index = {day: t for t, day in enumerate(result.days)}
    gains = {_key(x): np.zeros(len(result.days)) for x in result.hedges}
    for x in result.hedge_days:
        day = min(max(x.date, result.days[0]), result.days[-1])
        gains[_key(x)][index[day]] += x.gain - x.cost
    names = _letters(result)
    return {names[key]: gain for key, gain in gains.items()}


def _cash(result: StoreBacktest, case: StorageCase) -> Section:
    when = date_numbers([day.isoformat() for day in result.days])
    cash, expected = np.cumsum(result.cash), np.cumsum(result.expected_cash)
    low, high = result.band
    lines = [charts.Line("Realised", cash, "ink", width=2.0)]
    gains = list(_gains(result).items())[:FEW]
    for (name, gain), colour in zip(gains, COLOURS):
        label = f"With hedge {name[-1]}"
        lines.append(charts.Line(label, cash + np.cumsum(gain), colour, width=1.2))

    def paint(axes):
        charts.fan(axes, when, expected, low, high, case.currency)
        charts.lines(axes, when, lines, case.currency)

    alt = (
        f"Cash flow so far by day: realised {number(cash[-1])} at the end, expected "
        f"{number(expected[-1])}, with a band of 90 % of simulated histories."
    )
    caption = (
        "Cash flow so far: realised, and its mean on simulated histories with a band of 90 %"
        + ("; with the gains of hedges so far." if gains else ".")
        + " It includes neither the value of gas left nor fixed costs."
    )
    blocks: list[Block] = [Chart(draw("cash", alt, paint, 300), caption)]
    if len(result.marks) > 1:
        blocks.append(_marked(result, case))
    return Section("cash", "Cash flow over time", "Over time", blocks)


def _marked(result: StoreBacktest, case: StorageCase) -> Chart:
    """The cash so far plus the expectation of the rest, on the dates of the solutions and at the
    end."""
    dates = [mark.date for mark in result.marks]
    when = date_numbers([day.isoformat() for day in (*dates, result.days[-1])])
    values = np.array([*(mark.cash + mark.expected for mark in result.marks), result.realised])
    lines = [charts.Line("Contract", values, "ink", width=2.0)]
    for (name, gain), colour in zip(list(_gains(result).items())[:FEW], COLOURS):
        so_far = [sum(x for x, d in zip(gain, result.days) if d < day) for day in dates]
        hedged = values + np.array([*so_far, gain.sum()])
        lines.append(charts.Line(f"With hedge {name[-1]}", hedged, colour, width=1.2))
    alt = f"Marked to the curve from {number(values[0])} to {number(values[-1])}."
    svg = draw("marked", alt, lambda axes: charts.lines(axes, when, lines, case.currency), 260)
    caption = (
        "Cash flow so far plus the expectation of the rest, marked to the curve of each "
        "solution. A good hedge keeps this sum nearly constant."
    )
    return Chart(svg, caption)


def _positions(result: StoreBacktest, case: StorageCase) -> Section:
    when = date_numbers([day.isoformat() for day in result.days])
    unit, flow = case.volume_unit, result.withdrawal - result.injection

    def paint(stock, daily, prices):
        charts.lines(stock, when, [charts.Line("Gas in store", result.inventory, "main")], unit)
        charts.signed_strip(daily, when, flow, f"{unit}/day", ("Withdrawal", "Injection"))
        spot = charts.Line("Spot price", result.spots, "ink", width=1.2)
        charts.lines(prices, when, [spot], f"{case.currency}/{unit}")

    peak = int(np.argmax(result.inventory))
    alt = (
        f"Gas in store by day, at most {number(result.inventory[peak])} {unit} on "
        f"{result.days[peak]}; the lower chart shows the flow of each day and the spot price."
    )
    svg = draw("positions", alt, paint, 430, (2.0, 1.0, 1.0))
    caption = "Gas in store after each day, the flow of each day, and the spot price."
    blocks: list[Block] = [Chart(svg, caption)]
    if result.positions:
        blocks.append(_sold(result, case))
    return Section("positions", "Positions", "Positions", blocks)


def _sold(result: StoreBacktest, case: StorageCase) -> Chart:
    """The volume that each hedge has sold in all products at the end of each day."""
    dates = sorted({x.date for x in result.positions})
    index, names = {day: t for t, day in enumerate(dates)}, _letters(result)
    volumes = {names[_key(x)]: np.zeros(len(dates)) for x in result.hedges}
    for x in result.positions:
        volumes[names[_key(x)]][index[x.date]] += x.sold * ((x.last - x.first).days + 1)
    when = date_numbers([day.isoformat() for day in dates])
    lines = [
        charts.Line(name, volume, colour, step=True)
        for (name, volume), colour in zip(list(volumes.items())[:FEW], COLOURS)
    ]
    alt = "; ".join(f"{x.label}: {number(float(np.max(np.abs(x.values))))}" for x in lines)
    svg = draw(
        "sold", f"Largest net volume of the hedges: {alt}.",
        lambda axes: charts.lines(axes, when, lines, case.volume_unit), 230,
    )  # fmt: skip
    caption = "Net volume that each hedge has sold in all products, at the end of each day."
    if len(volumes) > FEW:
        caption += f" The chart shows the first {FEW} of {len(volumes)} hedges."
    return Chart(svg, caption)


def _by_month(result: StoreBacktest) -> list[Month]:
    names = np.array([f"{day:%Y-%m}" for day in result.days])
    gains = list(_gains(result).values())[:FEW]
    rows = []
    for name in dict.fromkeys(names.tolist()):
        of = names == name
        spot = float(result.spots[of].mean())
        sums = (result.injection, result.withdrawal)
        injection, withdrawal = (float(x[of].sum()) for x in sums)
        cash, expected = float(result.cash[of].sum()), float(result.expected_cash[of].sum())
        stored = float(result.inventory[of][-1])
        by_hedge = tuple(float(gain[of].sum()) for gain in gains)
        rows.append(Month(name, spot, injection, withdrawal, stored, cash, expected, by_hedge))
    return rows


def _months(result: StoreBacktest, case: StorageCase) -> Section:
    names = list(_gains(result))[:FEW]
    columns = [
        Column("Month", "name"),
        Column("Mean spot price", "spot", f"{case.currency}/{case.volume_unit}"),
        Column("Injection", "injection", case.volume_unit),
        Column("Withdrawal", "withdrawal", case.volume_unit),
        Column("In store at the end", "inventory", case.volume_unit),
        Column("Cash flow", "cash", case.currency, sign=True),
        Column("Expected", "expected", case.currency, sign=True),
    ]
    columns += [
        Column(name, lambda row, k=k: row.gains[k], case.currency, sign=True)
        for k, name in enumerate(names)
    ]
    caption = "By month, discounted; the column of a hedge has its gain minus its costs"
    if not names:
        caption = "By month, discounted"
    return Section("months", "By month", "Months", [table(_by_month(result), columns, caption)])


def _solutions(result: StoreBacktest, case: StorageCase) -> Section:
    columns = [
        Column("Solved on", lambda mark: mark.date.isoformat()),
        Column("In store", "inventory", case.volume_unit),
        Column("Cash so far", "cash", case.currency),
        Column(
            "Expected rest", lambda mark: WithError(mark.expected, mark.standard_error),
            case.currency,
        ),
        Column("Sum", lambda mark: mark.cash + mark.expected, case.currency),
        Column("Best fixed plan", "intrinsic", case.currency),
    ]  # fmt: skip
    caption = f"Dates on which the rule was solved; {PLUS_MINUS}"
    blocks = [table(result.marks, columns, caption)]
    return Section("solutions", "Solutions", "Solutions", blocks)


class EstimateRow(NamedTuple):
    """A parameter of an estimate, in the report."""

    date: str
    parameter: str
    estimate: float
    interval: str
    reason: str


def _estimates(result: StoreBacktest) -> Section:
    rows = [
        EstimateRow(x.date.isoformat(), row.parameter.replace("_", " "), row.estimate,
                    f"{number(row.low)} to {number(row.high)}", x.reason)
        for x in result.estimates
        for row in x.parameters
    ]  # fmt: skip
    columns = [
        Column("Estimated on", "date"),
        Column("Parameter", "parameter"),
        Column("Estimate", "estimate"),
        Column("95 % interval", "interval"),
        Column("Why the previous model was used", "reason"),
    ]
    unchanged = [x for x in result.estimates if x.reason and not x.parameters]
    blocks: list[Block] = []
    if rows:
        caption = "The model, estimated again from the prices up to each date"
        blocks.append(table(rows, columns, caption, by_row=True, folded=_folded(len(rows))))
    blocks += [Text(f"{_day(x.date)}: the previous model is used: {x.reason}.") for x in unchanged]
    return Section("estimates", "Estimates of the model", "Model", blocks)


def _day(day: datetime.date) -> str:
    return long_date(day.isoformat())


def _folded(rows: int) -> str:
    return f"all {rows} numbers" if rows > 24 else ""
