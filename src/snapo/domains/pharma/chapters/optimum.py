"""The best recipe of the nominal model: its decisions, the limits, and the conditions of an
optimum."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from snapo.report.folder import RunFiles
from snapo.report.page import Block, Facts, Mark, Missing, Table, Text
from snapo.report.quantity import (
    decimals,
    finite,
    number,
    percent,
    plus_minus,
    power,
    quantity,
    seconds,
)
from snapo.solver.statistics import proportion
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..given import Entry
from ..quality import batches
from ..quality.batches import AttributeLimits
from ..recipe.optimise import Optimum, optimise
from ..recipe.optimum import TOLERANCE
from ..recipe.records import Optimise, Term
from ..setpoints import HEADER, setpoints
from ..shared import MESH, open_loop, sampled

BATCHES = 1024  # fresh ones, for the probability to keep all limits before and after
FILE = "setpoints_best.csv"


@dataclass(frozen=True)
class GoalTerm:
    """A term of the goal: `weight` times `of`, which is in `unit`."""

    of: str
    unit: str
    weight: float


@dataclass(frozen=True)
class DecisionResult:
    """A number that was chosen, in its `unit`, between `low` and `high`.

    - `slope`: the slope of the goal; `at_low`, `at_high`: the multipliers of its bounds, 0 inside.
    """

    name: str
    unit: str
    start: Number
    value: Number
    low: Number
    high: Number
    slope: Number
    at_low: Number
    at_high: Number


@dataclass(frozen=True)
class LimitResult:
    """A limit of an attribute; `worth`: the gain of the goal per unit by which the limit is
    relaxed."""

    attribute: str
    unit: str
    side: Literal["at least", "at most"]
    limit: Number
    start: Number
    value: Number
    room: Number
    worth: Number


@dataclass(frozen=True)
class RampResult:
    """A piece of a profile: the share of the ramp that is used, and the multiplier of the ramp."""

    piece: str
    most: Number
    unit: str
    used: Number
    worth: Number


@dataclass(frozen=True)
class KeptChance:
    """The probability that a batch meets all limits, and its standard error."""

    probability: Number
    error: Number


@dataclass(frozen=True)
class BestRecipe:
    """The answer to `[optimise]`; `chance`: before and after; `ends`: the goal reached from every
    start."""

    sense: Literal["maximise", "minimise"]
    terms: tuple[GoalTerm, ...]
    per: tuple[GoalTerm, ...]
    unit: str
    reserve: float
    deviations: float
    before: Number
    value: Number
    decisions: tuple[DecisionResult, ...]
    limits: tuple[LimitResult, ...]
    ramps: tuple[RampResult, ...]
    chance: tuple[KeptChance, KeptChance]
    batches: int
    stationarity: Number
    violation: Number
    tolerance: Number
    converged: bool
    message: str
    iterations: int
    evaluations: int
    ends: tuple[Number, ...]
    mode: str
    compiling: Number
    solving: Number


def measure(run: StudyRun) -> BestRecipe:
    """The best recipe, and its setpoints as a separate table if it converged."""
    loop = open_loop(run)
    request = loop.case.optimise
    assert request is not None
    result = best_recipe(run, optimise(loop.process, loop.seed), request)
    if result.converged:
        changed = optimal(request, [decision.value for decision in result.decisions])
        run.write_csv(FILE, HEADER, setpoints(loop.case, changed))
    return result


def optimal(request: Optimise, values: Sequence[float]) -> dict[Entry, float]:
    """The numbers of the best recipe in the domain's units, from those in user units."""
    return {
        (x.input, x.entry): value * x.scale + x.offset
        for x, value in zip(request.decisions, values, strict=True)
    }


def best_recipe(run: StudyRun, optimum: Optimum, request: Optimise) -> BestRecipe:
    """Decisions, limits and ramps with their multipliers, the probability of meeting all limits
    before and after, and how the solution was computed. User units."""
    recipe, conditions = optimum.recipe, optimum.recipe.conditions
    start = np.array([decision.start for decision in request.decisions])
    (first, before), (last, after) = (_at(run, request, x) for x in (start, recipe.x))
    return BestRecipe(
        sense="maximise" if request.sense > 0 else "minimise",
        terms=_terms(request.terms),
        per=_terms(request.per),
        unit=_unit(request),
        reserve=request.reserve,
        deviations=request.deviations,
        before=optimum.before,
        value=recipe.value,
        decisions=tuple(
            DecisionResult(
                d.name, d.unit, *map(d.in_case_unit, (d.start, float(x), d.low, d.high)),
                *(float(slope) * d.scale for slope in slopes),
            )
            for d, x, *slopes in zip(
                request.decisions, recipe.x, recipe.gradient, conditions.low, conditions.high
            )
        ),
        limits=_limit_rows(optimum, first, last),
        ramps=_ramp_rows(optimum),
        chance=(before, after),
        batches=BATCHES,
        stationarity=conditions.stationarity,
        violation=conditions.violation,
        tolerance=TOLERANCE,
        converged=recipe.converged,
        message=recipe.message,
        iterations=recipe.iterations,
        evaluations=recipe.evaluations,
        ends=tuple(optimum.endpoints),
        mode=optimum.mode,
        compiling=optimum.compiling,
        solving=optimum.solving,
    )  # fmt: skip


