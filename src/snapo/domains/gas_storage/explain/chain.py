"""The change of value between two runs, one cause after another, on the same paths.

    V(first run) + time + decisions + curve + volatility + … + policy + rest - cash = V(second)

Each part is a revaluation on top of all parts before it. It uses the exact contract and the policy
of the first run, whose marginal values are adapted to the new numbers; the last step uses the
policy of the second run. Only the rest is computed as a remainder.
"""

import abc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from snapo.case.given import CaseInput
from snapo.case.quantity import numbers_in
from snapo.problem.policy import Policy
from snapo.problem.scenarios import Sources
from snapo.report.quantity import long_month
from snapo.solver import statistics
from snapo.solver.evaluate import path_totals, value_of_groups
from snapo.study.study import ProgressCallback, Setup

from ..ladder.products import TradedProducts
from . import CASH, CONTRACT, FIRST, NOTES, POLICY, RATE, REST, SECOND, TIME
from .change import ChangePart, CurveMove, ExplainedChange, decimals_of
from .curve import CurveEffect, DeliveryPeriod, curve_effect
from .runs import ValuedRun, later_paths


class Started(NamedTuple):
    """The market of the first run on the second date, with the state of the second run.

    - `start` [G]: the shares of groups of paths in the value before the first part on common paths;
      empty if this is the value of the first run.
    - `cash`, `flows`: the cash flow and the volumes of the days between the two dates; `notes`:
      notes for the reader.
    """

    start: np.ndarray
    setup: Setup
    cash: float = 0.0
    flows: tuple[Any, ...] = ()
    notes: tuple[str, ...] = ()


class CurveChange(NamedTuple):
    """The forward prices [T] of a market in both runs; `input`: the name of their input; `market`:
    the name of the market, "" if there is only one."""

    input: str
    market: str
    old: np.ndarray
    new: np.ndarray


