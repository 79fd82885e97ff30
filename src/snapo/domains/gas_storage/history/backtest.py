"""`snapo backtest`: a gas store operated on past prices; each day is decided with the prices up to
that day."""

import datetime
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.engine import Engine, choose
from snapo.problem.carry.save import PolicyFileError
from snapo.problem.carry.save import load as load_policy
from snapo.problem.policy import Policy
from snapo.solver import statistics
from snapo.solver.solution import POLICY
from snapo.solver.tables import write_text

from ..hedges import usual_hedges
from ..hedges.draws import NoForwardCurve, StoreDraws
from ..hedges.exposures import StorePaths
from ..hedges.table import Hedges
from ..ladder.methods import NO_CURVE
from ..ladder.products import usual_products
from ..ladder.rolling import Chains, TradeBlock, rolling
from ..ladder.store import FlatStore
from ..policy.network import StoragePolicy
from ..references.intrinsic import intrinsic
from .hedged import HedgeBook, change_deviation, hedged_results
from .observed import CURVES, ObservedMarket, StepCurves, read_observed
from .recalibrate import ModelHistory
from .report import page
from .results import REPORT, MarkedPosition, StoreBacktest, answer_of, write
from .rule import DatedRule, decided, drawn_spots, end_money, followed, solved_on

FOLDER = "backtest"
STREAM = 261  # of the evaluation: of paths around the curve of a solution
EVERY = 30  # days from one solution to the next one, if the model is never estimated
PATHS = 2048  # of the model, for expectations without curves
KIND = "gas-storage"


def backtest(
    path: Path,
    history: Path,
    progress,
    *,
    every: int | None = None,
    calibrate: str | int | None = None,
    hedge: bool = False,
    policy: Path | None = None,
    out: Path | None = None,
) -> dict[str, Any]:
    """Operates the store of a case on the prices in a folder, and writes the results.

    - `history`: a folder with `spot.csv` and, if there are any, forward curves in `curves.csv`.
    - `every`: the number of days from one solution to the next, each with the curve of its date.
      The default is 30; if the model is estimated again, there are by default solutions only on the
      dates of these estimates. Without curves there is one solution.
    - `calibrate`: when the model is estimated again, as in [backtest]; the other keys of this table
      apply too.
    - `hedge`: trades the hedges of [hedge] on each day with a curve.
    - `policy`: a run whose trained policy decides; by default the fitted value decides, with which
      training begins.
    - `out`: the folder of the tables, by default `backtest` next to the case.

    **Raises:** `CaseError` if the case, a price or the run is wrong; nothing is written.
    """
    file, data = load(path)
    if data.get("kind") != KIND:
        message = f'a back-test is for a case of kind "{KIND}"'
        raise CaseError(str(file), "kind", data.get("kind"), message)
    notes: list[str] = []
    first = solved_on(file, data, None, None, None)
    if first.case.model.calendar:
        message = "a back-test decides each flow on the day of the flow; leave out this key"
        raise CaseError(str(file), "contract.nomination", None, message)
    observed = read_observed(history, first.case.model.lowest, notes)
    if policy is not None:
        first = replace(first, policy=trained_policy(policy, first.policy))
    for note in notes:
        progress(f"note: {note}")
    result = run_backtest(file, data, observed, first, every, progress, calibrate, hedge)
    folder = file.parent / FOLDER if out is None else out
    write(folder, result)
    write_text(folder / REPORT, page(result, first.case, str(history)))
    return answer_of(result) | {"folder": folder}


def trained_policy(run: Path, like: StoragePolicy) -> StoragePolicy:
    """The trained policy of a run, in the shape of `like`.

    **Raises:** `CaseError` if the run has no policy of this shape.
    """
    try:
        policy = load_policy(run / POLICY, Policy, like)
    except (PolicyFileError, OSError) as error:
        message = "this policy does not fit this case"
        raise CaseError(str(run / POLICY), "", None, f"{message} ({error})") from None
    assert isinstance(policy, StoragePolicy)
    return policy


