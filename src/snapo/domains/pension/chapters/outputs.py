"""Sensitivities of several outputs in one run: the objective, and the figures that a board uses.

Decisions are recorded once, and one adjoint pass with a cotangent for each output runs over the
same paths. An effect on a ratio or a probability is reported in points, in basis points, and in
money as this share of today's liability. An effect on money is also reported as a share of the
liability. For a fund of personal pots the ratio is that of its pensions to those of today, and
effects on it have no value in money.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from snapo.problem.inputs import plain
from snapo.problem.objective import CVaR, Mean, Objective, Probability
from snapo.report.missing import why_missing
from snapo.report.page import Block, Facts, Table, Text
from snapo.report.quantity import decimals, measured, number, plus_minus
from snapo.solver.evaluate import estimate
from snapo.solver.sensitivity import held_of_several
from snapo.solver.statistics import Estimate
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun
from snapo.study.training import TRAINING

from ..people.longer_life import longer_life
from ..results.setup import OutcomeMeasure, case_of, outcome_measure
from ..run import PensionRun, share, with_measure
from .objective import equivalent
from .reconciliation import RECONCILIATION
from .sensitivities import LIFE, rise, standard_move

LEVEL = 0.95
WIDTH = 0.02  # of the ratio, over which a path counts as about to fall below the mark
PATHS = 4096
CSV = "outputs.csv"
SHOWN = 12
OBJECTIVE = "Objective"  # its name where it is a utility, which has no unit
CAVEAT = (
    "First-order effects of the standard moves, with decisions held fixed; one adjoint pass for "
    "each output, over the same paths. Points are percentage points of the funding ratio or of "
    "probability. In money an effect is this share of today's liability; for contributions it is "
    "the change of their present value. The probability is the exact share of paths; its effects "
    "are those on a logistic step of width 2 points, the mean of 1 / (1 + exp((F − 1) / 0.02)). A "
    "utility has no unit. The file outputs.csv has every number."
)
OF_POTS = (
    ("points of the funding ratio", "points of today's pension"),
    ("In money an effect is this share of today's liability; for contributions it is the change "
     "of their present value.", "For contributions the effect is the change of their present "
        "value, in money."),
    ("exp((F − 1) / 0.02))", "exp((P − 1) / 0.02)), where P is the pension divided by that of "
        "today"),
)  # fmt: skip


@dataclass(frozen=True)
class OutputValue:
    """A figure of the final ratio or of contributions, with its standard error; `money`: whether it
    is money or a share."""

    key: str = ""
    name: str = ""
    money: bool = False
    value: Number = np.nan
    error: Number = np.nan


@dataclass(frozen=True)
class OnOutputs:
    """The effect of a standard move: {output: (effect, standard error)} in the output's unit
    (money, or 1)."""

    input: str
    move: str
    group: str
    effects: dict[str, tuple[Number, Number]]


@dataclass(frozen=True)
class InputOnOutputs(OnOutputs):
    """The effects of moving all numbers of an input together."""

    count: int
    words: str


@dataclass(frozen=True)
class NumberOnOutputs(OnOutputs):
    """The effects of moving a single number."""

    label: str


@dataclass(frozen=True)
class OutputTable:
    """The values of all outputs, and the effects on them."""

    outputs: tuple[OutputValue, ...] = ()
    families: tuple[InputOnOutputs, ...] = ()
    rows: tuple[NumberOnOutputs, ...] = ()


class Derived(NamedTuple):
    """An output, and its derivatives `held` {input: derivatives} with decisions held fixed, which
    are to be multiplied by `scale`."""

    output: OutputValue
    held: dict[str, Estimate]
    scale: float = 1.0


def requested(by: OutcomeMeasure) -> tuple[tuple[str, str, bool, Objective], ...]:
    """For every output: its key, its name, whether it is money, and its objective. Underfunding is
    reported as 1 minus the probability of its complement."""
    return (
        ("funding", by.mean, False, Mean(by.output)),
        ("tail", by.tail, False, CVaR(by.output, LEVEL)),
        ("underfunded", by.below, False, -1.0 * Probability(by.output, 1.0, WIDTH)),
        ("contributions", "PV of contributions", True, Mean("pv_contribution")),
    )


def measure(run: StudyRun) -> OutputTable:
    """The values of all outputs, and the effect of every input's standard move on them.

    Writes outputs.csv.
    """
    setup, table = run.setup, run.solution.sensitivities
    if table is None:
        return OutputTable()
    derived = list(_outputs(run))
    families, rows = [], []
    for name, entry in table.inputs.items():
        usual = standard_move(entry)
        about, numbers = (name, usual.words, entry.group), entry.value.size
        effects = _effects(derived, name, usual.size)
        families.append(InputOnOutputs(*about, effects, numbers, entry.meaning))
        for i, label in enumerate(entry.names()):
            alone = np.where(np.arange(numbers) == i, usual.size, 0.0)
            rows.append(NumberOnOutputs(*about, _effects(derived, name, alone), label))
    if (life := longer_life(case_of(run), plain(setup.problem.inputs))) is not None:
        about, numbers = ("year_of_life", "1 year", "people"), len(life.change)
        effects = _effects(derived, life.input, life.change)
        families.append(InputOnOutputs(*about, effects, numbers, LIFE))
    outputs = tuple(x.output for x in derived)
    _write(run, outputs, rows)
    return OutputTable(outputs, tuple(families), tuple(rows))


def _outputs(run: StudyRun) -> Iterator[Derived]:
    """The objective, whose derivatives the run has already, then the outputs of `requested`."""
    goals = requested(outcome_measure(case_of(run)))
    setup, solution, problem = run.setup, run.solution, run.setup.problem
    policy, table = solution.policy, solution.sensitivities
    assert policy is not None
    assert table is not None
    certain = equivalent(problem.objective, solution.value)
    value, slope = (solution.value, 1.0) if certain is None else (certain.ratio, certain.slope)
    name = "Objective" if certain is None else "Certainty equivalent"
    error = slope * solution.standard_error
    yield Derived(OutputValue("objective", name, False, value, error), table.held, slope)
    totals = {name: np.asarray(total) for name, total in solution.totals.items()}
    paths = min(PATHS, setup.evaluation.sensitivity_paths, setup.evaluation.paths)
    run.progress(f"sensitivities of {len(goals)} more outputs at once")
    objectives = [goal for *_, goal in goals]
    table = held_of_several(problem, policy, objectives, paths=paths, engine=setup.engines.evaluate)
    for (key, name, money, goal), held in zip(goals, table):
        estimated = estimate(goal, totals, problem.sources.evaluation)
        value = estimated.value + (key == "underfunded")
        yield Derived(OutputValue(key, name, money, value, estimated.standard_error), held)


def _effects(
    derived: Sequence[Derived], name: str, size: np.ndarray
) -> dict[str, tuple[float, float]]:
    """{output: (effect, standard error)} for a move [n] of an input's numbers."""
    effects = {}
    for output, held, scale in derived:
        effect, error = held[name].along(size.reshape(held[name].value.shape))
        effects[output.key] = scale * effect, scale * error
    return effects


