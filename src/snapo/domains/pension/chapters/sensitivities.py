"""Sensitivities: derivatives as effects of the moves that an actuary makes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.inputs import Input, plain
from snapo.report.bands import Swing, tornado
from snapo.report.drawing import draw
from snapo.report.missing import why_missing
from snapo.report.page import Block, Chart, Table, Text
from snapo.report.quantity import SPACE, decimals, number, plus_minus_half, rough
from snapo.solver.derivatives.interval import source_text
from snapo.solver.derivatives.table import Sensitivities
from snapo.solver.solution import Solution
from snapo.study.chapter import Chapter
from snapo.study.chapters.sensitivities import SHARE, ReportedInterval, direction, interval
from snapo.study.study import Setup, StudyRun

from ..people.longer_life import longer_life
from ..results.setup import case_in
from ..run import PensionRun, name_of, with_measure
from .objective import equivalent

CURVE = "curve"  # the group of inputs that are nodes of a curve
LIFE = (
    "all death rates of a sex fall in proportion until its life expectancy at 65 is a year "
    "longer; to first order"
)
HELD = (
    "“Decisions held fixed”: every path keeps its trades; at an optimum this is, to first order, "
    "also the effect with a re-optimised policy. “Through the policy”: the effect of a bump with "
    "the exact rules, which is reported if it contradicts the effect with decisions held fixed. "
    "The 95 % interval adds the sampling error and the error of the policy. “Policy reacting”: "
    "the trained policy observes the moved fund and decides again, without new training. The "
    "effects with decisions held fixed and with the policy reacting differ only by the error of "
    "training and smoothing. Prices of risk, excess returns and today's market values are held "
    "fixed while the curve moves."
)
TOP = 14  # bars of the tornado
ROWS = 400  # single numbers in the report; sensitivities.csv has all of them
TEXTS = frozenset({0, 1, 5})  # columns of text in the tables of single numbers


class StandardMove(NamedTuple):
    """The standard move of each number of an input [n], and its description."""

    size: np.ndarray
    words: str


def standard_move(entry: Input) -> StandardMove:
    """The standard move of an input's numbers; rises are positive."""
    size = direction(entry).ravel()
    if entry.move is not None:
        return StandardMove(
            size, f"{entry.move * entry.display_factor:g} {entry.display_unit}".strip()
        )
    if not size.any():
        # There is no per cent of nothing.
        return StandardMove(np.ones(size.size), "1 unit")
    return StandardMove(size, f"{100 * SHARE:g} % (relative)")


@dataclass(frozen=True)
class MoveEffect(ReportedInterval):
    """The effect of a standard move on the objective; None if it is not known.

    - `effect`, `low`, `high`, `sampling`, `policy`, `source`: those of the reported derivative, as
      in `study.chapters.sensitivities.InputMove`.
    - `held`, `standard_error`: the effect with the decisions held fixed, and its error; `reacting`:
      the effect with the trained policy's reaction.
    """

    input: str = ""
    move: str = ""
    group: str = ""
    effect: float | None = None
    low: float | None = None
    high: float | None = None
    sampling: float | None = None
    policy: float | None = None
    source: str | None = None
    held: float | None = None
    standard_error: float | None = None
    reacting: float | None = None


@dataclass(frozen=True)
class InputEffect(MoveEffect):
    """All `count` numbers of an input moved together; `words`: its meaning."""

    count: int = 1
    words: str = ""


@dataclass(frozen=True)
class NumberEffect(MoveEffect):
    """A single number of an input."""

    label: str = ""


@dataclass(frozen=True)
class MoveEffects:
    """The effects of the standard moves.

    - `unit`: "ratio" if they refer to the certainty equivalent (`objective.equivalent`), else
      "objective".
    - `families`: the effects of moving all numbers of an input; `rows`: those of moving single
      numbers; `combined`: those of other joint moves, such as a year of life.
    """

    unit: str = ""
    families: tuple[InputEffect, ...] = ()
    combined: tuple[InputEffect, ...] = ()
    rows: tuple[NumberEffect, ...] = ()


def measure(run: StudyRun) -> MoveEffects:
    """The effects on the objective of the run."""
    return effects(run.setup, run.solution)


def effects(setup: Setup, solution: Solution) -> MoveEffects:
    """Effects of the standard moves on the objective: of single numbers, and of all numbers of an
    input together."""
    problem, table = setup.problem, solution.sensitivities
    if table is None:
        return MoveEffects()
    certain = equivalent(problem.objective, solution.value)
    slope = 1.0 if certain is None else certain.slope
    families, rows, combined = [], [], []
    for name, entry in table.inputs.items():
        usual = standard_move(entry)
        effect = _along(table, name, usual.size, slope)
        effect |= {"count": entry.value.size, "words": entry.meaning}
        families.append(InputEffect(name, usual.words, entry.group, **effect))
        for i, label in enumerate(entry.names()):
            alone = np.where(np.arange(entry.value.size) == i, usual.size, 0.0)
            effect = _along(table, name, alone, slope)
            rows.append(NumberEffect(name, usual.words, entry.group, **effect, label=label))
    if (life := longer_life(case_in(setup), plain(problem.inputs))) is not None:
        effect = _along(table, life.input, life.change, slope)
        effect |= {"count": len(life.change), "words": LIFE}
        combined.append(InputEffect("year_of_life", "1 year", "people", **effect))
    unit = "objective" if certain is None else "ratio"
    return MoveEffects(unit, tuple(families), tuple(combined), tuple(rows))


