"""`snapo backtest`: a gas store decided on past prices, each day with the prices until then."""

import datetime
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.problem.carry.save import PolicyFileError
from snapo.problem.carry.save import load as load_policy
from snapo.problem.policy import Policy
from snapo.solver.solution import POLICY
from snapo.solver.statistics import plus_minus
from snapo.solver.tables import write_csv

from ..ladder.products import usual_products
from ..ladder.rolling import Chains, TradeBlock, rolling
from ..ladder.store import FlatStore
from ..policy.network import StoragePolicy
from ..references.intrinsic import intrinsic
from .observed import ObservedMarket, read_observed
from .rule import DatedRule, RuleCash, decided, drawn_spots, end_money, followed, solved_on

FOLDER, DAYS, SOLUTIONS = "backtest", "days.csv", "solutions.csv"
EVERY = 30  # days from one solution to the next one
PATHS = 2048  # of the model, for expectations
KIND = "gas-storage"


@dataclass(frozen=True)
class MarkedPosition:
    """A solution, and the position marked to the curve of its date.

    - `date`, `inventory`; `cash`: realised so far, discounted to the first valuation date.
    - `expected`, `standard_error`: of the money of the rest of the contract, on paths of the model
      around the curve of the date; `intrinsic`: by the best fixed plan; all discounted to the
      same date.
    """

    date: datetime.date
    inventory: float
    cash: float
    expected: float
    standard_error: float
    intrinsic: float


@dataclass(frozen=True, eq=False)
class StoreBacktest:
    """The result of a back-test over T days; money is discounted to the valuation date.

    - `days`; `spots`, `inventory` (after each day), `injection`, `withdrawal`, `cash` [T];
      `expected_cash` [T]: the mean on the first valuation date.
    - `realised`: the sum of the cash, the value of the gas left, and fixed costs.
    - `expected`, `error`: its mean on `PATHS` drawn histories of the model and the standard error;
      `deviation`: of one history; `share`: of histories that bring less than the realised one.
    - `rolling`: of rolling intrinsic on the same curves; None without curves.
    - `marks`: of every solution.
    """

    days: tuple[datetime.date, ...]
    spots: np.ndarray
    inventory: np.ndarray
    injection: np.ndarray
    withdrawal: np.ndarray
    cash: np.ndarray
    expected_cash: np.ndarray
    realised: float
    expected: float
    error: float
    deviation: float
    share: float
    rolling: float | None
    marks: tuple[MarkedPosition, ...]


def backtest(
    path: Path,
    history: Path,
    progress,
    *,
    every: int = EVERY,
    policy: Path | None = None,
    out: Path | None = None,
) -> dict[str, Any]:
    """Decides the store of a case on the prices in a folder, and writes the results.

    - `history`: a folder with `spot.csv` and, if there are any, forward curves in `curves.csv`.
    - `every`: days from one solution to the next, with the curve of its date; without curves
      there is one solution.
    - `policy`: a run, whose trained policy decides; by default the fitted value, with which
      training begins.
    - `out`: the folder of `days.csv` and `solutions.csv`, by default `backtest` next to the case.

    **Raises:** `CaseError` where the case, a price or the run is wrong; nothing is written.
    """
    file, data = load(path)
    if data.get("kind") != KIND:
        message = f'a back-test is for a case of kind "{KIND}"'
        raise CaseError(str(file), "kind", data.get("kind"), message)
    notes: list[str] = []
    first = solved_on(file, data, None, None, None)
    if first.case.model.calendar:
        message = "a back-test decides each flow on its own day; leave it out"
        raise CaseError(str(file), "contract.nomination", None, message)
    observed = read_observed(history, first.case.model.proportional, notes)
    if policy is not None:
        first = replace(first, policy=trained_policy(policy, first.policy))
    for note in notes:
        progress(f"note: {note}")
    result = run_backtest(file, data, observed, first, every, progress)
    folder = file.parent / FOLDER if out is None else out
    _write(folder, result)
    return _answer(result) | {"folder": folder}


