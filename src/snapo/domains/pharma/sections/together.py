"""Parameters that move together: where the design space ends, and pairs of proven ranges."""

from typing import Any

import numpy as np

from snapo.report.page import Block, Mark, Missing, Section, Table, Text
from snapo.report.quantity import finite, number, percent, quantity, with_unit

from .model import place
from .run import Run

FILE = "design_space_boundary.csv"
SHOWN = 15  # pairs in the report, those with the least room first


def boundary(run: Run, found: dict[str, Any]) -> list[Block]:
    """The ends of the space along the lines of the map that are nearest to the set point."""
    ends = found.get("ends")
    if ends is None:
        return []
    near = [
        int(np.abs(np.asarray(grid) - here).argmin())
        for grid, here in zip(found["grid"], found["nominal"])
    ]
    names, _ = run.names
    rows = [
        _end(found, end, near, names)
        for end in ends
        if all(i in (-1, k) for i, k in zip(end["at"], near))
    ]
    required = number(found["required"])
    if not rows:
        words = (
            f"On the lines of the map next to the set point the probability crosses {required} "
            "nowhere: there the space does not end within the studied ranges, or does not begin."
        )
        return [Text(words + f" {FILE} has the other lines." * bool(ends))]
    head = [("Along", ""), ("At", ""), ("Ends", ""), ("Limit beyond it", ""), ("Boundary", ""),
            ("95 % interval", "")]  # fmt: skip
    words = (
        f"Where the probability falls below {required} along the lines of the map next to the set "
        "point, with the interval in which that place lies at 95 % for the "
        f"{number(found['samples'], 0)} batches per point (Wilson's interval of the share, "
        "inverted); “beyond” where so many batches do not tell, or the line ends. "
        f"{FILE} has all lines."
    )
    return [Table(head, rows, "Where the design space ends", 4), Text(words, True)]


def _end(found: dict[str, Any], end: dict[str, Any], near: list[int], names: list[str]) -> tuple:
    """One row: an end of the space along a line through the grid point `near` the set point."""
    axis, low, high = end["axis"], "inner", "outer"
    fixed = [
        f"{name} {place(grid[k], unit)}"
        for j, (name, unit, grid, k) in enumerate(
            zip(found["axes"], found["units"], found["grid"], near)
        )
        if j != axis
    ]
    if end["side"] < 0:
        low, high = high, low
    span = [finite(end[low]), finite(end[high])]
    return (
        with_unit(found["axes"][axis], found["units"][axis]),
        ", ".join(fixed),
        "above" if end["side"] > 0 else "below",
        names[end["binding"]],
        place(end["place"]),
        " – ".join("beyond" if each is None else place(each) for each in span),
    )


def together(run: Run) -> Section:
    """Proven ranges of two parameters at once."""
    title, short = "Proven ranges of two parameters at once", "Pairs"
    rows = run.get("pairs")
    if not rows:
        text = f"Pairs of proven ranges: none, since {run.why_not('pairs of ranges', 'ranges')}."
        return Section("pairs", title, short, [Missing(text)])
    names, _ = run.names
    units = {each["name"]: each["unit"] for each in run.attributes}
    order = sorted(rows, key=lambda each: (_least(each), -(finite(each["used"]) or 0.0)))
    body = []
    for each in order[:SHOWN]:
        most = each["most"]
        effect = "–"
        if most >= 0:
            size = quantity(each["interaction"][most], units[names[most]])
            effect = f"{names[most]} {size}, {percent(each['used'])} of its room"
            effect = effect if each["interaction"][most] else "none"
        body.append(
            (
                " and ".join(each["names"]),
                _share(each["nominal"]),
                _where(each, "nominal", names),
                _share(each["probable"]),
                _sure(each["probable"]),
                Mark(each["holds_normal"], "keep" if each["holds_normal"] else "break"),
                effect,
            )
        )
    head = [("Parameters", ""), ("Share of both, nominal model", ""), ("First corner", ""),
            ("With the required probability", ""), ("sure – possible at 95 %", ""),
            ("Corners of normal ranges", ""), ("Interaction", "")]  # fmt: skip
    caption = (
        "A proven range holds with all other parameters at their set point. Here both move, "
        "from the set point to each of the four corners of their proven ranges: up to this share "
        "of both ranges no corner breaks a limit (100 %: the ranges may be used together). "
        "Interaction: half of the difference that one parameter makes to the effect of the other, "
        "between the ends of the normal ranges, of the attribute whose room it uses most."
    )
    if len(rows) > SHOWN:
        caption += f" The {SHOWN} pairs with the least room of {len(rows)}."
    texts = frozenset({0, 2, 5, 6})
    return Section("pairs", title, short, [Table(head, body, caption, texts)])


def _least(each: dict[str, Any]) -> float:
    return min(
        found["share"] for found in (each["nominal"], each["probable"], {"share": 2.0}) if found
    )


def _share(found: dict[str, Any] | None) -> str:
    return "–" if found is None else percent(found["share"], 0)


def _sure(found: dict[str, Any] | None) -> str:
    if found is None:
        return "–"
    return f"{percent(found['sure'], 0)} – {percent(found['possible'], 0)}"


def _where(each: dict[str, Any], which: str, names: list[str]) -> str:
    found = each[which]
    if found is None or found["fails"] < 0:
        return "–"
    sides = [
        f"{name} {'high' if side > 0 else 'low'}"
        for name, side in zip(each["names"], found["corner"])
    ]
    return f"{', '.join(sides)}: {names[found['fails']]}"
