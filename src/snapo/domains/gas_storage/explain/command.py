"""`snapo explain RUN_A RUN_B`: the change of value between two runs, as a table and a report with a
waterfall.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from snapo import __version__
from snapo.case.error import CaseError
from snapo.report import charts
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Facts, Page, Section, Text, render
from snapo.report.quantity import decimals, long_date, money, number
from snapo.report.rows import Column, WithError, table
from snapo.solver.statistics import plus_minus
from snapo.solver.tables import write_csv, write_text
from snapo.study.domain import find
from snapo.study.prepare import use_every_core
from snapo.study.run_folder import plain_json

from . import CASH
from .change import ChangePart, ExplainedChange
from .flows import read_flows
from .runs import ValuedRun, check_pair

FOLDER, PARTS, MOVES, RESULT, REPORT = (
    "explain", "explain.csv", "curve.csv", "explain.json", "explain.html",
)  # fmt: skip


def explain(
    first: Path,
    second: Path,
    progress,
    *,
    flows: Path | None = None,
    cash: float | None = None,
    out: Path | None = None,
) -> dict[str, Any]:
    """Explains the change of value from the first run to the second one, and writes the parts.

    - `flows`: for a gas store, a CSV file of the flows on the days between the two dates, with
      columns date,volume,price. `cash`: for other contracts, the actual cash flow between the two
      dates.
    - `out`: folder of the results, by default `explain` in the folder of the second run.

    **Raises:** `CaseError` if a run has no value, or the second run cannot follow the first;
    nothing is written.
    """
    use_every_core()
    runs = ValuedRun.read(first), ValuedRun.read(second)
    check_pair(*runs)
    kind: Any = find(runs[1].case.kind, str(second))
    options = {} if flows is None else {"flows": read_flows(flows)}
    options |= {} if cash is None else {"cash": cash}
    change = kind.loaded(kind.explainer)(*runs, progress, **options)
    folder, answer = second / FOLDER if out is None else out, _answer(change)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        head = ("part", "period", "amount", "standard_error", "note")
        write_csv(folder / PARTS, head, _cells(head, change.parts))
        head = ("period", "days", "move", "delta")
        write_csv(folder / MOVES, head, _cells(head, change.moves))
        write_text(folder / RESULT, json.dumps(plain_json(answer), indent=1))
        write_text(folder / REPORT, page(change))
    except OSError as error:
        message = f"the folder cannot be written ({error.strerror})"
        raise CaseError(str(folder), "", None, message) from None
    return answer | {"folder": folder}


def _cells(names: Sequence[str], records: Sequence[Any]) -> Iterator[list[Any]]:
    for record in records:
        values = [getattr(record, name) for name in names]
        yield ["" if value is None else value for value in values]


def _answer(change: ExplainedChange) -> dict[str, Any]:
    return {
        "status": "ok",
        "runs": [str(run) for run in change.runs],
        "dates": list(change.dates),
        "currency": change.currency,
        "values": list(change.values),
        "standard_errors": list(change.errors),
        "change": change.change,
        "cash": change.cash,
        "profit": change.profit,
        "parts": [asdict(row) for row in change.parts],
        "totals": [asdict(row) for row in change.totals],
        "curve": [asdict(row) for row in change.moves],
        "flows": [flow._asdict() for flow in change.flows],
        "paths": change.paths,
        "notes": list(change.notes),
        "digits": change.digits,
    }


def summary(answer: Mapping[str, Any]) -> str:
    """The answer for a reader."""
    return "\n".join(_lines(answer))


def _lines(answer: Mapping[str, Any]) -> Iterator[str]:
    digits, (before, now) = answer["digits"], answer["dates"]
    rows = [ChangePart(**row) for row in answer["parts"]]
    amounts = [*answer["values"], *(row.amount for row in rows)]
    width = max(14, *(len(f"{x:,.{digits}f}") + 2 for x in amounts))

    def line(name: str, amount: float, error: float | None = None, note: str = "") -> str:
        half = "" if error is None else plus_minus(error)
        return f"{name:<26}{amount:>{width},.{digits}f} {half:<11} {note}".rstrip()

    yield f"{answer['currency']}; ± is half of a 95 % interval, on {answer['paths']:,} paths"
    yield line(f"value before, {before}", *_value(answer, 0))
    for total in (ChangePart(**row) for row in answer["totals"]):
        yield line(f"  {total.part}", total.amount, total.standard_error, total.note)
    yield line(f"value now, {now}", *_value(answer, 1))
    yield line("change of value", answer["change"])
    if answer["cash"] or answer["flows"]:
        yield line("profit and loss", answer["profit"], None, "change of value plus cash flow")
    if any(row.period and row.amount for row in rows):
        yield from _curve(answer, rows, digits, width)
    for note in answer["notes"]:
        yield f"note: {note}"
    yield f"report: {answer['folder'] / REPORT}"


def _value(answer: Mapping[str, Any], k: int) -> tuple[float, float]:
    return answer["values"][k], answer["standard_errors"][k]


def _curve(
    answer: Mapping[str, Any], rows: Sequence[ChangePart], digits: int, width: int
) -> Iterator[str]:
    yield ""
    yield f"{'curve':<16}{'move':>12}{'delta':>14}{'first order':>{width}}{'second':>{width}}"
    orders = [[row for row in rows if row.part == part] for part in dict.fromkeys(
        row.part for row in rows if row.period
    )]  # fmt: skip
    for move, first, second in zip(answer["curve"], *orders, strict=True):
        delta = "" if move["delta"] is None else f"{move['delta']:,.1f}"
        text = f"{move['period']:<16}{move['move']:>12,.4f}{delta:>14}"
        yield text + "".join(f"{x.amount:>{width},.{digits}f}" for x in (first, second))


CAPTION = (
    "The chart goes from the value of the first run at the top to that of the second run at the "
    "bottom. Each bar begins where the bar above it ends; the numbers add up to the change. The "
    "scale does not begin at zero."
)
METHOD = (
    "Each part is a revaluation on top of the parts above it, on the same paths. The policy of the "
    "first run decides, with marginal values that adapt to the new numbers; in the part “policy” "
    "the policy of the second run decides. Whiskers and ± are 95 % intervals."
)
ORDERS = (
    "First order is delta times move, with the decisions at the old curve. Second order is half of "
    "the change in delta times the move; it includes cross effects between periods."
)


def page(change: ExplainedChange) -> str:
    """The report as HTML."""
    dates = [long_date(date) for date in change.dates]
    about = [("First run", f"{change.runs[0]}, {dates[0]}")]
    about.append(("Second run", f"{change.runs[1]}, {dates[1]}"))
    sections = [_parts(change), _curve_section(change)]
    if change.flows:
        sections.append(_flows(change))
    footer = f"Made by snapo {__version__} from two run folders; the page uses no network."
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
        facts.append(("Profit and loss", text, "change of value plus cash flow"))
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
        Column("Planned flow", "planned", change.unit, sign=True),
        Column("Flow taken", "taken", change.unit, sign=True),
        Column("Planned cash flow", "planned_cash", change.currency, decimal_places=change.digits),
        Column("Cash flow", "cash", change.currency, decimal_places=change.digits),
    ]
    text = (
        "Net volumes into the store on the days between the two valuation dates, and their cash "
        f"flow, discounted to the second date. The part “{CASH}” subtracts this cash flow from the "
        "value."
    )
    blocks = [table(change.flows, columns), Text(text)]
    return Section("flows", "Days between", "Days between", blocks)