def _along(table: Sensitivities, name: str, size: np.ndarray, slope: float) -> dict[str, Any]:
    """The effect of a move [n] of an input's numbers, with its interval."""
    size = size.reshape(table.inputs[name].value.shape)
    derivative = interval(table, name, size)
    entries: dict[str, Any] = {k: None if x is None else slope * x for k, x in derivative.items()}
    held, error = table.held[name].along(size)
    reacting = None if table.smooth is None else slope * table.smooth[name].along(size)[0]
    return entries | {
        "source": table.source(name),
        "held": slope * held,
        "standard_error": slope * error,
        "reacting": reacting,
    }


def show(run: PensionRun, result: MoveEffects) -> Sequence[Block]:
    """The effects of the standard moves: the tornado, the key rates of curves, and all others."""
    if not result.families:
        return [why_missing(run, SENSITIVITIES.name)]
    scale, unit = 1.0, "objective"
    if result.unit == "ratio":
        scale, unit = 1e4, "bp of the certainty equivalent"
    moves = [*result.families, *result.combined]
    blocks: list[Block] = [_tornado(moves, scale, unit), _inputs(moves, scale, unit)]
    curves = dict.fromkeys(row.input for row in result.rows if row.group == CURVE)
    for name in curves:
        local = [row for row in result.rows if row.input == name]
        complete = next(family for family in result.families if family.input == name)
        blocks.append(_nodes(complete, local, scale, unit))
    others = [row for row in result.rows if row.input not in curves]
    if others:
        blocks.append(_others(others, scale, unit))
    return [*blocks, Text(HELD, caveat=True), _definitions(moves)]


def rise(move: Any) -> str:
    """A move of all numbers of an input as text: "Zero rate, all 6: + 1 bp"."""
    count = f", all {move.count}" if move.count > 1 else ""
    return f"{name_of(move.input)}{count}: +{SPACE}{move.move}"


def _tornado(moves: Sequence[InputEffect], scale: float, unit: str) -> Chart:
    order = sorted(moves, key=lambda move: -abs(move.effect or 0.0))[:TOP]
    values = [scale * (move.effect or 0.0) for move in order]
    digits = decimals(values, 3)
    swings = [
        Swing(rise(move), value, number(value, digits, True), scale * move.half_width)
        for move, value in zip(order, values)
    ]
    alt = "Effects of the standard moves. " + "; ".join(f"{s.name}: {s.text}" for s in swings)
    svg = draw("tornado", alt, lambda axes: tornado(axes, swings, unit), 40 + 22 * len(swings))
    caption = (
        "The largest effects, with all numbers of an input moved together; whiskers are 95 % "
        "intervals."
    )
    return Chart(svg, caption)


def _inputs(moves: Sequence[InputEffect], scale: float, unit: str) -> Table:
    rows = []
    for move in moves:
        name, size, *cells = _row(move, name_of(move.input), scale)
        rows.append((name, str(move.count), size.replace(" ", SPACE), *cells))
    head = [("Input", ""), ("Numbers", ""), ("Rise of each", ""), *_columns(unit)]
    caption = "All numbers of an input together; for a curve this is the parallel shift"
    return Table(head, rows, caption, frozenset({0, 2, 6}))


def _row(move: MoveEffect, name: str, scale: float) -> tuple[str, ...]:
    effect, half = move.effect, scale * move.half_width
    # No digit beyond the interval's second one; six of the effect where it is hardly wide.
    digits = decimals([scale * (effect or 0.0)], 6 if half else 4)
    digits = min(decimals([half], 2), digits) if half else digits
    return (
        name,
        move.move,
        number(None if effect is None else scale * effect, digits, True),
        plus_minus_half(None if effect is None else half, digits),
        rough(scale * (move.policy or 0.0)),
        source_text(move.source),
        number(None if move.reacting is None else scale * move.reacting, digits, True),
    )


def _columns(unit: str) -> list[tuple[str, str]]:
    """The headings of the columns of one effect."""
    return [("Effect", unit), ("95 % half-width", unit), ("Part due to the policy", unit),
            ("Derivative", ""), ("Effect with the policy reacting", unit)]  # fmt: skip


def _nodes(
    input_effect: InputEffect, rows: Sequence[NumberEffect], scale: float, unit: str
) -> Table:
    """One line per node, and the `input_effect` input moved at once: the parallel shift, which is
    their sum."""
    name = name_of(input_effect.input)
    body = [_row(row, row.label, scale) for row in rows]
    body.append(_row(input_effect, "Parallel = sum", scale))
    head = [("Node", ""), ("Rise", ""), *_columns(unit)]
    folded = f"{name} by node: {len(rows)} key rates"
    strong = frozenset([len(body) - 1])
    return Table(head, body, f"Key rates: {name}", TEXTS, strong=strong, folded=folded)


def _others(rows: Sequence[NumberEffect], scale: float, unit: str) -> Table:
    body = [_row(row, name_of(row.input, row.label), scale) for row in rows[:ROWS]]
    head = [("Input", ""), ("Rise", ""), *_columns(unit)]
    more = "" if len(rows) <= ROWS else "; the others are in sensitivities.csv"
    folded = f"Each number by itself: {len(rows)} sensitivities{more}"
    return Table(head, body, "Each number by itself", TEXTS, folded=folded)


def _definitions(moves: Sequence[InputEffect]) -> Table:
    rows = [(name_of(move.input), f"+ {move.move}: {move.words}") for move in moves]
    return Table([("Input", ""), ("The move", "")], rows, "Definitions", 2)


TITLE = with_measure("Sensitivities of the objective")
SENSITIVITIES = Chapter("sensitivities", TITLE, MoveEffects, measure, show, key="sensitivities")
