"""The trained rule beside the classical ones, and beside other lead times."""

from snapo.report.folder import Folder
from snapo.report.page import Block, Missing, Section, Table, Text
from snapo.report.quantity import decimals, finite, number, percent, plus_minus
from snapo.report.sections.lacking import lacking


def rivals(run: Folder) -> Section:
    """Costs of all rules on the same paths."""
    title, short = "Classical rules on the same paths", "Rivals"
    rows = run.get("rivals", [])
    if not rows:
        return Section("rivals", title, short, [lacking(run, "rivals")])
    errors = [row.get("difference_error") for row in rows]
    known = [decimals([each], 2) for each in errors if finite(each)]
    places = min(6, max([2, *known]))
    first = float(rows[0]["value"]) or 1.0
    cells = []
    for row in rows:
        gap = finite(row.get("difference"))
        numbers = row.get("numbers") or {}
        cells.append(
            (
                str(row["rule"])[:1].upper() + str(row["rule"])[1:],
                ", ".join(f"{name} {number(value, 1)}" for name, value in numbers.items()),
                number(-float(row["value"]), places),
                plus_minus(row.get("standard_error"), places),
                number(None if gap is None else -gap, places, sign=True),
                plus_minus(row.get("difference_error"), places),
                "" if gap is None else percent(gap / first, 2),
            )
        )
    head = [("Rule", ""), ("Numbers", ""), ("Cost", run.unit), ("", ""), ("Dearer by", run.unit),
            ("", ""), ("", "")]  # fmt: skip
    words = (
        "Each rule has the best numbers that a search on other paths found; differences are "
        "paired, path by path, with one standard error."
    )
    table = Table(head, cells, "Costs of the rules", 2, strong=frozenset([0]))
    return Section("rivals", title, short, [table, Text(words, caveat=True)])


def lead_time(run: Folder) -> Section:
    """The cost of a period more or less of lead time."""
    title, short = "A period more or less of lead time", "Lead time"
    rows = run.get("lead_time_change", [])
    if not run.get("other_leads", True):
        words = "This run trains no other lead times: `lead_time = true` in [report] does."
        return Section("lead-time", title, short, [Missing(words)])
    if not rows:
        return Section("lead-time", title, short, [lacking(run, "lead time")])
    step = str(run.get("step", "period"))
    places = max(decimals([row["standard_error"] for row in rows], 2), 2)
    by_place = any(row.get("place") for row in rows)
    cells = [
        (
            *([str(row["place"])] if by_place else []),
            f"{row['lead']} {step}s",
            number(-float(row["change"]), places, sign=True),
            plus_minus(row["standard_error"], places),
        )
        for row in rows
    ]
    head = [("Lead time", ""), ("Cost, change", run.unit), ("", "")]
    head = [("Place", ""), *head] if by_place else head
    words = "The rule is trained anew for each, and compared on the same paths."
    blocks: list[Block] = [
        Table(head, cells, "Other lead times", len(head) - 2),
        Text(words, caveat=True),
    ]
    return Section("lead-time", title, short, blocks)
