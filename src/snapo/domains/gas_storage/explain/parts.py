"""The change of value between two runs, one cause after another, on the same paths.

    V(first run) + time + decisions + curve + volatility + … + policy + rest - cash = V(second)

Each cause is a revaluation with all causes before it in place: the exact contract, the policy of
the first run with its marginal values adapted to the new numbers, and in the last step the
policy of the second run. Only the rest is a remainder.
"""

import datetime
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from snapo.case.given import CaseInput
from snapo.case.quantity import numbers_in
from snapo.problem.scenarios import Sources
from snapo.report.quantity import long_month
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals, value_of_groups
from snapo.study.study import ProgressCallback, Setup

from ..contract.records import StorageCase
from ..history.backtest import trained_policy
from ..policy.network import StoragePolicy
from ..setup import bare_problem, fitted_value, make_setup, rebuilt, setup_at
from . import CASH, CONTRACT, DECISIONS, FIRST, NOTES, POLICY, RATE, REST, SECOND, SPOT, TIME
from .curve import CurveEffect, DeliveryPeriod, curve_effect
from .flows import DayFlow, PassedDays, TakenFlow, passed_days
from .runs import ValuedRun, check_pair, later_paths, on_date_of, with_curve

DIGITS = 2  # decimals: cents


@dataclass(frozen=True)
class ChangePart:
    """One part of the change of value, in the currency.

    - `part`: the cause; `period`: the delivery period, of the curve only.
    - `amount`: rounded, so that the parts add up to the change; `standard_error`: None of an amount
      without sampling.
    """

    part: str
    period: str
    amount: float
    standard_error: float | None
    note: str = ""


@dataclass(frozen=True)
class CurveMove:
    """The mean move of the forward price of a delivery period, in currency per unit.

    - `delta`: discounted, in the unit of gas; None where the mean price did not move.
    """

    period: str
    days: int
    move: float
    delta: float | None


@dataclass(frozen=True, eq=False)
class ExplainedChange:
    """The change of value from the first run to the second one.

    - `values`, `errors`: of the two runs; `dates`: their valuation dates.
    - `cash`: of the days between; profit and loss is the change of value and this cash.
    - `parts`: add up to the change, the cash with a minus; `totals`: the same with all periods of
      the curve together; `moves`: of the curve; `flows`: of the days between.
    - `digits`: decimals of the amounts; `paths`: on which the parts are.
    """

    runs: tuple[Path, Path]
    title: str
    currency: str
    unit: str
    dates: tuple[str, str]
    values: tuple[float, float]
    errors: tuple[float, float]
    cash: float
    parts: tuple[ChangePart, ...]
    totals: tuple[ChangePart, ...]
    moves: tuple[CurveMove, ...]
    flows: tuple[DayFlow, ...]
    digits: int
    paths: int
    notes: tuple[str, ...] = ()

    @property
    def change(self) -> float:
        """Of the value, rounded like the parts."""
        return round(self.values[1] - self.values[0], self.digits)

    @property
    def profit(self) -> float:
        """Profit and loss: the change of value and the cash."""
        return round(self.change + self.cash, self.digits)


def decimals_of(value: float) -> int:
    """Of the parts of a value: cents, and more of one below 1,000."""
    return max(DIGITS, 5 - math.floor(math.log10(value))) if 0 < value < 1000 else DIGITS


def explained_change(
    first: ValuedRun,
    second: ValuedRun,
    progress: ProgressCallback,
    flows: Mapping[datetime.date, TakenFlow] | None = None,
) -> ExplainedChange:
    """The parts of the change of value; `flows`: of the days between, as they were.

    **Raises:** `CaseError` where the second run cannot follow the first one.
    """
    check_pair(first, second)
    return _Chain(first, second, progress, flows).result()


