"""Sensitivities: the effect of every input's standard move, and all derivatives with their
errors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from snapo.problem.inputs import Input
from snapo.report.bands import Swing, tornado
from snapo.report.drawing import draw
from snapo.report.folder import RunFiles, Sensitivity
from snapo.report.missing import why_missing
from snapo.report.page import Block, Chart, Section, Table, Text
from snapo.report.quantity import (
    SPACE,
    decimals,
    derivative_unit,
    measured,
    number,
    percent,
    plus_minus,
    quantity,
    readable,
    rough,
    unit_words,
)
from snapo.solver.derivatives.interval import Verdict, one_percent, source_text
from snapo.solver.derivatives.table import Sensitivities
from snapo.solver.statistics import Estimate

from ..chapter import Chapter
from ..study import StudyRun

SHARE = 0.01  # of every number of an input that does not specify its `move`
LONGEST = 15  # bars of the tornado
ROWS = 400  # derivatives in the table; sensitivities.csv has all of them
CAVEAT = (
    "These derivatives are those of the value of the best policy. Held: the derivative of the "
    "exact simulator with the decisions held fixed; this is correct if decisions are optimal, "
    "depend on the full state and cause no jump. Through the policy: the difference quotient of "
    "the exact simulator for a bump of one percent, or of the step of the input, to which the "
    "policy reacts; it is reported if it contradicts the derivative with decisions held fixed (at "
    "a level of 1 % for all inputs together). Range: at a kink, the interval between the "
    "derivatives for a decrease and for an increase of the input. The 95 % interval adds the "
    "sampling error of finitely many paths (± sampling) and the error of a policy that is only "
    "near the best one (± policy). Late change: the change of the derivative with decisions held "
    "fixed in the second half of training."
)


class ReportedInterval:
    """The interval of a record with `low` and `high`; both are None if it is unknown."""

    low: float | None
    high: float | None

    @property
    def half_width(self) -> float:
        """Half the width of the interval; 0 if there is no interval."""
        return 0.0 if self.low is None or self.high is None else (self.high - self.low) / 2


@dataclass(frozen=True)
class InputMove(ReportedInterval):
    """The effect on the value when all numbers of an input move together; None if unknown.

    - `words`, `group`: meaning and group of the input; `numbers`: its number of entries.
    - `amount`, `unit`: the move of every number, in the display unit; `amount` is None if every
      number moves by its share `share`.
    - `effect`, `low`, `high`: the effect to first order, with the reported derivative and its 95 %
      interval, `sampling` and `policy`: the parts of the half-width due to the finite number of
      paths and to the policy's error; `source`: see `solver.derivatives.interval.Reported`.
    - `held`, `held_error`: the effect with the decisions held fixed, and its error; `smooth`,
      `smooth_error`: the effect through the policy's reaction; `bump`, `bump_error`: the change of
      the exact value at a bump, scaled to the size of this move, if it is along the same direction;
      `more`, `less`: the effects of the move and of the opposite move, if they differ.
    """

    input: str
    words: str = ""
    group: str = ""
    numbers: int = 1
    amount: float | None = None
    share: float | None = None
    unit: str = ""
    effect: float | None = None
    low: float | None = None
    high: float | None = None
    sampling: float | None = None
    policy: float | None = None
    source: str | None = None
    held: float | None = None
    smooth: float | None = None
    bump: float | None = None
    held_error: float | None = None
    smooth_error: float | None = None
    bump_error: float | None = None
    more: float | None = None
    less: float | None = None

    @property
    def size(self) -> str:
        """The size of the move, as text."""
        if self.amount is None:
            return f"+{percent(0.01 if self.share is None else self.share, 0)}"
        if self.unit.startswith("1/"):
            return f"+{number(self.amount)} per {unit_words(self.unit[2:])}"
        single = self.amount == 1 and self.unit == "points"
        unit = "" if self.unit == "1" else "point" if single else self.unit
        return f"+{quantity(self.amount, unit)}"


@dataclass(frozen=True)
class InputMoves:
    """The moves of all inputs, with the largest effects first."""

    moves: tuple[InputMove, ...]


def measure(run: StudyRun) -> InputMoves:
    """The moves of the inputs that have sensitivities in the solution."""
    table = run.solution.sensitivities
    if table is None:
        return InputMoves(())
    moves = [_move(name, entry, table) for name, entry in table.inputs.items()]
    return InputMoves(tuple(sorted(moves, key=lambda move: -abs(move.effect or 0.0))))


def direction(entry: Input) -> np.ndarray:
    """The move of every number of an input, in its shape."""
    if entry.move is None:
        return SHARE * entry.value
    return np.full(entry.value.shape, entry.move)


def interval(table: Sensitivities, name: str, along: np.ndarray) -> dict[str, float | None]:
    """The reported derivative along a direction, as numbers for a table; None if it is unknown."""
    names = ("effect", "low", "high", "sampling", "policy")
    numbers = table.along(name, along)
    return {key: float(x) if np.isfinite(x) else None for key, x in zip(names, numbers)}


def _move(name: str, entry: Input, table: Sensitivities) -> InputMove:
    along = direction(entry)
    bump = _bump(entry, table.verdicts, name, along)
    sides = (bump.up, bump.down) if bump and bump.two_sided else (None, None)
    held, held_error = table.held[name].along(along)
    smooth, smooth_error = _along(table.smooth, name, along)
    observed, seen_error = bump.bump if bump else (None, None)
    return InputMove(
        name,
        entry.meaning,
        entry.group,
        entry.value.size,
        None if entry.move is None else entry.move * entry.display_factor,
        SHARE if entry.move is None else None,
        entry.display_unit or entry.unit,
        **interval(table, name, along),
        source=table.source(name),
        held=held,
        held_error=held_error,
        smooth=smooth,
        smooth_error=smooth_error,
        bump=observed,
        bump_error=seen_error,
        more=sides[0],
        less=sides[1],
    )


def _bump(
    entry: Input, verdicts: Mapping[str, Verdict] | None, name: str, along: np.ndarray
) -> Verdict | None:
    """The effect of the bump, scaled to this move, if it has the same or the opposite direction."""
    verdict = (verdicts or {}).get(name)
    if verdict is None:
        return None
    by = one_percent(entry)
    times = float(np.sum(along * by) / np.sum(by * by))
    if not np.allclose(along, times * by):
        return None
    up, down = (verdict.up, verdict.down) if times > 0 else (verdict.down, verdict.up)
    value, error = verdict.bump
    scaled = {"up": times * up, "down": times * down, "side_error": abs(times) * verdict.side_error}
    return verdict._replace(bump=(times * value, abs(times) * error), **scaled)


def _along(
    table: Mapping[str, Estimate] | None, name: str, along: np.ndarray
) -> tuple[float | None, float | None]:
    return (None, None) if table is None else table[name].along(along)


def sensitivities(run: RunFiles) -> Section:
    """The tornado chart with its table, and the derivative with respect to every number."""
    title = "Sensitivities"
    if not run.sensitivities:
        return Section("sensitivities", title, title, [why_missing(run, "training")])
    result = MOVES.of(run)
    blocks = [] if result is None else show(run, result)
    blocks = blocks or [why_missing(run, "moves")]
    caveat = Text(CAVEAT, caveat=True)
    return Section("sensitivities", title, title, [*blocks, _derivatives(run), caveat])


def show(run: RunFiles, result: InputMoves) -> Sequence[Block]:
    """Shows the tornado chart and the table of moves; nothing if no effect is known."""
    moves = [move for move in result.moves if move.effect is not None]
    return [_tornado(run, moves), _moves(run, moves)] if moves else []


def _tornado(run: RunFiles, moves: Sequence[InputMove]) -> Chart:
    drawn = moves[:LONGEST]
    digits = decimals([move.effect for move in drawn], 4)
    swings = [
        Swing(
            f"{readable(move.input)} {move.size}",
            float(move.effect or 0.0),
            f"{number(move.effect, digits, sign=True)}{SPACE}{run.unit}".rstrip(SPACE),
            move.half_width,
        )
        for move in drawn
    ]
    alt = "Bars. " + "; ".join(f"{swing.name}: {swing.text}" for swing in swings) + "."
    height = 32 + 26 * len(swings)
    svg = draw("tornado", alt, lambda axes: tornado(axes, swings, ""), height)
    caption = (
        "Change of the value if all numbers of an input increase by the amount at the left, "
        "computed with the reported derivative; whiskers are 95 % intervals."
    )
    return Chart(svg, caption)


def _moves(run: RunFiles, moves: Sequence[InputMove]) -> Table:
    digits = decimals([move.effect for move in moves], 4)
    rows = [
        (
            readable(move.input),
            move.words,
            move.size,
            *(number(x, digits) for x in (move.effect, move.low, move.high)),
            *(rough(x) for x in (move.sampling, move.policy)),
            source_text(move.source),
            *_at_bump(move, digits),
        )
        for move in moves
    ]
    head = [("Input", ""), ("Meaning", ""), ("Moved by", ""), ("Change", run.unit),
            ("95 % low", run.unit), ("95 % high", run.unit), ("± sampling", run.unit),
            ("± policy", run.unit), ("Source", ""), ("At a bump", run.unit), ("", "")]  # fmt: skip
    return Table(head, rows, "Change of the value for a move of an input", frozenset({0, 1, 2, 8}))


def _at_bump(move: InputMove, digits: int) -> tuple[str, str]:
    """The change at a bump, and its error; the changes at an increase and a decrease separately, if
    they differ."""
    if move.more is None or move.less is None:
        return measured(move.bump, move.bump_error, digits)
    text = f"{number(move.more, digits)} more, {number(move.less, digits)} less"
    return text, plus_minus(move.bump_error, digits)


def _derivatives(run: RunFiles) -> Table:
    rows = [_line(row, run.unit) for row in run.sensitivities[:ROWS]]
    head = [("Input", ""), ("Number", ""), ("Derivative", ""), ("95 % low", ""), ("95 % high", ""),
            ("Unit", ""), ("Source", ""), ("Decisions held fixed", ""), ("", ""),
            ("Through the smooth rules", ""), ("", ""), ("Late change", ""), ("", "")]  # fmt: skip
    count = len(run.sensitivities)
    caption = "Derivative of the value with respect to every number, per unit of this number"
    if count > ROWS:
        caption += f"; the first {ROWS} of {count}, all of which are in sensitivities.csv"
    texts = frozenset({0, 1, 5, 6})
    return Table(head, rows, caption, texts, folded=f"All {count} derivatives")


def _line(row: Sensitivity, value_unit: str) -> tuple[str, ...]:
    digits = min(9, decimals([row.value, row.held, row.smooth], 4))
    return (
        readable(row.input), row.label,
        *(number(x, digits) for x in (row.value, row.low, row.high)),
        unit_words(derivative_unit(value_unit, row.unit)), source_text(row.source),
        *measured(row.held, row.held_error, digits),
        *measured(row.smooth, row.smooth_error, digits),
        rough(row.moved), plus_minus(row.moved_error, digits),
    )  # fmt: skip


MOVES = Chapter("moves", "Sensitivities", InputMoves, measure, show)