def trained_policy(run: Path, like: StoragePolicy) -> StoragePolicy:
    """The trained policy of a run, of the shape of `like`.

    **Raises:** `CaseError` where the run has none of this shape.
    """
    try:
        policy = load_policy(run / POLICY, Policy, like)
    except (PolicyFileError, OSError) as error:
        message = "this is not a policy of this case"
        raise CaseError(str(run / POLICY), "", None, f"{message} ({error})") from None
    assert isinstance(policy, StoragePolicy)
    return policy


def run_backtest(
    file: Path,
    data: Mapping[str, Any],
    observed: ObservedMarket,
    ledger: DatedRule,
    every: int,
    progress=lambda text: None,
) -> StoreBacktest:
    """The back-test of a case that was read; `ledger`: its rule on the valuation date."""
    days, valuation = ledger.case.days, ledger.case.valuation_date
    if not days:
        raise CaseError(str(file), "contract.end", ledger.case.end, "no day is left to decide")
    spots = np.array([observed.spot(day) for day in days])
    curved = observed.has_curve(valuation)
    rule = _on(file, data, ledger, observed, valuation, None) if curved else ledger
    drawn = _drawn(rule)
    schedule = ledger.problem.schedule
    level, rows, marks, started = np.full(1, float(schedule.constants.inventory)), [], [], 0
    discount = np.asarray(schedule.steps.flow_discount)
    cash, state = 0.0, rule.initial_factors(1)
    for t, day in enumerate(days):
        if t and curved and t - started >= every:
            progress(f"{day}: solving again")
            rule, started = _on(file, data, ledger, observed, day, float(level[0])), t
            state = rule.initial_factors(1)
        if t == started:
            money = _drawn(rule).money if t else drawn.money
            amounts = float(level[0]), cash, float(discount[t]) if t else 1.0
            marks.append(_mark(rule, day, money, *amounts))
        row = decided(rule, t - started, ledger.problem, t, level, state, spots[t : t + 1])
        level, state = row.inventory, row.factors
        cash += float(row.cash[0])
        rows.append(np.concatenate(row[:4]))
    inventory, injection, withdrawal, money = np.array(rows).T
    end = observed.spot(min(ledger.case.end, observed.spot_days[-1]))
    left = float(end_money(ledger.problem, level, np.array([end]))[0])
    realised = cash + left - float(schedule.constants.fixed_costs)
    return StoreBacktest(
        days,
        spots,
        inventory,
        injection,
        withdrawal,
        money,
        drawn.cash.mean(axis=1),
        realised,
        float(drawn.money.mean()),
        float(drawn.money.std(ddof=1) / np.sqrt(PATHS)),
        float(drawn.money.std(ddof=1)),
        float(np.mean(drawn.money < realised)),
        _rolling(ledger, observed, spots, end) if curved else None,
        tuple(marks),
    )


def _on(
    file: Path,
    data: Mapping[str, Any],
    ledger: DatedRule,
    observed: ObservedMarket,
    day: datetime.date,
    inventory: float | None,
) -> DatedRule:
    """The rule on a date, with the curve known then."""
    case = ledger.case
    needed = tuple(item for item in case.days if item >= day)
    if case.has_end_price:
        needed = (*needed, case.end)
    curve = observed.curve(day, needed)
    return solved_on(file, data, day, inventory, curve, ledger.policy)


def _drawn(rule: DatedRule) -> RuleCash:
    """The rule on histories that its model draws."""
    return followed(rule, drawn_spots(rule.problem, PATHS, rule.case.training.seed))


def _mark(
    rule: DatedRule,
    day: datetime.date,
    money: np.ndarray,
    inventory: float,
    cash: float,
    discount: float,
) -> MarkedPosition:
    """A solution marked to its curve; `money` [N]: of the rest of the contract on drawn paths."""
    fixed = float(rule.problem.schedule.constants.fixed_costs)
    error = float(money.std(ddof=1) / np.sqrt(PATHS))
    kind = rule.case.contract.ratchets.interpolation
    plan = intrinsic(jax.tree.map(np.asarray, rule.problem.schedule), kind).value
    mean = float(money.mean()) + fixed
    return MarkedPosition(day, inventory, cash, *(x * discount for x in (mean, error, plan)))


