"""The report of an explained change: a waterfall, and its tables."""

from collections.abc import Sequence

from snapo import __version__
from snapo.report import charts
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Facts, Page, Section, Text, render
from snapo.report.quantity import decimals, long_date, money, number
from snapo.report.rows import Column, WithError, table

from . import CASH
from .parts import ChangePart, ExplainedChange

CAPTION = (
    "From the value of the first run at the top to that of the second one at the bottom. Each bar "
    "begins where the one above ends; the numbers add up to the change. The scale does not begin "
    "at zero."
)
METHOD = (
    "Each part is a revaluation with all parts above it in place, on the same paths. Decisions are "
    "those of the first run's policy, whose marginal values adapt to the new numbers; in the part "
    "“policy” the second run's policy takes over. Whiskers and ± are 95 % intervals."
)
ORDERS = (
    "First order is delta times move with the decisions of the old curve. Second order is half of "
    "the change in delta times the move, which includes cross effects between periods."
)


def page(change: ExplainedChange) -> str:
    """The report as HTML."""
    dates = [long_date(date) for date in change.dates]
    about = [("First run", f"{change.runs[0]}, {dates[0]}")]
    about.append(("Second run", f"{change.runs[1]}, {dates[1]}"))
    sections = [_parts(change), _curve_section(change)]
    if change.flows:
        sections.append(_flows(change))
    footer = f"Made by snapo {__version__} from two run folders; the page needs and sends nothing."
    title = f"Explained change: {change.title}"
    menu = [(section.name, section.short) for section in sections]
    return render(Page(title, about, sections, footer, menu=menu))


def _parts(change: ExplainedChange) -> Section:
    digits, rows = change.digits, change.totals
    facts = [
        ("Value before", money(change.values[0], change.currency, digits), change.dates[0]),
        ("Value now", money(change.values[1], change.currency, digits), change.dates[1]),
        ("Change of value", money(change.change, change.currency, digits, sign=True), ""),
    ]
    if change.flows:
        text = money(change.profit, change.currency, digits, sign=True)
        facts.append(("Profit and loss", text, "change of value and cash"))
    columns = [
        Column("Part", lambda row: row.part.capitalize()),
        Column("Meaning", "note"),
        Column(
            "Amount",
            lambda row: WithError(row.amount, row.standard_error),
            change.currency,
            sign=True,
            decimal_places=digits,
        ),
    ]
    blocks: list[Block] = [Facts(facts), _waterfall(change, rows), table(rows, columns)]
    blocks += [Text(METHOD), *(Text(f"{note}.") for note in change.notes)]
    return Section("parts", "Parts of the change", "Parts", blocks)


def _waterfall(change: ExplainedChange, rows: Sequence[ChangePart]) -> Chart:
    digits = min(change.digits, decimals([row.amount for row in rows], 5))
    steps = [
        charts.LadderBar(
            row.part.capitalize(), row.amount, number(row.amount, digits, sign=True),
            row.standard_error,
        )
        for row in rows
    ]  # fmt: skip
    bars = [
        (f"{name}, {date}", value, number(value, digits))
        for name, date, value in zip(("Before", "Now"), change.dates, change.values)
    ]
    before, now = (charts.LadderBar(*bar, strong=True) for bar in bars)
    alt = "; ".join(f"{bar.name} {bar.text}" for bar in (before, *steps, now))
    height = 40 + 30 * (len(steps) + 2)
    svg = draw("explained", alt, lambda axes: charts.waterfall(axes, before, steps, now), height)
    return Chart(svg, CAPTION)


def _curve_section(change: ExplainedChange) -> Section:
    parts = list(dict.fromkeys(row.part for row in change.parts if row.period))
    orders = [[row for row in change.parts if row.part == part] for part in parts]
    records = list(zip(change.moves, *orders, strict=True))

    def order(k: int, name: str) -> Column:
        def of(record) -> WithError:
            return WithError(record[k].amount, record[k].standard_error)

        return Column(name, of, change.currency, sign=True, decimal_places=change.digits)

    per = f"{change.currency}/{change.unit}"
    columns = [
        Column("Delivery", lambda record: record[0].period),
        Column("Mean move", lambda record: record[0].move, per, sign=True, decimal_places=4),
        Column("Delta", lambda record: record[0].delta, change.unit),
        order(1, "First order"),
        order(2, "Second order"),
    ]
    blocks = [table(records, columns), Text(ORDERS)]
    return Section("curve", "Curve by delivery", "Curve", blocks)


def _flows(change: ExplainedChange) -> Section:
    price = f"{change.currency}/{change.unit}"
    columns = [
        Column("Day", "date"),
        Column("Forward price", "price", price, decimal_places=4),
        Column("Spot price", "spot", price, decimal_places=4),
        Column("Planned", "planned", change.unit, sign=True),
        Column("Taken", "taken", change.unit, sign=True),
        Column("Planned cash", "planned_cash", change.currency, decimal_places=change.digits),
        Column("Cash", "cash", change.currency, decimal_places=change.digits),
    ]
    text = (
        "Net volumes into the store on the days between the two valuation dates, and their money "
        f"discounted to the second one. The part “{CASH}” takes it out of the value."
    )
    blocks = [table(change.flows, columns), Text(text)]
    return Section("flows", "Days between", "Days between", blocks)