class _Chain:
    """Revaluations from the first run to the second one."""

    def __init__(
        self,
        first: ValuedRun,
        second: ValuedRun,
        progress: ProgressCallback,
        flows: Mapping[datetime.date, TakenFlow] | None,
    ):
        self.first, self.second, self.progress, self.flows = first, second, progress, flows
        case = second.case
        self.setup = make_setup(case, second.engine, fitted_value(bare_problem(case)))
        assert isinstance(self.setup.policy, StoragePolicy)
        self.policy, self.last_policy = (
            trained_policy(run.folder, self.setup.policy) for run in (first, second)
        )
        self.rows: list[ChangePart] = []
        self.totals: list[ChangePart] = []
        self.digits = decimals_of(max(abs(first.value), abs(second.value)))
        self.source = self.setup.problem.sources.evaluation

    def result(self) -> ExplainedChange:
        first, second, case = self.first, self.second, self.second.case
        passed = self._passed()
        start, at = self._started(passed)
        assert isinstance(at.case, StorageCase)
        setup = self._at(with_curve(at.case, case.market.forward_curve.used()), at)
        effect, moves = self._curve(at, setup)
        shares = effect.after
        for name, note, step in self._steps(setup.case):
            setup = self._at(step, setup)
            shares = self._add(name, note, shares, self._shares(setup, self.policy))
        last = self._shares(setup, self.last_policy)
        self._add(POLICY, NOTES[POLICY], shares, last)
        cash = round(passed.cash, self.digits)
        errors = [effect.error, *self._unpaired(start, first), *self._unpaired(last, second)]
        change = round(second.value - first.value, self.digits)
        left = round(change + cash - sum(row.amount for row in self.rows), self.digits)
        self._row(REST, left, float(statistics.independent(*errors)), NOTES[REST])
        if passed.flows:
            self._row(CASH, -cash, None, NOTES[CASH])
        return ExplainedChange(
            (first.folder, second.folder),
            case.title,
            case.currency,
            case.volume_unit,
            (first.case.valuation_date.isoformat(), case.valuation_date.isoformat()),
            (first.value, second.value),
            (first.error, second.error),
            cash,
            tuple(self.rows),
            tuple(self.totals),
            moves,
            passed.flows,
            self.digits,
            self.source.available(second.case.evaluation.paths),
            () if self.flows else tuple(_notes(passed)),
        )

    def _passed(self) -> PassedDays:
        """The days of the first run that are not of the second one."""
        one, other = self.first.case, self.second.case
        count = len(one.days) - len(other.days)
        elapsed = (other.valuation_date - one.valuation_date).days
        inventory = float(other.contract.inventory.used())
        problem = rebuilt(bare_problem(one)) if count else bare_problem(one)
        numbers = count, inventory, elapsed
        return passed_days(one, problem, self.policy, *numbers, self.flows)

    def _started(self, passed: PassedDays) -> tuple[np.ndarray, Setup]:
        """The shares of the value before the first part that is on common paths, and the setup of
        the first run's market on the second date, with the second inventory."""
        first, other = self.first, self.second.case
        inventory = float(other.contract.inventory.used())
        later = other.valuation_date > first.case.valuation_date
        planned = on_date_of(first, self.second, passed.planned_inventory)
        setup = self._at(planned, self.setup)
        if later:
            setup = self._on_common_paths(setup, len(passed.flows))
            start = self._shares(setup, self.policy)
            before = self._paired(first, len(start))
            if before is None:
                total = statistics.of_shares(start)
                error = float(statistics.independent(first.error, total.standard_error))
                amount = total.value - first.value
            else:
                total = statistics.of_shares(start - before)
                amount, error = total.value, total.standard_error
            self._row(TIME, amount + passed.planned_cash, error, NOTES[TIME])
        else:
            start = self._shares(setup, self.policy)
        if any(flow.taken != flow.planned for flow in passed.flows) or not np.isclose(
            passed.planned_inventory, inventory, rtol=1e-9
        ):
            setup = self._at(on_date_of(first, self.second, inventory), setup)
            now = self._shares(setup, self.policy)
            step = statistics.of_shares(now - start)
            more = passed.forward_cash - passed.planned_cash
            self._row(DECISIONS, step.value + more, step.standard_error, NOTES[DECISIONS])
        if passed.cash != passed.forward_cash:
            self._row(SPOT, passed.cash - passed.forward_cash, None, NOTES[SPOT])
        return (start if not later else np.zeros(0)), setup

    def _on_common_paths(self, setup: Setup, passed: int) -> Setup:
        """On the paths of the first run, day by day, where a shift gives them."""
        case = self.first.case
        earlier = bare_problem(case).simulator
        same = (case.evaluation, case.training.seed) == (
            self.second.case.evaluation, self.second.case.training.seed,
        )  # fmt: skip
        source = later_paths(self.source, earlier, setup.problem.simulator, passed)
        if not same or source is None:
            return setup
        self.source = source
        return _measured_on(setup, source)

    def _paired(self, run: ValuedRun, count: int) -> np.ndarray | None:
        """The shares of the first run's value on the paths of the parts; None on other paths."""
        common = self.source is not self.setup.problem.sources.evaluation
        if not common or run.shares is None or len(run.shares) != count:
            return None
        return run.shares if np.isclose(run.shares.mean(), run.value, rtol=1e-6) else None

    def _unpaired(self, shares: np.ndarray, run: ValuedRun) -> Iterator[float]:
        """Errors of a reported value and of the same value here, where they have other paths."""
        if len(shares) and not np.isclose(shares.mean(), run.value, rtol=1e-9):
            yield run.error
            yield statistics.of_shares(shares).standard_error

    def _at(self, case: StorageCase, setup: Setup) -> Setup:
        """The setup of a case, on the paths of the parts."""
        if case is setup.case:
            return setup
        return _measured_on(setup_at(setup, case), self.source)

    def _shares(self, setup: Setup, policy: StoragePolicy) -> np.ndarray:
        problem = setup.problem
        totals = path_totals(
            problem, policy, self.setup.evaluation.paths, engine=setup.engines.evaluate
        )
        values = problem.objective, totals, problem.sources.evaluation
        return value_of_groups(*values, problem.simulator.control_variates())

    def _add(self, name: str, note: str, before: np.ndarray, now: np.ndarray) -> np.ndarray:
        step = statistics.of_shares(now - before)
        self._row(name, step.value, step.standard_error, note)
        return now

    def _row(self, name: str, amount: float, error: float | None, note: str) -> None:
        row = ChangePart(name, "", round(amount, self.digits) + 0.0, error, note)
        self.rows.append(row)
        self._total(row)

    def _total(self, row: ChangePart) -> None:
        self.totals.append(row)
        self.progress(f"{row.part}: {row.amount:,.{self.digits}f}")

    def _curve(self, before: Setup, after: Setup) -> tuple[CurveEffect, tuple[CurveMove, ...]]:
        case = self.second.case
        periods = delivery_periods(case)
        effect = curve_effect(before, after, self.policy, periods)
        old, new = (x.case.market.forward_curve.used() for x in (before, after))  # pyright: ignore
        moves = []
        for period, of in zip(periods, effect.periods, strict=True):
            last = len(new) if period.after == len(case.days) else period.after
            move = float(np.mean((new - old)[period.first : last]))
            delta = of.first / move if move else None
            moves.append(CurveMove(period.name, period.after - period.first, move, delta))
        errors = effect.total.first_error, effect.total.second_error
        for k, (name, error) in enumerate(zip((FIRST, SECOND), errors)):
            rows = [
                ChangePart(
                    name, period.name, round(of[2 * k], self.digits) + 0.0, of[2 * k + 1],
                    NOTES[name],
                )
                for period, of in zip(periods, effect.periods, strict=True)
            ]  # fmt: skip
            self.rows += rows
            amount = round(sum(row.amount for row in rows), self.digits) + 0.0
            self._total(ChangePart(name, "", amount, error, NOTES[name]))
        return effect, tuple(moves)

    def _steps(self, case: StorageCase) -> Iterator[tuple[str, str, StorageCase]]:
        """(name, note, case) of each later cause, on top of those before, where the runs differ."""
        target = self.second.case
        for name, note, model in _models(case.model, target.model):
            case = replace(case, model=model)
            yield name, note, case
        market = case.market, target.market
        names = ("zero_rate", "zero_rate_day")
        if not _equal(*([getattr(x, name) for name in names] for x in market)):
            rates = {name: getattr(target.market, name) for name in names}
            case = replace(case, market=replace(case.market, **rates))
            yield RATE, NOTES[RATE], case
        if not _equal(*((x.contract, x.market, x.day, x.end_day) for x in (case, target))):
            yield CONTRACT, NOTES[CONTRACT], target


