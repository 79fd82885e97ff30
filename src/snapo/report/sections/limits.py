"""Limits on averages and probabilities: whether each is met, and what a unit more is worth."""

from typing import Any

from ..folder import Folder
from ..page import Mark, Section, Table, Text
from ..quantity import NONE, SPACE, decimals, finite, measured, number

CAVEAT = (
    "Met nearly: missed by less than the half width of the interval, or by a thousandth of one "
    "path's deviation. One more of the level is worth its shadow price to the objective, from "
    "derivatives by the policy on fresh paths; a limit with room has none. Sensitivities are "
    "those of the best value within the limits."
)


def limits(run: Folder) -> Section:
    """A row for each limit; a section without blocks, which no page shows, where there is none."""
    found = run.result.get("limits") or []
    title, short = "Limits on averages", "Limits"
    if not found:
        return Section("limits", title, short, [])
    head = [
        ("Limit", ""), ("", ""), ("Level", ""), ("Value", ""), ("95 %", ""),
        ("One more of the level", run.unit), ("", ""),
    ]  # fmt: skip
    caption = "Limits on fresh paths of the exact simulator, with their shadow prices"
    table = Table(head, [_row(each) for each in found], caption, 2)
    return Section("limits", title, short, [table, Text(CAVEAT, caveat=True)])


def _row(each: dict[str, Any]) -> tuple[Any, ...]:
    met, low, high = str(each.get("met", "")), finite(each.get("low")), finite(each.get("high"))
    width = (high - low) / 2 if low is not None and high is not None else 0.0
    places = max(0, decimals([width], 2)) if width else None
    price, error = finite(each.get("price")), finite(each.get("price_error"))
    if price or error:
        worth = measured(price, error, max(0, decimals([error], 2)) if error else 4)
    else:
        worth = (NONE, "")
    return (
        str(each.get("name", "")),
        Mark(met != "not met", met),
        number(each.get("level")),
        number(each.get("value"), places),
        f"{number(low, places)}{SPACE}to{SPACE}{number(high, places)}",
        *worth,
    )