def _at(run: StudyRun, request: Optimise, x: np.ndarray) -> tuple[np.ndarray, KeptChance]:
    """[Q] nominal attributes, and the probability of meeting all limits with its standard error."""
    process, seed = sampled(run), open_loop(run).seed + 2
    changes: dict[Entry, float] = {(d.input, d.entry): v for d, v in zip(request.decisions, x)}
    rows = batches.drawn(process, changes, BATCHES, seed)
    nominal = np.repeat(batches.nominally(process, changes), batches.CHUNK, 0)
    inputs, entries = batches.inputs_with(process, changes), batches.varied(process.case)
    both = np.concatenate([nominal, rows])
    values = process.batch(entries, both, chunk=batches.CHUNK, inputs=inputs).values
    selected = AttributeLimits.of(process.case).hold(values[batches.CHUNK :]).all(-1)
    share, error = proportion(selected.sum(), BATCHES)
    return values[0], KeptChance(float(share), float(error))


def _limit_rows(optimum: Optimum, start: np.ndarray, after: np.ndarray) -> tuple[LimitResult, ...]:
    """One row for each limit."""
    above = optimum.recipe.conditions.above
    return tuple(
        LimitResult(
            attribute=bound.name, unit=bound.unit, side="at least" if bound.sign > 0 else "at most",
            limit=bound.limit, start=start[bound.which], value=after[bound.which],
            room=bound.sign * (after[bound.which] - bound.limit),
            worth=float(above[i]) / bound.size,
        )
        for i, bound in enumerate(optimum.bounds)
    )  # fmt: skip


def _ramp_rows(optimum: Optimum) -> tuple[RampResult, ...]:
    """One row for each piece of a profile."""
    rows, recipe = [], optimum.recipe
    for i, ramp in enumerate(optimum.ramps):
        both = slice(len(optimum.bounds) + 2 * i, len(optimum.bounds) + 2 * i + 2)
        used = float(1 - recipe.constraints[both].min())
        value = float(recipe.conditions.above[both].max())
        rows.append(RampResult(ramp.name, 60 * ramp.steepest, f"{ramp.unit}/min", used, value))
    return tuple(rows)


def _terms(terms: Sequence[Term]) -> tuple[GoalTerm, ...]:
    return tuple(GoalTerm(term.of, term.unit, term.weight) for term in terms)


def _unit(request: Optimise) -> str:
    """The goal's unit, such as "kg/h", if all terms have the same unit."""
    units = [{term.unit for term in terms} - {"1"} for terms in (request.terms, request.per)]
    if any(len(names) > 1 for names in units):
        return ""
    above, below = ("".join(names) for names in units)
    return f"{above or '1'}/{below}" if below else above


def show(run: RunFiles, result: BestRecipe) -> list[Block]:
    """The goal, the decisions, the limits that bind them, and the optimality conditions."""
    blocks: list[Block] = [Text(_goal(result)), _facts(result), _decisions(result), _limits(result)]
    if result.ramps:
        blocks.append(_ramps(result))
    return [*blocks, _conditions(result)]


def _goal(result: BestRecipe) -> str:
    """The problem in a sentence."""
    goal = _sum(result.terms)
    if result.per:
        goal = f"({goal}) / ({_sum(result.per)})"
    selected = "all limits of the nominal model are met"
    if result.reserve:
        selected += f", with {number(result.reserve)} margins to spare"
    if result.deviations:
        selected += f", and {number(result.deviations)} standard deviations of the batches to spare"
    return f"{'Largest' if result.sense == 'maximise' else 'Smallest'} {goal} such that {selected}."


def _sum(terms: Sequence[GoalTerm]) -> str:
    return " + ".join(
        ("" if x.weight == 1 else f"{number(x.weight)} ") + x.of + _in_brackets(x.unit)
        for x in terms
    )


