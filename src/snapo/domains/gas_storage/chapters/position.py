"""The store over time: inventory and flow against their limits, and the trigger prices."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from snapo.engine import TRAJECTORY
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact
from snapo.report import charts
from snapo.report.drawing import days as date_numbers
from snapo.report.drawing import draw
from snapo.report.missing import why_missing
from snapo.report.page import Block, Chart, Missing, Section
from snapo.report.quantity import quantity
from snapo.solver.solution import Solution
from snapo.study.chapter import Chapter, Floats, Number, floats
from snapo.study.study import Setup, StudyRun

from ..contract.records import StorageCase
from ..policy.network import StoragePolicy
from ..policy.triggers import Triggers, decide, spots_around, triggers
from ..setup import case_of, on_independent_paths, policy_of
from .run import StorageRun
from .today import FirstDecision, first_decision, levels_of

PATHS = 4096
PRICES = 21  # spot prices of decisions.csv, mostly from half to one and a half of the forward
TRIGGERS = (("withdrawal", "Withdraw above", "withdraw"), ("injection", "Inject below", "inject"))


@dataclass(frozen=True)
class MeanBand:
    """The mean over paths at each step, with the 5 and 95 % quantiles."""

    mean: Floats = floats()
    p05: Floats = floats()
    p95: Floats = floats()


@dataclass(frozen=True)
class LowHigh:
    """The lower and the higher of two inventories on each day."""

    low: Floats = floats()
    high: Floats = floats()

    def until(self, length: int) -> tuple[np.ndarray, np.ndarray] | None:
        """The first `length` days of both; None if there are none."""
        return (self.low[:length], self.high[:length]) if self.low.size else None


@dataclass(frozen=True)
class Cycles:
    """Turnovers of the working volume."""

    mean: Number = np.nan
    unit: str = "injected volume / working volume"


@dataclass(frozen=True)
class Position:
    """The store over its T decision days, in the units of the contract.

    - `inventory` [T + 1]: at the start of every day and at the end; `flow` [T]: net injection.
    - `trigger_injection`, `trigger_withdrawal` [T]: the spot prices below which to inject and above
      which to withdraw, at the mean inventory of the day.
    - `reachable`, `limits` [T + 1]: the inventories from which the contract can still be met, and
      the inventories that it allows.
    """

    inventory: MeanBand = field(default_factory=MeanBand)
    flow: MeanBand = field(default_factory=MeanBand)
    trigger_injection: Floats = floats()
    trigger_withdrawal: Floats = floats()
    reachable: LowHigh = field(default_factory=LowHigh)
    limits: LowHigh = field(default_factory=LowHigh)
    today: FirstDecision | None = None
    cycles: Cycles = field(default_factory=Cycles)


def measure(run: StudyRun) -> Position:
    """The store operated by the trained policy; writes decisions.csv."""
    setup, solution = run.setup, run.solution
    problem, case, policy = setup.problem, case_of(setup), policy_of(solution)
    horizon, steps = problem.simulator.horizon, problem.schedule.steps
    inventory, flow = _paths(setup, solution)
    here, levels = levels_of(problem.schedule)
    run.write_csv("decisions.csv", *_by_price(problem, case, policy, levels))
    # One call for the mean inventory of every day, and for every level of the first one.
    days = np.append(np.arange(horizon), np.zeros(len(levels), int))
    prices = triggers(problem, policy, days, np.append(inventory.mean(1)[:-1], levels))
    by_day, first = (
        Triggers(*(x[part] for x in prices))
        for part in (slice(None, horizon), slice(horizon, None))
    )
    contract = case.contract
    injected = np.asarray(solution.totals["injection"])
    return Position(
        _band(inventory),
        _band(flow),
        by_day.injection,
        by_day.withdrawal,
        LowHigh(
            np.append(steps.low, steps.next_low[-1]), np.append(steps.high, steps.next_high[-1])
        ),
        LowHigh(contract.min_inventory.used(), contract.max_inventory.used()),
        first_decision(problem, case, solution, (here, levels), first),
        Cycles(injected.mean() / working_volume(case)),
    )


def working_volume(case: StorageCase) -> float:
    """The largest difference between the inventory limits of a day."""
    contract = case.contract
    return float(contract.max_inventory.used().max() - contract.min_inventory.used().min())


def _by_price(problem: Problem, case: StorageCase, policy: StoragePolicy, levels: np.ndarray):
    """Header and rows of decisions.csv: the decision of the first day by spot price and
    inventory."""
    forward = problem.schedule.steps.forward[:1]
    around = forward * np.linspace(0.5, 1.5, PRICES)
    if not case.model.proportional:
        around = spots_around(problem, forward, np.linspace(-0.5, 0.5, PRICES))[0]
    spots, stock = np.meshgrid(around, levels, indexing="ij")
    spots, stock = spots.ravel(), stock.ravel()
    decided = decide(problem, policy, 0, stock, spots)
    gas, price = case.volume_unit, f"{case.currency}/{case.volume_unit}"
    header = (
        "date", f"spot ({price})",
        *(f"{name} ({gas})" for name in ("inventory", "injection", "withdrawal")),
    )  # fmt: skip
    day = case.days[0].isoformat()
    return header, ((day, *row) for row in zip(spots, stock, decided.injection, decided.withdrawal))


def _paths(setup: Setup, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Inventories [T + 1, paths] and net injections [T, paths] of the exact simulator."""
    problem = on_independent_paths(setup)
    source = problem.sources.evaluation
    bound = setup.engines.evaluate.bind(problem, controls=False)
    inventories, flows = [], []
    for block in source.blocks(source.available(PATHS), 8):
        draws = source.draws(block, problem.simulator)
        rollout = bound.values(policy_of(solution), draws, Exact(), record=TRAJECTORY)
        start = np.asarray(rollout.record["state"].inventory)
        inventories.append(np.concatenate([start, np.asarray(rollout.state.inventory)[None]]))
        outputs = rollout.record["outputs"]
        flows.append(np.asarray(outputs["injection"]) - np.asarray(outputs["withdrawal"]))
    return np.concatenate(inventories, 1), np.concatenate(flows, 1)