def _write(run: StudyRun, outputs: Sequence[OutputValue], rows: Sequence[NumberOnOutputs]) -> None:
    """Every number with its effect on every output, in points, basis points and money."""
    head = ("input", "label", "move", "output", "points", "points_error", "basis_points", "money")
    today, valued = RECONCILIATION.of(run), case_of(run).pots is None
    liability = (today.liability if today else 0.0) or np.nan

    def lines() -> Iterator[tuple]:
        for row in rows:
            for output in outputs:
                effect, error = row.effects[output.key]
                share = 1 / liability if output.money else 1.0
                # A utility, unlike a certainty equivalent, is no share of anything.
                is_share = output.money or (valued and output.name != OBJECTIVE)
                money = share * effect * liability if is_share else np.nan
                points = 100 * share * effect, 100 * share * error, 1e4 * share * effect
                yield row.input, row.label, row.move, output.name, *points, money

    run.write_csv(CSV, head, lines())


def show(run: PensionRun, result: OutputTable) -> Sequence[Block]:
    """The largest effects on all outputs, then all effects on every output with their errors."""
    if not result.outputs or not result.families:
        return [why_missing(run, OUTPUTS.name)]
    today = RECONCILIATION.of(run)
    liability = (today.liability if today else 0.0) or 1.0
    with_unit = [output for output in result.outputs if output.name != OBJECTIVE]

    def largest(family: InputOnOutputs) -> float:
        return max(abs(_as_share(x, family.effects[x.key][0], liability)) for x in with_unit)

    order = sorted(result.families, key=lambda family: -largest(family))
    facts = [(output.name, *_value(run, output)) for output in with_unit]
    caveat = CAVEAT
    for old, new in OF_POTS if run.personal else ():
        caveat = caveat.replace(old, new)
    return [
        Facts(facts),
        _summary(run, result.outputs, order[:SHOWN]),
        *(_detail(run, output, order, liability) for output in result.outputs),
        Text(caveat, caveat=True),
    ]


