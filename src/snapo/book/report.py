"""The report of a book, from its result.json and book.json only."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from snapo.report import charts
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Facts, Headline, Missing, Page, Section, Table, Text
from snapo.report.quantity import decimals, measured, number, seconds
from snapo.report.rows import Column, WithError, table

BASE = "base"
MAX_ROWS = 40  # rows of a table of stresses, and bars of a picture


class StressRow(NamedTuple):
    """A stress in the report."""

    name: str
    value: WithError
    change: WithError
    explained: float | None
    unexplained: float | None


def page(result: Mapping[str, Any], record: Mapping[str, Any]) -> Page:
    """The whole report."""
    sums = {row["stress"]: row for row in result["sums"]}
    sections = [_headline(result, sums[BASE])]
    if len(sums) > 1:
        sections.append(_stresses(result))
    if result["by"]:
        sections.append(_groups(result))
    if any(x["held"] for x in result["deltas"]):
        sections.append(_deltas(result))
    if result["failures"]:
        sections.append(_failures(result))
    sections.append(_cost(result))
    about = [
        ("Contracts", f"{len(record['cases']):,}"),
        ("Stresses", f"{len(record['stresses']):,}"),
        ("Policy", _policy(record["tasks"])),
        ("Paths", f"{record['tasks']['paths']:,}"),
    ]
    version = record["versions"].get("snapo", "")
    footer = f"Made by snapo {version} from the files of a book; the page needs and sends nothing."
    return Page(str(result["title"]), about, sections, footer)


def _policy(tasks: Mapping[str, Any]) -> str:
    if tasks["policy"] == "stress":
        return "trained again under every stress"
    return "trained once for each contract, and held under stress"


def _headline(result: Mapping[str, Any], base: Mapping[str, Any]) -> Section:
    cases, failed = result["cases"]["ok"], result["cases"]["failed"]
    valued = f"{cases:,} of {cases + failed:,} contracts have a value at every point"
    if base["value"] is None:
        blocks: list[Block] = [Missing(f"The book has no value: {valued}; see the failures below.")]
        return Section("value", "Value of the book", "Value", blocks)
    digits = decimals([base["value"]], 6)
    value, error = measured(base["value"], base["standard_error"], digits)
    note = f"{valued}. The standard error counts the paths that contracts of one market share."
    blocks = [Headline("value of the book", value, error, note)]
    blocks += [Text(f"{text[0].upper()}{text[1:]}.", caveat=True) for text in result["notes"]]
    if result["risk"]:
        tiles = []
        for risk in result["risk"]:
            level = f"{risk['level']:.0%}"
            for name, key in (("value at risk", "var"), ("expected shortfall", "shortfall")):
                text, error = measured(risk[key], risk[f"{key}_error"], digits)
                tiles.append((f"{level} {name}", text, error))
        blocks += [Facts(tiles), Text(RISK, caveat=True)]
    return Section("value", "Value of the book", "Value", blocks)


RISK = (
    "Losses over the stresses as scenarios of equal weight; the errors are those of Monte Carlo, "
    "without that of having only these scenarios."
)


def _rows(sums: Sequence[Mapping[str, Any]]) -> list[StressRow]:
    return [
        StressRow(
            row["stress"],
            WithError(row["value"], row["standard_error"]),
            WithError(row["change"], row["change_error"]),
            row.get("explained"),
            row.get("unexplained"),
        )
        for row in sums
        if row["stress"] != BASE and row["change"] is not None
    ]


def _stresses(result: Mapping[str, Any]) -> Section:
    rows = sorted(_rows(result["sums"]), key=lambda row: row.change.value or 0.0)
    if not rows:
        blocks: list[Block] = [Missing("No stress has a value for every contract.")]
        return Section("stresses", "Stresses", "Stresses", blocks)
    displayed = rows if len(rows) <= MAX_ROWS else [*rows[: MAX_ROWS // 2], *rows[-MAX_ROWS // 2 :]]
    digits = decimals([row.change.value for row in displayed], 5)
    bars = [
        charts.LadderBar(
            row.name,
            row.change.value or 0.0,
            number(row.change.value, digits, True),
            row.change.error,
            False,
        )
        for row in displayed
    ]
    alt = "; ".join(f"{bar.name} {bar.text}" for bar in bars)
    svg = draw("stress-bars", alt, lambda axes: charts.ladder(axes, bars), 40 + 26 * len(bars))
    caption = "The change of the book's value under every stress, the worst first"
    if len(displayed) < len(rows):
        caption += f"; of {len(rows):,} the {MAX_ROWS // 2} worst and the {MAX_ROWS // 2} best"
    columns = [
        Column("Stress", "name"),
        Column("Value", "value"),
        Column("Change", "change", sign=True),
        Column("Explained by derivatives", "explained", sign=True),
        Column("Unexplained", "unexplained", sign=True),
    ]
    if any(row.explained is None for row in displayed):
        columns = columns[:3]
    text = Text(
        "A policy that was trained once for its contract decides under the stress too; guide and "
        "control variate are those of the stressed numbers. The derivatives are held ones at the "
        "base: to first order.",
        caveat=True,
    )
    blocks = [Chart(svg, caption + "."), table(displayed, columns), text]
    return Section("stresses", "Stresses", "Stresses", blocks)


def _groups(result: Mapping[str, Any]) -> Section:
    blocks: list[Block] = []
    for column, groups in result["by"].items():
        rows = [
            StressRow(
                label or "(none)",
                WithError(sums[0]["value"], sums[0]["standard_error"]),
                WithError(worst["change"], worst["change_error"]) if worst else WithError(None),
                None,
                None,
            )
            for label, sums in groups.items()
            for worst in [_worst(sums)]
        ]
        columns = [Column(column, "name"), Column("Value", "value")]
        if len(result["sums"]) > 1:
            columns.append(Column("Worst stress", "change", sign=True))
        blocks.append(table(rows, columns, f"Value by {column}"))
    return Section("groups", "Parts of the book", "Parts", blocks)


def _worst(sums: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    stored = [row for row in sums[1:] if row["change"] is not None]
    return min(stored, key=lambda row: row["change"], default=None)


class DeltaRow(NamedTuple):
    """A derivative in the report."""

    market: str
    input: str
    label: str
    held: WithError


def _deltas(result: Mapping[str, Any]) -> Section:
    rows = [
        DeltaRow(x["market"], x["input"], x["label"], WithError(x["held"], x["held_error"]))
        for x in result["deltas"]
        if abs(x["held"]) > 0
    ]
    columns = [
        Column("Market", "market"),
        Column("Input", "input"),
        Column("Month or name", "label"),
        Column("Derivative", "held", sign=True),
    ]
    if not any(row.market for row in rows):
        columns = columns[1:]
    few = rows[:400]
    caption = "Derivatives of the book's value with decisions held, summed over contracts"
    blocks: list[Block] = [
        table(
            few, columns, caption, by_row=True, folded="" if len(few) <= MAX_ROWS else "all inputs"
        )
    ]
    return Section("deltas", "Derivatives", "Derivatives", blocks)


def _failures(result: Mapping[str, Any]) -> Section:
    rows = [(x["case"], x["stress"], x["status"], x["note"]) for x in result["failures"][:200]]
    head = [("Contract", ""), ("Stress", ""), ("Status", ""), ("Reason", "")]
    blocks = [Table(head, rows, "Points without a value", texts=4)]
    return Section("failures", "Failures", "Failures", blocks)


def _cost(result: Mapping[str, Any]) -> Section:
    orders = result["orders"]
    facts = [
        ("orders computed", number(orders["computed"], 0), f"{orders['reused']:,} used again"),
        ("wall time", seconds(result["seconds"]["total"]), f"{result['workers']:,} workers"),
        ("processor time", seconds(result["cpu_seconds"]), "of all answers, whenever computed"),
        ("largest worker", f"{result['peak_mb']:,.0f} MB", f"{result['shapes']:,} shapes"),
    ]
    return Section("cost", "Cost", "Cost", [Facts(facts)])