class DrawnHistories(NamedTuple):
    """The results of the rule on histories that its model draws: the total `money` [N] and the
    `cash` [T, N] by day, both discounted. `controls`: arrays [N] with mean zero. `groups` [N]:
    equal for histories that depend on one another; None if all are independent. `paths`: the paths
    of all price factors; None without a forward curve.
    """

    money: np.ndarray
    cash: np.ndarray
    controls: tuple[np.ndarray, ...] = ()
    groups: np.ndarray | None = None
    paths: StorePaths | None = None

    @property
    def band(self) -> tuple[np.ndarray, np.ndarray]:
        """[T] the 5 and 95 % quantiles of the cash so far."""
        low, high = np.quantile(np.cumsum(self.cash, axis=0), (0.05, 0.95), axis=1)
        return low, high

    @property
    def expected(self) -> statistics.Sampled:
        """The mean of the money, with the controls regressed out of it."""
        money, *controls = (statistics.shares(x, self.groups) for x in (self.money, *self.controls))
        return statistics.controlled(money, controls)[2]


def run_backtest(
    file: Path,
    data: Mapping[str, Any],
    observed: ObservedMarket,
    ledger: DatedRule,
    every: int | None,
    progress=lambda text: None,
    calibrate: str | int | None = None,
    hedge: bool = False,
) -> StoreBacktest:
    """The back-test of a case after reading; `ledger`: its rule on the valuation date."""
    case, schedule = ledger.case, ledger.problem.schedule
    days, valuation = case.days, case.valuation_date
    if not days:
        raise CaseError(str(file), "contract.end", case.end, "no decision is left")
    end = observed.spot(min(case.end, observed.spot_days[-1]))
    spots = np.array([*(observed.spot(day) for day in days), end])
    curved = observed.has_curve(valuation)
    plan = case.backtest
    plan = plan if calibrate is None else plan._replace(calibrate=calibrate)
    due = plan.due(days)
    if not curved and (observed.curve_days or due or hedge):
        message = (
            "curves, which estimates of the model and hedges need, must begin on the valuation "
            f"date, {valuation}, or earlier"
        )
        begin = min(observed.curve_days, default=None)
        raise CaseError(str(observed.folder / CURVES), "date", begin, message)
    models = ModelHistory(file, data, observed, plan) if due else None
    curves = StepCurves(observed, valuation, days, case.end, case.has_end_price, spots)
    book = _book(ledger, curves) if hedge else None
    level, rows, marks = np.full(1, float(schedule.constants.inventory)), [], []
    discount, cash = np.asarray(schedule.steps.flow_discount), 0.0
    fixed = float(schedule.constants.fixed_costs)
    every = (len(days) if due else EVERY) if every is None else every
    starts = _starts(len(days), every if curved else len(days), due)
    engine, first = choose("auto", ledger.problem, ledger.policy).evaluate, None
    for start, after in zip(starts, (*starts[1:], len(days)), strict=True):
        date = days[start] if start else valuation
        if models is not None and start in due:
            estimate = models.estimate(date)
            if estimate.reason:
                progress(f"note: {date}: the previous model is used: {estimate.reason}")
        if start:
            progress(f"{date}: solving again")
        tables = data if models is None else models.data
        stored = float(level[0]) if start else None
        rule = _on(file, tables, ledger, observed, date, stored) if curved else ledger
        drawn = _drawn(rule, curved, engine)
        first = first or drawn
        amounts = float(level[0]), cash, float(discount[start]) if start else 1.0
        marks.append(_mark(rule, date, drawn, fixed, *amounts))
        state = rule.initial_factors(1)
        if book is not None:
            if drawn.paths is None:
                raise CaseError(str(file), "model.kind", case.model.kind, NO_CURVE)
            book.solve(start, after, drawn.paths)
            if book.first < 0 and not start:
                book.trade(-1, float(level[0]), state[0])
        for t in range(start, after):
            curve = curves(t) if curved and t in curves.trading else None
            row = decided(rule, t - start, ledger.problem, t, level, state, spots[t : t + 1], curve)
            level, state = row.inventory, row.factors
            cash += float(row.cash[0])
            rows.append(np.concatenate(row[:4]))
            if book is not None:
                book.trade(t, float(level[0]), state[0])
    assert first is not None
    inventory, injection, withdrawal, money = np.array(rows).T
    left = float(end_money(ledger.problem, level, spots[-1:])[0])
    realised = cash + left - fixed
    sums = [(mark.date, mark.cash + mark.expected) for mark in marks]
    return StoreBacktest(
        days,
        spots[:-1],
        inventory,
        injection,
        withdrawal,
        money,
        first.cash.mean(axis=1),
        first.band,
        realised,
        *first.expected[:2],
        float(first.money.std(ddof=1)),
        float(np.mean(first.money < realised)),
        _rolling(ledger, curves) if curved else None,
        tuple(marks),
        change_deviation([*(value for _, value in sums), realised]),
        () if models is None else tuple(models.estimates),
        () if book is None else hedged_results(book, realised, sums),
        () if book is None else tuple(book.days),
        () if book is None else tuple(book.positions),
    )