class ChangeChain(abc.ABC):
    """Revaluations from the first run to the second one.

    - `setup`: the setup of the second run; `at`: the function `setup_at` of the domain.
    """

    at: Callable[[Setup, Any], Setup]

    def __init__(
        self, first: ValuedRun, second: ValuedRun, progress: ProgressCallback, setup: Setup
    ):
        self.first, self.second, self.progress, self.setup = first, second, progress, setup
        self.policy, self.last_policy = self.policies()
        self.rows: list[ChangePart] = []
        self.totals: list[ChangePart] = []
        self.digits = decimals_of(max(abs(first.value), abs(second.value)))
        self.source = setup.problem.sources.evaluation

    @abc.abstractmethod
    def policies(self) -> tuple[Policy, Policy]:
        """The policies of both runs, in the shape of the policy of the second run."""

    @abc.abstractmethod
    def started(self) -> Started:
        """The parts before the curve."""

    @abc.abstractmethod
    def moved(self, case: Any) -> tuple[Any, Sequence[CurveChange]]:
        """The case with the forward prices of the second run, and both curves of each market."""

    @abc.abstractmethod
    def terms(self, case: Any) -> tuple[Any, ...]:
        """All numbers and dates of a case, except those of its price model."""

    def result(self) -> ExplainedChange:
        first, second, case = self.first, self.second, self.second.case
        opening = self.started()
        moved, curves = self.moved(opening.setup.case)
        setup = self.setup_of(moved, opening.setup)
        effect, moves = self._curve(opening.setup, setup, curves)
        shares = effect.after
        for name, note, step in self._steps(setup.case):
            setup = self.setup_of(step, setup)
            shares = self.add(name, note, shares, self.shares(setup, self.policy))
        last = self.shares(setup, self.last_policy)
        self.add(POLICY, NOTES[POLICY], shares, last)
        cash = round(opening.cash, self.digits)
        unpaired = (*self._unpaired(opening.start, first), *self._unpaired(last, second))
        errors = [effect.error, *unpaired]
        change = round(second.value - first.value, self.digits)
        left = round(change + cash - sum(row.amount for row in self.rows), self.digits)
        self.row(REST, left, float(statistics.independent(*errors)), NOTES[REST])
        if opening.flows or cash:
            self.row(CASH, -cash, None, NOTES[CASH])
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
            opening.flows,
            self.digits,
            self.source.available(second.case.evaluation.paths),
            opening.notes,
        )

    def time(self, setup: Setup, passed: int, cash: float) -> tuple[np.ndarray, Setup]:
        """Adds the part for the step to a later date. `setup` is the contract of the first run on
        that date, in the planned state, and `cash` is the planned cash flow of the steps that have
        `passed`. Returns the shares of the value on that date, and the setup on the paths of the
        parts."""
        first, case = self.first, self.first.case
        same = (case.evaluation, case.training.seed) == (
            self.second.case.evaluation, self.second.case.training.seed,
        )  # fmt: skip
        earlier = self.simulator_of(case)
        source = later_paths(self.source, earlier, setup.problem.simulator, passed)
        if same and source is not None:
            self.source = source
            setup = measured_on(setup, source)
        start = self.shares(setup, self.policy)
        before = self._paired(first, len(start))
        if before is None:
            total = statistics.of_shares(start)
            error = float(statistics.independent(first.error, total.standard_error))
            amount = total.value - first.value
        else:
            total = statistics.of_shares(start - before)
            amount, error = total.value, total.standard_error
        self.row(TIME, amount + cash, error, NOTES[TIME])
        return start, setup

    @abc.abstractmethod
    def simulator_of(self, case: Any) -> Any:
        """The simulator of a case."""

    def _paired(self, run: ValuedRun, count: int) -> np.ndarray | None:
        """The shares of groups in the value of the first run, if it is on the paths of the parts;
        otherwise None."""
        common = self.source is not self.setup.problem.sources.evaluation
        if not common or run.shares is None or len(run.shares) != count:
            return None
        return run.shares if np.isclose(run.shares.mean(), run.value, rtol=1e-6) else None

    def _unpaired(self, shares: np.ndarray, run: ValuedRun) -> Iterator[float]:
        """The errors of a reported value and of the same value here, if the two are on different
        paths."""
        if len(shares) and not np.isclose(shares.mean(), run.value, rtol=1e-9):
            yield run.error
            yield statistics.of_shares(shares).standard_error

    def setup_of(self, case: Any, setup: Setup) -> Setup:
        """The setup of a case, on the paths of the parts."""
        if case is setup.case:
            return setup
        return measured_on(type(self).at(setup, case), self.source)

    def shares(self, setup: Setup, policy: Policy) -> np.ndarray:
        """[G] the shares of groups of paths in the value."""
        problem = setup.problem
        totals = path_totals(
            problem, policy, self.setup.evaluation.paths, engine=setup.engines.evaluate
        )
        values = problem.objective, totals, problem.sources.evaluation
        return value_of_groups(*values, problem.simulator.control_variates())

    def add(self, name: str, note: str, before: np.ndarray, now: np.ndarray) -> np.ndarray:
        """Adds a part, the difference of two values; returns the later value."""
        step = statistics.of_shares(now - before)
        self.row(name, step.value, step.standard_error, note)
        return now

    def row(self, name: str, amount: float, error: float | None, note: str) -> None:
        """Adds a part with its amount, error and note."""
        row = ChangePart(name, "", round(amount, self.digits) + 0.0, error, note)
        self.rows.append(row)
        self._total(row)

    def _total(self, row: ChangePart) -> None:
        self.totals.append(row)
        self.progress(f"{row.part}: {row.amount:,.{self.digits}f}")

    def _curve(
        self, before: Setup, after: Setup, curves: Sequence[CurveChange]
    ) -> tuple[CurveEffect, tuple[CurveMove, ...]]:
        case = self.second.case
        periods = self.periods()
        names = [curve.input for curve in curves]
        effect = curve_effect(before, after, self.policy, periods, names)
        moves = []
        for k, of in enumerate(effect.periods):
            curve, period = curves[k // len(periods)], periods[k % len(periods)]
            last = len(curve.new) if period.after == len(case.days) else period.after
            move = float(np.mean((curve.new - curve.old)[period.first : last]))
            delta = of.first / move if move else None
            name = f"{curve.market} {period.name}".strip()
            days = {f"{day:%Y-%m-%d}" for day in case.days[period.first : period.after]}
            moves.append(CurveMove(name, len(days), move, delta))
        errors = effect.total.first_error, effect.total.second_error
        for k, (name, error) in enumerate(zip((FIRST, SECOND), errors)):
            rows = [
                ChangePart(
                    name, move.period, round(of[2 * k], self.digits) + 0.0, of[2 * k + 1],
                    NOTES[name],
                )
                for move, of in zip(moves, effect.periods, strict=True)
            ]  # fmt: skip
            self.rows += rows
            amount = round(sum(row.amount for row in rows), self.digits) + 0.0
            self._total(ChangePart(name, "", amount, error, NOTES[name]))
        return effect, tuple(moves)

    def with_model(self, case: Any, model: Any) -> Any:
        """The case with this price model."""
        return replace(case, model=model)

    def periods(self) -> Sequence[DeliveryPeriod]:
        """The delivery periods into which the move of the curve is split."""
        case = self.second.case
        return delivery_periods(case.days, case.products)

    def _steps(self, case: Any) -> Iterator[tuple[str, str, Any]]:
        """(name, note, case) of each later cause in which the runs differ, on top of the causes
        before it."""
        target = self.second.case
        for name, note, model in models_between(case.model, target.model):
            case = self.with_model(case, model)
            yield name, note, case
        market = case.market, target.market
        names = ("zero_rate", "zero_rate_day")
        if not equal(*([getattr(x, name) for name in names] for x in market)):
            rates = {name: getattr(target.market, name) for name in names}
            case = replace(case, market=replace(case.market, **rates))
            yield RATE, NOTES[RATE], case
        if not equal(*map(self.terms, (case, target))):
            yield CONTRACT, NOTES[CONTRACT], target


def measured_on(setup: Setup, source: Any) -> Setup:
    """The setup with these scenarios for the evaluation."""
    problem, old = setup.problem, setup.problem.sources
    sources = Sources(old.training, old.validation, source)
    return setup._replace(problem=replace(problem, sources=sources))


def models_between(before: Any, after: Any) -> Iterator[tuple[str, str, Any]]:
    """(name, note, model) of each number of a price model that differs; one entry for all if the
    kind differs."""
    if equal(before, after):
        return
    leaves = [jax.tree.structure(x, is_leaf=is_input) for x in (before, after)]
    if type(before) is not type(after) or leaves[0] != leaves[1]:
        yield "price model", "all its numbers", after
        return
    old = {x.name: x for x in numbers_in((before,))}
    for entry in sorted(numbers_in((after,)), key=lambda x: x.group != "volatility"):
        if entry.name in old and not equal(old[entry.name], entry):
            before = with_numbers(before, {entry.name: entry})
            note = entry.meaning or entry.unit
            yield entry.name.replace("_", " "), note, before
    if not equal(before, after):
        yield "price model", "its other numbers", after


def with_numbers(tree: Any, numbers: dict[str, CaseInput]) -> Any:
    """A record in which the numbers with these names are replaced."""

    def changed(leaf: Any) -> Any:
        return numbers.get(leaf.name, leaf) if is_input(leaf) else leaf

    return jax.tree.map(changed, tree, is_leaf=is_input)


def is_input(leaf: Any) -> bool:
    """Whether a leaf of a record has numbers of the case."""
    return isinstance(leaf, CaseInput)


def equal(one: Any, other: Any) -> bool:
    """Whether two records have the same numbers in the form in which they are used."""
    if jax.tree.structure(one, is_leaf=is_input) != jax.tree.structure(other, is_leaf=is_input):
        return False
    pairs = zip(*(jax.tree.leaves(x, is_leaf=is_input) for x in (one, other)), strict=True)
    return all(np.array_equal(*(x.used() if is_input(x) else x for x in pair)) for pair in pairs)


def delivery_periods(
    days: Sequence[Any], products: TradedProducts | None
) -> Sequence[DeliveryPeriod]:
    """The traded products, or the months, of the decision days. `days` [T]: the dates of the steps;
    each day of delivery of the products has the same number of steps."""
    if products is not None:
        steps = len(days) // len(products.days)
        rows = products.named(-1 if products.before else 0)
        return [
            DeliveryPeriod(name or "no product yet", block.first * steps, block.after * steps)
            for name, block in rows
        ]
    months = [day.strftime("%Y-%m") for day in days]
    return [
        DeliveryPeriod(
            long_month(month), months.index(month), len(months) - months[::-1].index(month)
        )
        for month in dict.fromkeys(months)
    ]