def _in_brackets(unit: str) -> str:
    return "" if unit == "1" else f" [{unit}]"


def _facts(result: BestRecipe) -> Facts:
    before, value, unit = result.before, result.value, result.unit
    change = (value - before) / abs(before) if before else 0.0
    note = f"{percent(abs(change))} {'more' if change > 0 else 'less'}" if change else ""
    facts = [
        ("Goal, original recipe", quantity(before, unit), ""),
        ("Goal, best recipe", quantity(value, unit), note),
    ]
    for name, probability in zip(("original recipe", "best recipe"), result.chance):
        error = plus_minus(100 * probability.error, 1)
        facts.append((f"All limits met, {name}", percent(probability.probability), error))
    return Facts(facts)


def _fine(value: float, unit: str = "") -> str:
    """A number with five significant digits, so that 273.15 K keeps its digits."""
    return quantity(value, "" if unit == "1" else unit, decimals([value]))


def _multiplier(value: float) -> str:
    return number(value) if value else "0"


def _decisions(result: BestRecipe) -> Table:
    rows = []
    for x in result.decisions:
        value = x.at_low or x.at_high
        side = "at its lower bound" if x.at_low else "at its upper bound"
        rows.append(
            (
                x.name, f"{_fine(x.low)} to {_fine(x.high, x.unit)}", side if value else "inside",
                _fine(x.start, x.unit), _fine(x.value, x.unit), _multiplier(value),
            )
        )  # fmt: skip
    head = [("Decision", ""), ("Bounds", ""), ("Position", ""), ("Original", ""), ("Best", ""),
            ("Multiplier", f"{result.unit} per unit")]  # fmt: skip
    caption = "Decisions; a multiplier is the gain of the goal if the bound is relaxed by one unit"
    return Table(head, rows, caption, 3)


def _limits(result: BestRecipe) -> Table | Missing:
    rows = [
        (
            x.attribute, f"{x.side} {quantity(x.limit, '' if x.unit == '1' else x.unit)}",
            "binding" if x.worth else "free", _fine(x.start, x.unit), _fine(x.value, x.unit),
            _multiplier(x.worth),
        )
        for x in result.limits
    ]  # fmt: skip
    if not rows:
        return Missing("No attribute has a limit, so only the bounds restrict the recipe.")
    head = [("Attribute", ""), ("Limit", ""), ("", ""), ("Original", ""), ("Best", ""),
            ("Multiplier", f"{result.unit} per unit")]  # fmt: skip
    caption = "Limits; a multiplier is the gain of the goal if the limit is relaxed by one unit"
    return Table(head, rows, caption, 3)


def _ramps(result: BestRecipe) -> Table:
    rows = [
        (x.piece, quantity(x.most, x.unit), percent(x.used, 0), _multiplier(x.worth))
        for x in result.ramps
    ]
    head = [("Piece of a profile", ""), ("Ramp", ""), ("Used", ""), ("Multiplier", result.unit)]
    caption = "Ramps; a multiplier is the gain of the goal per additional 100 % of the ramp"
    return Table(head, rows, caption, 2)


def _conditions(result: BestRecipe) -> Table:
    tolerance = power(result.tolerance)

    def small(value: float) -> Mark:
        valid = finite(value) is not None and value <= result.tolerance
        return Mark(valid, f"{power(value)}, at most {tolerance}")

    endpoints = result.ends
    starts = "one start" if len(endpoints) == 1 else f"{len(endpoints)} starts, which ended at "
    if len(endpoints) > 1:
        starts += ", ".join(map(number, endpoints))
    rows = [
        ("Solver", Mark(result.converged, result.message)),
        ("Gradient not explained by multipliers of the right sign", small(result.stationarity)),
        ("Largest violation of a limit, a ramp or a bound", small(result.violation)),
        ("Work", f"{result.iterations} iterations, {result.evaluations} evaluations with all "
                 f"derivatives; {starts}"),
        ("Derivatives", result.mode),
        ("Time", f"{seconds(result.solving)} to solve, {seconds(result.compiling)} to compile"),
    ]  # fmt: skip
    return Table([], rows, "First-order conditions (Karush, Kuhn and Tucker), relative to the goal "
                 "at the start and to the width of the bounds", 2)  # fmt: skip


OPTIMUM = Chapter(
    "best recipe", "Best recipe", BestRecipe, measure, show, needs=(MESH,), key="optimise",
    table="optimise"
)  # fmt: skip