def _starts(count: int, every: int, due: frozenset[int]) -> tuple[int, ...]:
    """The steps with a solution: `every` days after the last solution, and at every estimate."""
    starts = [0]
    for t in range(1, count):
        if t - starts[-1] >= every or t in due:
            starts.append(t)
    return tuple(starts)


def _book(ledger: DatedRule, curves: StepCurves) -> HedgeBook:
    """The hedges of the case, before they have positions."""
    case, schedule = ledger.case, ledger.problem.schedule
    products = case.products or usual_products(case.days, case.valuation_date)
    hedges = (case.hedges or Hedges(usual_hedges(products.families))).daily
    discount = np.append(schedule.steps.gas_discount, schedule.constants.end_discount)
    return HedgeBook(case, discount, hedges, products, curves, curves.trading)


def _on(
    file: Path,
    data: Mapping[str, Any],
    ledger: DatedRule,
    observed: ObservedMarket,
    day: datetime.date,
    inventory: float | None,
) -> DatedRule:
    """The rule on a date, with the curve that is available on that date."""
    case = ledger.case
    needed = tuple(item for item in case.days if item >= day)
    if case.has_end_price:
        needed = (*needed, case.end)
    curve = observed.curve(day, needed)
    return solved_on(file, data, day, inventory, curve, ledger.policy)


def _drawn(rule: DatedRule, curved: bool, engine: Engine) -> DrawnHistories:
    """The rule on histories that its model draws.

    All price factors can be computed from curves, and a single factor from the spot price.
    Otherwise the rule sees spot prices only, on the simulated histories too.
    """
    problem, seed = rule.problem, rule.case.training.seed
    if rule.filter is not None and (curved or rule.filter.gain.shape[1] == 1):
        draws = StoreDraws(problem, engine.bind(problem), rule.policy, seed)
        try:
            paths, groups, cash, control = draws(STREAM, (rule.case.hedges or Hedges(())).paths)
            money = paths.money - float(problem.schedule.constants.fixed_costs)
            return DrawnHistories(money, cash, (control,), groups, paths)
        except NoForwardCurve:
            pass
    result = followed(rule, drawn_spots(problem, PATHS, seed))
    return DrawnHistories(result.money, result.cash)


def _mark(
    rule: DatedRule,
    day: datetime.date,
    drawn: DrawnHistories,
    fixed: float,
    inventory: float,
    cash: float,
    discount: float,
) -> MarkedPosition:
    """A solution marked to its curve; the rest of the contract is valued on drawn paths. `fixed`:
    the fixed costs of the whole test, which are in every mark, so that their dates move none."""
    later = float(rule.problem.schedule.constants.fixed_costs)
    kind = rule.case.contract.ratchets.interpolation
    plan = intrinsic(jax.tree.map(np.asarray, rule.problem.schedule), kind).value
    mean, error = drawn.expected[:2]
    expected, best = (x * discount - fixed for x in (mean + later, plan))
    return MarkedPosition(day, inventory, cash, expected, error * discount, best)


def _rolling(ledger: DatedRule, curves: StepCurves) -> float:
    """Rolling intrinsic on the curves of the folder, minus fixed costs.

    Forwards are traded on the dates of a curve; on other dates only the day itself, at its spot
    price.
    """
    case, schedule = ledger.case, jax.tree.map(np.asarray, ledger.problem.schedule)
    products = case.products or usual_products(case.days, case.valuation_date)

    def blocks(t: int) -> tuple[TradeBlock, ...]:
        first, *others = products.blocks(t)
        if t in curves.trading:
            return (first, *others)
        return (first, *(block._replace(trades=False) for block in others))

    store = FlatStore(schedule, case.contract.ratchets.interpolation)
    try:
        money = rolling(
            Chains(store), blocks, lambda t: curves(t)[:, None], 1, products.before
        ).money
    except ValueError as error:
        raise CaseError(str(case.file), "products", None, f"rolling intrinsic: {error}") from None
    return float(money[0]) - float(schedule.constants.fixed_costs)
