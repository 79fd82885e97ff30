"""Other sensitivities: vegas, shadow prices of the capacities, costs and rates, and sliders.

At a limit the value of one unit more differs from that of one unit less: a store that is exactly
full can use more room, and loses gas if its room is reduced. There are therefore two shadow prices,
for one unit up and one unit down. Both come from the exact simulator with the decisions held fixed,
on the same paths.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from snapo.problem.policy import Policy
from snapo.problem.smooth import Exact
from snapo.report.missing import why_missing
from snapo.report.page import Block, Missing, Section, Slider, Sliders, Table
from snapo.report.quantity import MONTHS, SPACE, decimals, long_month, number, plus_minus_half
from snapo.report.rows import Column, table
from snapo.solver.derivatives.interval import source_text
from snapo.solver.derivatives.table import Sensitivities
from snapo.study.chapter import Chapter, Number
from snapo.study.study import Setup, StudyRun

from ..setup import OUTPUT, case_of, on_independent_paths, policy_of
from .run import SPAN, ReportedInput, Sensitivity, StorageRun

PATHS = 2048  # of shadow prices
UNITS = 1.0  # of the capacity; small against it, large against rounding
# Families of inputs; every input has one.
CURVE, RATE, MODEL = "price", "interest rate", ("volatility", "price model")
CAVEAT = (
    "First order only, with the decisions held fixed: the change is the sum of the shifts, each"
    " times its reported derivative, without an interval."
    " {bound}For other inputs the curvature may have either sign. For large moves,"
    " change the case and solve again."
)
# Held decisions earn an amount linear in the curve; it bounds the mean, not a measure of risk.
BOUND = (
    "For a move of the forward curve the change assumes the present decisions; with re-optimised"
    " decisions the value is at least as high, and the difference grows with the square of the"
    " move. "
)


@dataclass(frozen=True)
class ShadowPrice:
    """The value of one more unit of a capacity (`up`), and of its last unit (`down`)."""

    name: str
    up: Number = np.nan
    down: Number = np.nan
    unit: str = ""


@dataclass(frozen=True)
class ParallelShift:
    """The derivative with respect to a rise of all numbers of an input by one, and its 95 %
    interval."""

    input: str
    value: Number = np.nan
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class ShadowPrices:
    """The shadow prices of all capacities; the shifts of inputs that have several numbers."""

    shadow_prices: tuple[ShadowPrice, ...] = ()
    parallel_shifts: tuple[ParallelShift, ...] = ()


def measure(run: StudyRun) -> ShadowPrices:
    """The shadow prices under the decisions of the trained policy."""
    case = case_of(run.setup)
    contract, unit = case.contract, case.volume_unit
    ratchets = contract.ratchets
    capacities = [
        ("working volume", contract.max_inventory.name, unit),
        ("injection capacity", ratchets.injection.name, f"{unit}/day"),
        ("withdrawal capacity", ratchets.withdrawal.name, f"{unit}/day"),
        ("gas in store today", contract.inventory.name, unit),
    ]
    replay = _Replay(run.setup, policy_of(run.solution))
    base, prices = replay.value({}), []
    for name, key, unit in capacities:
        up, down = (replay.value({key: sign * UNITS}) for sign in (1, -1))
        prices.append(ShadowPrice(name, (up - base) / UNITS, (base - down) / UNITS, unit))
    return ShadowPrices(tuple(prices), tuple(_shifts(run.solution.sensitivities)))


def _shifts(table: Sensitivities | None) -> Iterator[ParallelShift]:
    """The shifts of every input with more than one number."""
    if table is None:
        return
    for name, values in table.inputs.items():
        if values.value.size > 1:
            shift = table.along(name, np.ones(values.value.shape))
            yield ParallelShift(name, shift.value, shift.low, shift.high)


class _Replay:
    """Values from the exact simulator with recorded decisions and shifted inputs."""

    def __init__(self, setup: Setup, policy: Policy):
        self.problem, self.engine = on_independent_paths(setup), setup.engines.evaluate
        source = self.problem.sources.evaluation
        bound = self.engine.bind(self.problem)
        paths = source.available(PATHS)
        blocks = source.blocks(paths, max(1, paths // 512))
        self.draws = [source.draws(block, self.problem.simulator) for block in blocks]
        self.actions = [
            bound.values(policy, draws, Exact(), record=("action",)).record["action"]
            for draws in self.draws
        ]

    def value(self, shifts: dict[str, float]) -> float:
        """The mean cash flow with all entries of these inputs shifted; NaN if not feasible."""
        by_name = self.problem.inputs_by_name
        values = {name: by_name[name].value + shift for name, shift in shifts.items()}
        if any(np.any(value < 0) for value in values.values()):
            return float("nan")
        moved = self.problem.at(values)
        if np.any(moved.schedule.steps.low > moved.schedule.steps.high):
            return float("nan")
        bound = self.engine.bind(moved, controls=False)
        totals = [
            bound.values(None, draws, Exact(), actions=actions).totals[OUTPUT]
            for draws, actions in zip(self.draws, self.actions)
        ]
        return float(np.mean([np.mean(total) for total in totals]))


def risk(run: StorageRun) -> Section:
    """Vegas, shadow prices, and parallel shifts of every other input."""
    prices = SHADOW_PRICES.of(run)
    shadow = why_missing(run, SHADOW_PRICES.name) if prices is None else show(run, prices)[0]
    blocks: list[Block] = [_vegas(run), shadow]
    if (others := _others(run)) is not None:
        blocks.append(others)
    title = "Vegas, shadow prices and other sensitivities"
    return Section("risk", title, "Vegas", blocks)


def _vegas(run: StorageRun) -> Table | Missing:
    """The numbers of the model; an input with many labels (such as a volatility by day) is shifted
    in parallel."""
    lines = run.group(*MODEL)
    if not lines:
        return Missing("This run has no vegas (supplied price paths have no model parameters).")
    many = {name for name, count in Counter(line.input for line in lines).items() if count > 12}
    rows = [_row(run, [item]) for item in lines if item.input not in many]
    rows += [_row(run, [entry for entry in lines if entry.input == name]) for name in sorted(many)]
    return _moves(run, rows, "Vegas: sensitivity to the price model")


def show(run: StorageRun, result: ShadowPrices) -> Sequence[Block]:
    """The table of shadow prices."""
    prices = result.shadow_prices
    if not prices:
        return [why_missing(run, SHADOW_PRICES.name)]
    digits = decimals([x for price in prices for x in (price.up, price.down)], 4)
    columns = (
        Column("Capacity", lambda price: price.name.capitalize()), Column("Unit", "unit"),
        Column("Value of one more", "up", run.currency, sign=True),
        Column("One less costs", "down", run.currency, sign=True),
    )  # fmt: skip
    return [table(prices, columns, "Shadow prices of volume and capacity", decimal_places=digits)]


def _others(run: StorageRun) -> Table | None:
    """Parallel shifts: the sensitivities of an input summed over its labels."""
    groups: dict[str, list[Sensitivity]] = defaultdict(list)
    for sensitivity in run.sensitivities:
        if run.input_number(sensitivity.input).group not in (CURVE, *MODEL):
            groups[sensitivity.input].append(sensitivity)
    if not groups:
        return None
    rows = [_row(run, members) for members in groups.values()]
    folded = f"Sensitivities to {len(rows)} other inputs"
    return _moves(run, rows, "Parallel shifts of the other inputs", folded)


def _row(run: StorageRun, members: list[Sensitivity]) -> tuple[str, ...]:
    """One row for a number, or for several numbers of one input that move together.

    Costs, rates and capacities differ in size by powers of ten: decimals are chosen row by row. The
    half-width of a sum is not the sum of the half-widths; for an input that moves as a whole it
    comes from its `ParallelShift`. The half-width decides how many digits are shown.
    """
    first, prices = members[0], SHADOW_PRICES.of(run)
    shifts = {x.input: x for x in prices.parallel_shifts} if prices else {}
    metadata = run.input_number(first.input, first.unit)
    total, error = metadata.move * math.fsum(member.value or 0.0 for member in members), None
    shift = first if len(members) == 1 else shifts.get(first.input)
    if shift is not None and shift.low is not None and shift.high is not None:
        error = metadata.move * (shift.high - shift.low) / 2
    label, move = first.label if len(members) == 1 else "", _move(metadata)
    if len(members) > 1:
        move = f"{move}, all {len(members)} numbers together"
    digits = min(decimals([error], 2) if error else decimals([total], 4), 6)
    change, source = number(total, digits, True), source_text(first.source)
    return (
        metadata.title(label),
        metadata.meaning,
        move,
        change,
        plus_minus_half(error, digits),
        f"{source}, not significant" if error and abs(total) <= error else source,
    )


def _move(metadata: ReportedInput) -> str:
    """ "1 volatility point", "10 bp", "0.01 EUR/MWh", "1 per year"."""
    if metadata.trade_unit.startswith("1/"):
        return f"{metadata.trade_move:.6g} per {metadata.trade_unit[2:]}"
    return f"{metadata.trade_move:.6g} {metadata.trade_unit}"


def _moves(run: StorageRun, rows, caption: str, folded: str = "") -> Table:
    head = [("Input", ""), ("Meaning", ""), ("For a rise of", "")]
    head += [("Value changes by", run.currency), ("", ""), ("Derivative", "")]
    return Table(head, rows, caption, frozenset({0, 1, 2, 5}), folded=folded)


def sliders(run: StorageRun) -> Section:
    """Sliders for the whole curve, each delivery month, and the model numbers."""
    title, short = "What if: inputs moved, with decisions held fixed", "What if"
    value = run.result.value
    curve, months = _curve_sliders(run)
    groups = (
        ("Forward curve", curve),
        ("Model and rates", _model_sliders(run)),
        ("Delivery months", months),
    )
    results = [(name, item) for name, item in groups if item]
    if value is None or not results:
        text = (
            "This run has no value or no saved sensitivities, so no first-order change can be "
            "shown."
        )
        return Section("what-if", title, short, [Missing(text)])
    caveat = CAVEAT.format(bound=BOUND if run.get("objective", "mean") == "mean" else "")
    block = Sliders(value, run.currency, decimals([value]), results, caveat)
    return Section("what-if", title, short, [block])


def _curve_sliders(run: StorageRun) -> tuple[list[Slider], list[Slider]]:
    """A slider for the whole curve, and sliders for its delivery months, or for quarters if there
    are many months."""
    months: dict[str, float] = defaultdict(float)
    for sensitivity in run.sensitivities:
        if run.input_number(sensitivity.input).group == CURVE:
            months[long_month(sensitivity.label)] += sensitivity.value or 0.0
    if not months:
        return [], []
    if len(months) > 18:
        months = _quarters(months)
    prices = run.numbers("forward", "forward")
    level = 1.0 if prices is None else float(np.nanmean(np.abs(prices)))
    span = _round(0.15 * level)
    shape = {"unit": run.price, "span": span, "step": span / 50, "places": decimals([span / 50], 1)}
    complete = Slider("Whole curve", slope=math.fsum(months.values()), **shape)
    parts = [Slider(month, slope=slope, **shape) for month, slope in months.items()]
    return [complete], parts if len(parts) > 1 else []


def _quarters(months: dict[str, float]) -> dict[str, float]:
    """{"Apr 2021": …} summed into {"Q2 2021": …}."""
    names = [name[:3] for name in MONTHS.split()]
    quarters: dict[str, float] = defaultdict(float)
    for month, slope in months.items():
        name, _, year = month.partition(SPACE)
        quarters[f"Q{names.index(name) // 3 + 1}{SPACE}{year}" if year else month] += slope
    return quarters


def _model_sliders(run: StorageRun) -> list[Slider]:
    """Sliders for volatilities and rates in the unit in which they are traded; a series by delivery
    day has one slider."""
    totals: dict[tuple[str, str], float] = defaultdict(float)
    for item in run.group("volatility", RATE):
        # A label of ten letters is a delivery day.
        by_name = run.input_number(item.input).group != RATE and len(item.label) < 10
        totals[item.input, item.label if by_name else ""] += item.value or 0.0
    return [
        _slider(run.input_number(name), label, slope) for (name, label), slope in totals.items()
    ]


def _slider(metadata: ReportedInput, label: str, slope: float) -> Slider:
    """A slider over `SPAN` standard moves to either side; `slope` is per unit of the input."""
    span = SPAN * metadata.trade_move
    step = span / 20
    slope *= metadata.move / metadata.trade_move
    return Slider(
        metadata.title(label), metadata.trade_unit, slope, span, step, decimals([step], 1)
    )


def _round(size: float) -> float:
    """The nearest number of the series 1, 2, 5, 10 …"""
    scale = 10.0 ** math.floor(math.log10(size)) if size > 0 else 1.0
    return scale * min((1.0, 2.0, 5.0, 10.0), key=lambda item: abs(size / scale - item))


SHADOW_PRICES = Chapter("shadow prices", "Shadow prices", ShadowPrices, measure, show)
