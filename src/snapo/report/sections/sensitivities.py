"""What every input is worth: a tornado of usual moves, and every derivative with its error."""

from typing import Any

from ..bands import Swing, tornado
from ..charts import BLOCK_INTERVAL
from ..drawing import draw
from ..folder import Folder, Sensitivity
from ..page import Block, Chart, Missing, Section, Table, Text
from ..quantity import (
    SPACE,
    decimals,
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
    "To first order. Held: the exact simulator with the decisions held, the derivative of the "
    "optimal value where decisions are optimal, see the whole state and cause no jump. Smooth: "
    "through the policy's reaction in the smooth simulator. Tried: the change of the exact value, "
    "policy reacting, when all numbers of the input are moved by a hundredth on the same paths, "
    "scaled to the move of the row; more and less apart where they differ. Believed: the held one, "
    "unless the move makes the smooth one far likelier; not known where neither lies within three "
    "standard errors of it, at a kink of anything between more and less. "
    "Drift: by how much the held one changed in the second half of training."
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
            BLOCK_INTERVAL * (finite(each.get("standard_error")) or 0.0),
        )
        for each in shown
    ]
    alt = "Bars. " + "; ".join(f"{each.name}: {each.text}" for each in swings) + "."
    height = 32 + 26 * len(swings)
    svg = draw("tornado", alt, lambda axes: tornado(axes, swings, ""), height)
    caption = (
        "Change of the value when all numbers of an input move up by the amount beside it, by the "
        "derivative that is believed; whiskers are 95 % intervals."
    )
    return Chart(svg, caption)


def _moves(run: Folder, moves: list[dict[str, Any]]) -> Table:
    places = decimals([each["effect"] for each in moves], 4)
    rows = [
        (
            words(each["input"]),
            each.get("words") or "",
            amount(each),
            *_with_error(each, "held", places),
            *_with_error(each, "smooth", places),
            *_tried(each, places),
            each.get("believed") or "",
        )
        for each in moves
    ]
    head = [("Input", ""), ("Meaning", ""), ("Moved by", ""), ("Held", run.unit), ("", ""),
            ("Smooth", run.unit), ("", ""), ("Tried", run.unit), ("", ""),
            ("Believed", "")]  # fmt: skip
    return Table(head, rows, "Change of the value for a move of an input", frozenset({0, 1, 2, 9}))


def _with_error(each: dict[str, Any], name: str, places: int) -> tuple[str, str]:
    return measured(each.get(name), each.get(f"{name}_error"), places)


def _tried(each: dict[str, Any], places: int) -> tuple[str, str]:
    """The change at a move, and its error; of more and of less apart, where they differ."""
    more, less = each.get("more"), each.get("less")
    if more is None or less is None:
        return _with_error(each, "tried", places)
    text = f"{number(more, places)} more, {number(less, places)} less"
    return text, plus_minus(each.get("tried_error"), places)


def _table(run: Folder) -> Table:
    rows = [_line(run, each) for each in run.sensitivities[:ROWS]]
    head = [("Input", ""), ("", ""), ("Per", ""), ("Held", run.unit), ("", ""),
            ("Smooth", run.unit), ("", ""), ("Drift", run.unit), ("Believed", "")]  # fmt: skip
    count = len(run.sensitivities)
    caption = "Derivative of the value by every number, per one unit of it"
    if count > ROWS:
        caption += f"; the first {ROWS} of {count}, all are in sensitivities.csv"
    texts = frozenset({0, 1, 2, 8})
    return Table(head, rows, caption, texts, folded=f"All {count} derivatives")


def _one(unit: str, amount: float) -> str:
    """The unit of an amount: "point" of one, "points" of others."""
    return unit.removesuffix("s") if amount == 1 and unit == "points" else unit


def _per(unit: str) -> str:
    """One of a unit: "1 kg", "1 per week"."""
    if not unit or unit == "1":
        return "1"
    words = unit_words(unit)
    return f"1{SPACE}per{SPACE}{words[2:]}" if words.startswith("1/") else f"1{SPACE}{words}"


def _line(run: Folder, each: Sensitivity) -> tuple[str, ...]:
    numbers = [each.value, each.smooth]
    places = min(9, decimals(numbers, 4))
    return (
        words(each.input), each.label, _per(each.unit),
        *measured(each.value, each.standard_error, places),
        *measured(each.smooth, each.smooth_error, places),
        rough(each.moved), each.believed,
    )  # fmt: skip
