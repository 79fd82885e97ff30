"""The report of a book, from its result.json and book.json only."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import counted
from snapo.report import charts, quantity
from snapo.report.drawing import days as date_numbers
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Facts, Headline, Missing, Page, Section, Table, Text
from snapo.report.quantity import decimals, measured, number, readable, seconds, with_unit
from snapo.report.record import LibraryVersions, entries_of
from snapo.report.rows import Column, WithError, table

from .axes import number_of
from .folder import BookRecord, BookResult, StressSum

BASE = "base"
COLOURS = ("main", "withdraw", "inject", "limit", "good", "other")
MAX_DRAWN = 8  # outputs that have a picture over the axes
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
    typed, typed_result = entries_of(BookRecord, record), entries_of(BookResult, result)
    axes = typed.axes
    sections = [_points(result, axes)] if axes else [_headline(result, sums[BASE])]
    # The points of the axes are stresses where a policy is held at all of them.
    held = any(point["change"] is not None for point in typed_result.points)
    if len(sums) > 1 and not held:
        sections.append(_stresses(result))
    if result["by"]:
        sections.append(_groups(result))
    if typed_result.exposure:
        sections.append(_exposure(typed_result.exposure))
    if any(x["held"] for x in result["deltas"]):
        sections.append(_deltas(result))
    if result["shared_policies"]:
        sections.append(_shared(result["shared_policies"]))
    if result["failures"]:
        sections.append(_failures(result))
    sections.append(_cost(result))
    about = [
        *([("Points of the axes", f"{len(typed_result.points):,}")] if axes else []),
        ("Contracts", f"{len(record['cases']):,}"),
        *([("Stresses", f"{len(record['stresses']):,}")] if not held and len(sums) > 1 else []),
        *([("Policy", _policy(record["tasks"]))] if typed_result.policies else []),
        ("Paths", f"{record['tasks']['paths']:,}"),
    ]
    version = entries_of(LibraryVersions, typed.versions).snapo
    footer = f"Made by snapo {version} from the files of a book; the page uses no network."
    return Page(str(result["title"]), about, sections, footer)


def _policy(tasks: Mapping[str, Any]) -> str:
    if tasks["policy"] == "stress":
        return "trained again under every stress"
    if tasks["policy"] == "shape":
        return "trained once for similar contracts if that loses at most 0.5 % of the value"
    return "trained once for each contract, and unchanged under stress"


def _headline(result: Mapping[str, Any], base: Mapping[str, Any]) -> Section:
    cases, failed = result["cases"]["ok"], result["cases"]["failed"]
    valued = f"{cases:,} of {counted(cases + failed, 'contract')} have a value at every point"
    if base["value"] is None:
        blocks: list[Block] = [Missing(f"The book has no value: {valued}; see the failures below.")]
        return Section("value", "Value of the book", "Value", blocks)
    digits = decimals([base["value"]], 6)
    value, error = measured(base["value"], base["standard_error"], digits)
    note = f"{valued}; {quantity.PLUS_MINUS}, with common paths for all contracts of a market."
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
    "Losses, if the stresses are scenarios of equal weight. The intervals contain the simulation "
    "error only, not the error that comes from the small number of scenarios."
)


def _rows(sums: Sequence[Mapping[str, Any]]) -> list[StressRow]:
    return [
        StressRow(
            row.stress,
            WithError(row.value, row.standard_error),
            WithError(row.change, row.change_error),
            row.explained,
            row.unexplained,
        )
        for row in (entries_of(StressSum, entry) for entry in sums)
        if row.stress != BASE and row.change is not None
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
    caption = "The change of the book's value under every stress; the worst stress comes first"
    if len(displayed) < len(rows):
        caption += f"; the {MAX_ROWS // 2} worst and the {MAX_ROWS // 2} best of {len(rows):,}"
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
        "A policy that was trained once for its contract also decides under the stress; its value "
        "table and the control variate are computed again from the stressed numbers. The "
        "explained change is of first order: it uses the derivatives at the base, with decisions "
        "held fixed.",
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


class PointRow(NamedTuple):
    """A point of the axes in the report: the texts of the axis values, the value, the outputs."""

    at: Sequence[str]
    value: WithError
    change: WithError
    outputs: Mapping[str, Mapping[str, Any]]
    note: str

    def of(self, output: str) -> WithError:
        """The figure of an output; the output "" is the value itself."""
        if not output:
            return self.value
        entry = entries_of(StressSum, self.outputs.get(output))
        return WithError(entry.value, entry.standard_error)


def _points(result: Mapping[str, Any], axes: Sequence[Mapping[str, str]]) -> Section:
    """The value over the axes, as a line or a map, and a table of all points."""
    rows = [
        PointRow(
            list(x["at"].values()),
            WithError(x["value"], x["standard_error"]),
            WithError(x["change"], x["change_error"]),
            {entry["name"]: entry for entry in x["outputs"]},
            x["note"],
        )
        for x in result["points"]
    ]
    names = [axis["label"] for axis in axes]
    first = next((row.outputs for row in rows if row.outputs), {})
    # A process has quality attributes, each as important as the share within all limits.
    drawn = [name for name, x in first.items() if x["nominal"] is not None][:MAX_DRAWN]
    value, blocks = "Share of batches within all limits" if drawn else "Value", list[Block]()
    for output in ("", *drawn):
        title = with_unit(output, first[output]["unit"]) if output else value
        blocks += _picture(rows, names, output, title)
    columns = [Column(name, lambda row, i=i: row.at[i]) for i, name in enumerate(names)]
    columns.append(Column(value, "value"))
    if any(row.change.value is not None for row in rows):
        columns.append(Column("Change from the case", "change", sign=True))
    columns += [
        Column(with_unit(name, x["unit"]), lambda row, name=name: row.of(name))
        for name, x in first.items()
    ]
    folded = "" if len(rows) <= MAX_ROWS else "all points"
    keys = ", ".join(f"{axis['label']} is {axis['key']}" for axis in axes)
    blocks.append(table(rows, columns, f"All points; {keys}", folded=folded))
    return Section("points", "Value over the axes", "Axes", blocks)


def _picture(
    rows: Sequence[PointRow], names: Sequence[str], output: str, title: str
) -> list[Block]:
    """A line over one axis or a map over two; no picture for more axes, or for an axis of texts."""
    valued = [row for row in rows if row.of(output).value is not None]
    positions = [[number_of(text) for text in row.at] for row in valued]
    if not valued:
        return [Missing(f"{title}: no point has a value.")]
    name = f"points-{_identifier(output)}"
    span = f"from {number(min(v))} to {number(max(v))}" if (v := _values(valued, output)) else ""
    alt = f"{title} over {' and '.join(names)}, {span}"
    if len(names) == 1 and all(x is not None for (x,) in positions):
        line = sorted(zip((x or 0.0 for (x,) in positions), (row.of(output) for row in valued)))
        svg = draw(name, alt, lambda axes: charts.swept_line(axes, line, names[0], title))
        return [Chart(svg, f"{title} over {names[0]}, with its 95 % interval.")]
    if len(names) == 2:
        cells = {(row.at[0], row.at[1]): row.of(output).value for row in valued}
        marks = [list(dict.fromkeys(row.at[i] for row in rows)) for i in (0, 1)]
        height = 90.0 + 26 * min(len(marks[1]), 20)
        if len(marks[0]) * len(marks[1]) == len(rows):
            svg = draw(name, alt, lambda axes: charts.swept_map(axes, marks, cells, names), height)
            return [Chart(svg, f"{title} over {names[0]} (across) and {names[1]} (up).")]
        if all(x is not None for row in positions for x in row):
            points = [
                (x or 0.0, y or 0.0, row.of(output).value or 0.0)
                for (x, y), row in zip(positions, valued)
            ]
            svg = draw(name, alt, lambda axes: charts.swept_points(axes, points, names), 330.0)
            return [Chart(svg, f"{title} over {names[0]} and {names[1]}: darker is higher.")]
    return []


def _values(rows: Sequence[PointRow], output: str) -> list[float]:
    return [x for row in rows if (x := row.of(output).value) is not None]


def _identifier(text: str) -> str:
    """The letters and digits of a text."""
    return "".join(x if x.isascii() and x.isalnum() else "-" for x in text)


def _exposure(rows: Sequence[Mapping[str, Any]]) -> Section:
    """The mean of every output by day, for the book and for its parts."""
    parts = dict[tuple[str, str, str, str], list[Mapping[str, Any]]]()
    for row in rows:
        key = (row["output"], row["market"], row["unit"], row["by"])
        parts.setdefault(key, []).append(row)
    charts_of = [
        _by_day(f"exposure-{i}", *key, members)
        for i, (key, members) in enumerate(parts.items())
        if any(len(row["days"]) > 1 for row in members)
    ]
    blocks: list[Block] = [*charts_of[:MAX_DRAWN]]
    note = "Means over the paths of the unstressed points; errors are in result.json and exposure/."
    return Section("exposure", "Exposure by day", "Exposure", [*blocks, Text(note, caveat=True)])


def _by_day(
    name: str,
    output: str,
    market: str,
    unit: str,
    column: str,
    rows: Sequence[Mapping[str, Any]],
) -> Chart:
    displayed = rows[: len(COLOURS)]
    days = sorted(
        {day for row in displayed for day in row["days"]}, key=lambda day: (len(day), day)
    )
    dated = all(len(day) == 10 and day[4] == "-" for day in days)
    when = date_numbers(days) if dated else np.arange(1.0, len(days) + 1)
    lines = []
    for row, colour in zip(displayed, COLOURS):
        values = dict(zip(row["days"], row["value"]))
        numbers = np.array([values.get(day, np.nan) for day in days])
        lines.append(charts.Line(row["label"] or "book", numbers, colour))
    title = readable(output) + (f", market {market}" if market else "")
    title += f", by {column}" if column else ""
    paint = charts.lines if dated else charts.trace
    low, high = (number(float(of([x.values for x in lines]))) for of in (np.nanmin, np.nanmax))
    alt = f"{title}, by day, from {low} to {high}"
    svg = draw(name, alt, lambda axes: paint(axes, when, lines, unit))
    more = f"; the first {len(displayed)} of {len(rows):,}" if len(rows) > len(displayed) else ""
    return Chart(svg, f"{title}, daily mean{more}.")


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
    caption = "Derivatives of the book's value with decisions held fixed, summed over contracts"
    folded = "" if len(few) <= MAX_ROWS else "all inputs"
    blocks: list[Block] = [table(few, columns, caption, by_row=True, folded=folded)]
    return Section("deltas", "Derivatives", "Derivatives", blocks)


class LossRow(NamedTuple):
    """A contract that was valued with its own policy and with the policy of a similar contract."""

    leader: str
    case: str
    value: float
    loss: WithError


def _shared(policies: Sequence[Mapping[str, Any]]) -> Section:
    rows, texts = list[LossRow](), list[str]()
    for shared in policies:
        leader, verb = shared["leader"], "take" if shared["is_shared"] else "do not take"
        count = f"{shared['contracts']:,} in all"
        texts.append(f"The contracts similar to {leader} ({count}) {verb} its trained policy.")
        for x in shared["losses"]:
            loss = WithError(x["loss"], x["loss_error"])
            rows.append(LossRow(leader, x["case"], x["value"], loss))
    columns = [
        Column("Policy of", "leader"),
        Column("Tested on", "case"),
        Column("Value with its own policy", "value"),
        Column("Loss with the shared policy", "loss", sign=True),
    ]
    caption = "One policy for similar contracts: the loss on common paths; at most 0.5 % is allowed"
    blocks: list[Block] = [*map(Text, texts)]
    if rows:
        blocks.append(table(rows, columns, caption, by_row=True))
    return Section("policies", "Policies of similar contracts", "Policies", blocks)


def _failures(result: Mapping[str, Any]) -> Section:
    rows = [(x["case"], x["stress"], x["status"], x["note"]) for x in result["failures"][:200]]
    head = [("Contract", ""), ("Stress", ""), ("Status", ""), ("Reason", "")]
    blocks = [Table(head, rows, "Points without a value", texts=4)]
    return Section("failures", "Failures", "Failures", blocks)


def _cost(result: Mapping[str, Any]) -> Section:
    jobs = result["orders"]
    facts = [
        ("jobs computed", number(jobs["computed"], 0), f"{jobs['reused']:,} others reused"),
        ("wall time", seconds(result["seconds"]["total"]), counted(result["workers"], "worker")),
        ("processor time", seconds(result["cpu_seconds"]), "of all jobs, including reused ones"),
        ("largest worker", f"{result['peak_mb']:,.0f} MB", counted(result["shapes"], "shape")),
    ]
    return Section("cost", "Cost", "Cost", [Facts(facts)])