def _measured_on(setup: Setup, source: Any) -> Setup:
    problem, old = setup.problem, setup.problem.sources
    sources = Sources(old.training, old.validation, source)
    return setup._replace(problem=replace(problem, sources=sources))


def _models(before: Any, after: Any) -> Iterator[tuple[str, str, Any]]:
    """(name, note, model) of each number of a price model that differs; of another kind, all."""
    if _equal(before, after):
        return
    leaves = [jax.tree.structure(x, is_leaf=_is_input) for x in (before, after)]
    if type(before) is not type(after) or leaves[0] != leaves[1]:
        yield "price model", "all its numbers", after
        return
    old = {x.name: x for x in numbers_in((before,))}
    for entry in sorted(numbers_in((after,)), key=lambda x: x.group != "volatility"):
        if entry.name in old and not _equal(old[entry.name], entry):

            def changed(leaf: Any, entry: CaseInput = entry) -> Any:
                return entry if _is_input(leaf) and leaf.name == entry.name else leaf

            before = jax.tree.map(changed, before, is_leaf=_is_input)
            note = entry.meaning or entry.unit
            yield entry.name.replace("_", " "), note, before
    if not _equal(before, after):
        yield "price model", "its other numbers", after


def _is_input(leaf: Any) -> bool:
    return isinstance(leaf, CaseInput)


def _equal(one: Any, other: Any) -> bool:
    """Whether two records have the same numbers where they are used."""
    if jax.tree.structure(one, is_leaf=_is_input) != jax.tree.structure(other, is_leaf=_is_input):
        return False
    pairs = zip(*(jax.tree.leaves(x, is_leaf=_is_input) for x in (one, other)), strict=True)
    return all(np.array_equal(*(x.used() if _is_input(x) else x for x in pair)) for pair in pairs)


def delivery_periods(case: StorageCase) -> Sequence[DeliveryPeriod]:
    """The traded products of a case, or the months."""
    if case.products is not None:
        rows = case.products.named(-1 if case.products.before else 0)
        return [
            DeliveryPeriod(name or "no product yet", block.first, block.after)
            for name, block in rows
        ]
    months = [day.strftime("%Y-%m") for day in case.days]
    return [
        DeliveryPeriod(
            long_month(month), months.index(month), len(months) - months[::-1].index(month)
        )
        for month in dict.fromkeys(months)
    ]


def _notes(passed: PassedDays) -> Iterator[str]:
    if len(passed.flows) > 1 and any(x.taken != x.planned for x in passed.flows):
        yield (
            f"{len(passed.flows)} days passed: flows other than planned are spread evenly over "
            "them, at the forward prices of the first run; --flows names them"
        )
    elif len(passed.flows) > 1:
        count = len(passed.flows)
        yield f"{count} days passed: their flows are at the forward prices; --flows names others"
