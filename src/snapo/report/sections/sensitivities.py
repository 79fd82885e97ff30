"""What every input is worth: a tornado of usual moves, and every derivative with its error."""

from typing import Any

from ..bands import Swing, tornado
from ..drawing import draw
from ..folder import Folder, Sensitivity
from ..page import Block, Chart, Missing, Section, Table, Text
from ..quantity import (
    SPACE,
    decimals,
    derivative_unit,
    finite,
    measured,
    number,
    percent,
    plus_minus,
    quantity,
    rough,
    unit_words,
)
from .distribution import words
from .lacking import lacking

LONGEST = 15  # bars of the tornado
ROWS = 400  # derivatives in the table; all stand in sensitivities.csv
CAVEAT = (
    "To first order. The derivative is that of the best policy's value. Held: the exact simulator "
    "with the decisions held, which is that derivative where decisions are optimal, see the whole "
    "state and cause no jump. Through the policy: a bump of the exact simulator by one percent, "
    "with the policy reacting, where it refutes the held one (at a level of 1 % for all inputs "
    "together). Range: at a kink, between the derivatives for less and for more of the input. The "
    "95 % interval adds two parts: the sampling error of finitely many paths, and the error of the "
    "policy, which is near the best one. "
    "Drift: by how much the held derivative changed in the second half of training."
)


def sensitivities(run: Folder) -> Section:
    """The tornado with its table, and the derivative by every number of every input."""
    title, short = "Sensitivities", "Sensitivities"
    if not run.sensitivities:
        return Section("sensitivities", title, short, [lacking(run, "training")])
    moves = [each for each in run.get("moves", []) if finite(each.get("effect")) is not None]
    blocks: list[Block] = [_tornado(run, moves), _moves(run, moves)] if moves else []
    blocks = blocks or [lacking(run, "moves")]
    return Section("sensitivities", title, short, [*blocks, _table(run), Text(CAVEAT, caveat=True)])


def amount(each: dict[str, Any]) -> str:
    """By how much an input moves, in words."""
    known = finite(each.get("amount"))
    if known is not None:
        return f"+{quantity(known, _one(each.get('unit', ''), known))}"
    return f"+{percent(each.get('share', 0.01), 0)}"


def _tornado(run: Folder, moves: list[dict[str, Any]]) -> Chart | Missing:
    shown = moves[:LONGEST]
    places = decimals([each["effect"] for each in shown], 4)
    swings = [
        Swing(
            f"{words(each['input'])} {amount(each)}",
            float(each["effect"]),
            f"{number(each['effect'], places, sign=True)}{SPACE}{run.unit}".rstrip(SPACE),
            half_width(each),
        )
        for each in shown
    ]
    alt = "Bars. " + "; ".join(f"{each.name}: {each.text}" for each in swings) + "."
    height = 32 + 26 * len(swings)
    svg = draw("tornado", alt, lambda axes: tornado(axes, swings, ""), height)
    caption = (
        "Change of the value when all numbers of an input move up by the amount at the left, with "
        "the reported derivative; whiskers are 95 % intervals."
    )
    return Chart(svg, caption)


def half_width(row: dict[str, Any]) -> float:
    """Half the width of a row's interval; 0 where it has none."""
    low, high = finite(row.get("low")), finite(row.get("high"))
    return 0.0 if low is None or high is None else (high - low) / 2


def _moves(run: Folder, moves: list[dict[str, Any]]) -> Table:
    places = decimals([row["effect"] for row in moves], 4)
    rows = [
        (
            words(row["input"]),
            row.get("words") or "",
            amount(row),
            *(number(row.get(name), places) for name in ("effect", "low", "high")),
            *(rough(row.get(name)) for name in ("sampling", "policy")),
            str(row.get("source") or ""),
            *_bump(row, places),
        )
        for row in moves
    ]
    head = [("Input", ""), ("Meaning", ""), ("Moved by", ""), ("Change", run.unit),
            ("95 % low", run.unit), ("high", run.unit), ("of it sampling", run.unit),
            ("policy", run.unit), ("Source", ""), ("Bump", run.unit), ("", "")]  # fmt: skip
    return Table(head, rows, "Change of the value for a move of an input", frozenset({0, 1, 2, 8}))


def _bump(row: dict[str, Any], places: int) -> tuple[str, str]:
    """The change at a bump, and its error; of more and of less apart, where they differ."""
    more, less = row.get("more"), row.get("less")
    if more is None or less is None:
        return measured(row.get("bump"), row.get("bump_error"), places)
    text = f"{number(more, places)} more, {number(less, places)} less"
    return text, plus_minus(row.get("bump_error"), places)


def _table(run: Folder) -> Table:
    rows = [_line(row, run.unit) for row in run.sensitivities[:ROWS]]
    head = [("Input", ""), ("", ""), ("Derivative", ""), ("95 % low", ""), ("high", ""),
            ("Unit", ""), ("Source", ""), ("Held", ""), ("", ""), ("Smooth", ""), ("", ""),
            ("Drift", ""), ("", "")]  # fmt: skip
    count = len(run.sensitivities)
    caption = "Derivative of the value with respect to every number, per one unit of it"
    if count > ROWS:
        caption += f"; the first {ROWS} of {count}, all are in sensitivities.csv"
    texts = frozenset({0, 1, 5, 6})
    return Table(head, rows, caption, texts, folded=f"All {count} derivatives")


def _one(unit: str, amount: float) -> str:
    """The unit of an amount: "point" of one, "points" of others."""
    return unit.removesuffix("s") if amount == 1 and unit == "points" else unit


def _line(row: Sensitivity, value_unit: str) -> tuple[str, ...]:
    places = min(9, decimals([row.value, row.held, row.smooth], 4))
    return (
        words(row.input), row.label, *(number(x, places) for x in (row.value, row.low, row.high)),
        unit_words(derivative_unit(value_unit, row.unit)), row.source,
        *measured(row.held, row.held_error, places),
        *measured(row.smooth, row.smooth_error, places),
        rough(row.moved), plus_minus(row.moved_error, places),
    )  # fmt: skip