def _band(paths: np.ndarray) -> MeanBand:
    return MeanBand(paths.mean(1), *np.quantile(paths, [0.05, 0.95], axis=1))


def show(run: StorageRun, position: Position) -> Sequence[Block]:
    """The forward curve, with the price below which to inject and the price above which to
    withdraw."""
    prices, days = run.numbers("forward", "forward"), run.days
    if prices is None or days is None:
        return [why_missing(run, POSITION.name)]
    when, lines = date_numbers(days), []
    for key, label, colour in TRIGGERS:
        values = getattr(position, f"trigger_{key}")
        if np.isfinite(values).any():
            lines.append(charts.Line(label, values, colour, width=1.3))
    lines.append(charts.Line("Forward price", prices, "ink", width=2.0, step=True))
    low, high = np.nanmin(prices), np.nanmax(prices)
    alt = (
        f"Forward price by day, from {quantity(low, run.price, 2)} to"
        f" {quantity(high, run.price, 2)}, with the trigger prices of injection and withdrawal."
    )
    svg = draw("curve-lines", alt, lambda axes: charts.lines(axes, when, lines, run.price))
    caption = (
        "Trigger prices are undiscounted spot prices at the expected inventory of the day: the"
        " policy injects if the spot price is below the blue line, and withdraws if it is above the"
        " orange line."
    )
    blocks: list[Block] = [Chart(svg, caption)]
    if len(lines) == 1:
        blocks.append(Missing("The trigger prices by day are not in this run."))
    return blocks


def inventory(run: StorageRun) -> Section:
    """The expected inventory with its 5-95 % band, within the reachable and the allowed
    inventories."""
    title, short = "Inventory against its limits", "Inventory"
    position, days = POSITION.of(run), run.days
    if position is None or days is None or not position.inventory.mean.size:
        return Section("inventory", title, short, [why_missing(run, POSITION.name)])
    mean, when, flow = position.inventory.mean, date_numbers(days), position.flow.mean
    endpoints = np.append(when, when[-1] + 1)[
        : len(mean)
    ]  # [T + 1]: every day's start, and the end
    low, high = (x if x.size else None for x in (position.inventory.p05, position.inventory.p95))
    reach, limits = (x.until(len(mean)) for x in (position.reachable, position.limits))

    def paint(stock, daily=None):
        charts.fan(stock, endpoints, mean, low, high, run.volume, reach=reach, limits=limits)
        if daily is not None:
            # Withdrawals point up, as they earn; the run counts injections as positive.
            names = ("Withdrawal, mean", "Injection, mean")
            charts.signed_strip(daily, when, -flow, run.daily, names)

    rows, height = ((2.0, 1.0), 370) if flow.size else ((1.0,), 260)
    alt = (
        f"Mean inventory by day with a 5 to 95 % band; it starts at {run.gas(mean[0])}, peaks at"
        f" {run.gas(np.nanmax(mean))} on {days[int(np.nanargmax(mean[: len(days)]))]} and ends at"
        f" {run.gas(mean[-1])}."
    )
    svg = draw("inventory-fan", alt, paint, height, rows)
    caption = (
        "The grey area contains all inventories from which the contract can still be met; the "
        "policy cannot leave it. The lower chart is the mean flow of each day: withdrawals "
        "upwards, injections downwards."
    )
    return Section("inventory", title, short, [Chart(svg, caption)])


POSITION = Chapter("profile", "Forward curve and trigger prices", Position, measure, show, "Curve")