def _rolling(ledger: DatedRule, observed: ObservedMarket, spots: np.ndarray, end: float) -> float:
    """Rolling intrinsic on the curves of the folder, less fixed costs.

    Forwards trade on the dates of a curve; on others only the day itself, at its spot price.
    """
    case, schedule = ledger.case, jax.tree.map(np.asarray, ledger.problem.schedule)
    dates = (*case.days, case.end)
    priced = len(dates) if case.has_end_price else len(case.days)
    products = case.products or usual_products(case.days, case.valuation_date)

    def day(t: int) -> datetime.date:
        return case.valuation_date if t < 0 else case.days[t]

    def curves(t: int) -> np.ndarray:
        if t == len(case.days):
            return np.array([[end]])
        curve = observed.curve(day(t), dates[max(t, 0) : priced])
        curve = curve if priced == len(dates) else np.append(curve, curve[-1])
        if t >= 0:
            curve[0] = spots[t]
        return curve[:, None]

    def blocks(t: int) -> tuple[TradeBlock, ...]:
        first, *others = products.blocks(t)
        if day(t) in observed.curves:
            return (first, *others)
        return (first, *(block._replace(trades=False) for block in others))

    store = FlatStore(schedule, case.contract.ratchets.interpolation)
    try:
        money = rolling(Chains(store), blocks, curves, 1, products.before).money
    except ValueError as error:
        raise CaseError(str(case.file), "products", None, f"rolling intrinsic: {error}") from None
    return float(money[0]) - float(schedule.constants.fixed_costs)


def _write(folder: Path, result: StoreBacktest) -> None:
    head = (
        "date", "spot", "inventory", "injection", "withdrawal", "cash", "cash_so_far",
        "expected_so_far",
    )  # fmt: skip
    columns = (
        result.days,
        result.spots,
        result.inventory,
        result.injection,
        result.withdrawal,
        result.cash,
        np.cumsum(result.cash),
        np.cumsum(result.expected_cash),
    )
    names = ("date", "inventory", "cash_so_far", "expected", "standard_error", "intrinsic")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_csv(folder / DAYS, head, zip(*columns))
        write_csv(folder / SOLUTIONS, names, map(astuple, result.marks))
    except OSError as error:
        message = f"the folder cannot be written ({error.strerror})"
        raise CaseError(str(folder), "", None, message) from None


def _answer(result: StoreBacktest) -> dict[str, Any]:
    return {
        "status": "ok",
        "first": result.days[0].isoformat(),
        "last": result.days[-1].isoformat(),
        "days": len(result.days),
        "realised": result.realised,
        "expected": result.expected,
        "standard_error": result.error,
        "deviation": result.deviation,
        "share": result.share,
        "rolling_intrinsic": result.rolling,
        "intrinsic": result.marks[0].intrinsic,
        "solutions": [asdict(mark) | {"date": mark.date.isoformat()} for mark in result.marks],
    }


def summary(answer: Mapping[str, Any]) -> str:
    """The answer for a reader."""
    return "\n".join(_lines(answer))


def _lines(answer: Mapping[str, Any]) -> Iterator[str]:
    yield f"{answer['days']} days from {answer['first']} to {answer['last']}"
    less = f"{answer['share']:.0%} of drawn histories bring less"
    yield f"{'realised':<20}{answer['realised']:>16,.2f}   {less}"
    interval = plus_minus(answer["standard_error"])
    spread = f"{interval} (95 %); standard deviation of one history {answer['deviation']:,.2f}"
    yield f"{'expected':<20}{answer['expected']:>16,.2f}   {spread}"
    if answer["rolling_intrinsic"] is not None:
        yield f"{'rolling intrinsic':<20}{answer['rolling_intrinsic']:>16,.2f}"
    yield f"{'intrinsic at start':<20}{answer['intrinsic']:>16,.2f}"
    yield from _table(answer["solutions"])
    yield f"by day: {answer['folder'] / DAYS}"


def _table(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield f"{'solved on':<12}{'inventory':>14}{'cash so far':>16}{'expected rest':>16}{'sum':>16}"
    for row in rows:
        numbers = (row["cash"], row["expected"], row["cash"] + row["expected"])
        text = "".join(f"{x:>16,.2f}" for x in numbers)
        yield f"{row['date']:<12}{row['inventory']:>14,.2f}{text}"