def _value(run: PensionRun, output: OutputValue) -> tuple[str, str]:
    if output.money:
        return run.large(output.value), plus_minus(output.error / run.size([output.value])[0], 2)
    return share(output.value), f"{plus_minus(100 * output.error, 2)} points"


def _as_share(output: OutputValue, effect: float, liability: float) -> float:
    """An effect as a share: of the ratio, of probability, or money over today's liability."""
    return effect / liability if output.money else effect


def _summary(
    run: PensionRun, outputs: Sequence[OutputValue], families: Sequence[InputOnOutputs]
) -> Table:
    """One line for each input, one column for each output: points, contributions in money."""
    columns, head = [], [("Move", "")]
    for output in outputs:
        effects = [family.effects[output.key][0] for family in families]
        scale, unit = 0.01, "points"
        if output.name == OBJECTIVE:
            scale, unit = 1.0, ""
        elif output.money:
            scale, unit = run.size(effects)
        digits = decimals([effect / scale for effect in effects], 3)
        columns.append([number(effect / scale, digits, True) for effect in effects])
        head.append((output.name, unit))
    rows = [(rise(family), *cells) for family, *cells in zip(families, *columns)]
    return Table(head, rows, "The largest effects of the standard moves on each output", 1)


def _detail(
    run: PensionRun, output: OutputValue, families: Sequence[InputOnOutputs], liability: float
) -> Table:
    """All inputs for one output, in points, basis points and money, with the error."""
    unitless = output.name == OBJECTIVE
    valued = output.money or not run.personal  # a share of a pension is no sum of money
    rows = []
    for family in families:
        effect, error = family.effects[output.key]
        if unitless:
            rows.append((rise(family), number(effect, None, True), plus_minus(error, 6)))
            continue
        part, spread = (_as_share(output, x, liability) for x in (effect, error))
        cells = [*measured(100 * part, 100 * spread, 3, True), number(1e4 * part, 1, True)]
        money = [run.large(part * liability, 2, True)] if valued else []
        rows.append((rise(family), *cells, *money))
    head = [("Move", ""), ("Effect", "" if unitless else "points"), ("", "")]
    if not unitless:
        head += [("Effect", "bp"), *([("In money", run.currency)] if valued else [])]
    caption = f"Effects on: {output.name}"
    return Table(head, rows, caption, 1, folded=f"{output.name}: every input")


OUTPUTS = Chapter(
    "outputs", with_measure("Sensitivities of several outputs"), OutputTable, measure, show,
    needs=(TRAINING.name, "reconciliation"), key="outputs",
)  # fmt: skip
