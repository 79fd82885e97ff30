"""Simulated profit and loss of the contract and its hedge: `snapo solve --hedge`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from snapo.report.missing import why_missing
from snapo.report.page import Block, Text
from snapo.report.quantity import number
from snapo.report.rows import Bar, Column, WithError, ladder, table
from snapo.solver import statistics
from snapo.study.chapter import Chapter, Number
from snapo.study.study import Setup, StudyRun

from ..hedges import as_text, usual_hedges
from ..hedges.draws import NoForwardCurve, StoreDraws, curve_factors
from ..hedges.held import Overnight, by_day
from ..hedges.simulate import DailyHedges, HedgeGains, static
from ..hedges.table import Hedges
from ..ladder.products import usual_products
from ..references.intrinsic import intrinsic
from ..setup import case_of, policy_of
from .run import StorageRun

MEASURED, FITTED = 259, 260  # streams of the evaluation: of the table, and of the exposures
LEVEL = 0.95  # of value at risk
UNHEDGED, PLAN, SOLD = "None", "Today's plan", "Today's deltas"
TEXT = (
    "Cash flow of the contract and of its hedge, both decided without foresight, on the same "
    "simulated paths. Volumes are sold forward after the flow of a day; delivery settles at the "
    "spot price, and each unit traded costs half the bid-offer. The variance not "
    "hedged is the variance with the hedge, divided by the variance without a hedge."
)
BY_PRODUCT = (
    "The remaining share of the variance, first if only the positions in this product are held, "
    "then if all other positions of the hedge are held."
)


@dataclass(frozen=True)
class HedgeRow:
    """The cash flow of the contract with one hedge; every number with its standard error.

    - `value_at_risk`, `expected_shortfall`: the mean minus the 5 % quantile, and the mean minus the
      mean of the paths below this quantile.
    - `not_hedged`: the variance divided by the variance without a hedge; `traded`: the mean volume
      of all trades; `cost`: the present value of the bid-offer paid.
    """

    hedge: str
    products: str
    mean: Number = np.nan
    mean_error: Number = np.nan
    deviation: Number = np.nan
    deviation_error: Number = np.nan
    value_at_risk: Number = np.nan
    value_at_risk_error: Number = np.nan
    expected_shortfall: Number = np.nan
    expected_shortfall_error: Number = np.nan
    not_hedged: Number = np.nan
    traded: Number = np.nan
    cost: Number = np.nan


@dataclass(frozen=True)
class HedgeProduct:
    """One product of a hedge: the share of the variance that is left with this product only, and
    without it; the volume and the cost of its trades."""

    hedge: str
    products: str
    product: str
    single: Number = np.nan
    without: Number = np.nan
    traded: Number = np.nan
    cost: Number = np.nan


@dataclass(frozen=True)
class HedgeTables:
    """All hedges, simulated on `paths` paths; `reason`: the reason if there is none."""

    hedges: tuple[HedgeRow, ...] = ()
    by_product: tuple[HedgeProduct, ...] = ()
    paths: int = 0
    reason: str = ""


class SimulatedHedge(NamedTuple):
    """A hedge with its gains by product."""

    hedge: str
    products: str
    gains: HedgeGains


def measure(run: StudyRun) -> HedgeTables:
    """Simulates all hedges of a store on fresh paths; writes hedge.csv and hedge_products.csv."""
    setup, case = run.setup, case_of(run.setup)
    products = case.products or usual_products(case.days, case.valuation_date)
    hedges = case.hedges or Hedges(usual_hedges(products.families))
    try:
        curve_factors(setup.problem)
        engine, policy = setup.engines.evaluate.bind(setup.problem), policy_of(run.solution)
        draws = StoreDraws(setup.problem, engine, policy, setup.training.seed)
        fit = draws(FITTED, 2 * hedges.paths).paths
        paths, groups = draws(MEASURED, hedges.paths)[:2]
    except NoForwardCurve as reason:
        return HedgeTables(reason=str(reason))
    overnight = Overnight(products)
    first, simulated = overnight.first, [SimulatedHedge(UNHEDGED, "", {})]
    for name, volumes in ((PLAN, planned(setup)), (SOLD, fit.volumes)):
        for form, rows in (
            ("by day", by_day(fit.horizon, first)),
            ("in products", overnight.to_delivery()),
        ):
            gains = static(paths, rows, volumes, first)
            simulated.append(SimulatedHedge(name, form, gains))
    daily = DailyHedges(overnight, hedges.daily).simulated(fit, paths)
    for hedge, gains in zip(hedges.daily, daily, strict=True):
        simulated.append(SimulatedHedge(hedge.title, hedge.products, gains))
    rows = tuple(row_of(hedge, paths.money, groups) for hedge in simulated)
    of_products = tuple(x for hedge in simulated[1:] for x in product_rows(hedge, paths.money))
    for row in rows:
        deviation = statistics.with_error(row.deviation, statistics.half_width(row.deviation_error))
        run.progress(f"hedge: {_title(row)}: standard deviation {deviation}")
    run.write_records("hedge.csv", HedgeRow, rows)
    run.write_records("hedge_products.csv", HedgeProduct, of_products)
    return HedgeTables(rows, of_products, paths.count)


def planned(setup: Setup) -> np.ndarray:
    """[T + 1] the volumes that the intrinsic plan sells."""
    schedule = setup.problem.schedule
    plan = intrinsic(schedule, case_of(setup).contract.ratchets.interpolation)
    steps, net = schedule.steps, plan.net
    sold = -net * np.where(net < 0, 1 - steps.withdrawal_fuel, 1 + steps.injection_fuel)
    return np.append(sold, schedule.constants.end_fraction * plan.inventory[-1])


def row_of(hedge: SimulatedHedge, money: np.ndarray, groups: np.ndarray) -> HedgeRow:
    """The statistics of the money with a hedge."""
    total = money + sum(gain.gain for gain in hedge.gains.values())
    mean, deviation = statistics.mean(total, groups), statistics.deviation(total, groups)
    risk, shortfall = statistics.shortfall(total, LEVEL, groups)
    traded, cost = (
        float(sum(np.mean(getattr(gain, name)) for gain in hedge.gains.values()))
        for name in ("traded", "cost")
    )
    return HedgeRow(
        *(hedge.hedge, hedge.products),
        *(mean.value, mean.standard_error),
        *(deviation.value, deviation.standard_error),
        *(risk.value, risk.standard_error),
        *(shortfall.value, shortfall.standard_error),
        *(_share(total, money), traded, cost),
    )


def product_rows(hedge: SimulatedHedge, money: np.ndarray) -> Iterator[HedgeProduct]:
    """The variances that are left with and without each product of a hedge."""
    total = money + sum(gain.gain for gain in hedge.gains.values())
    for family, (gain, cost, traded) in hedge.gains.items():
        shares = _share(money + gain, money), _share(total - gain, money)
        name = as_text([family])
        about = hedge.hedge, hedge.products, name
        yield HedgeProduct(*about, *shares, float(traded.mean()), float(cost.mean()))


def _share(total: np.ndarray, money: np.ndarray) -> float:
    """The variance of `total`, divided by the variance of the money without a hedge."""
    unhedged = np.var(money)
    return float(np.var(total) / unhedged) if unhedged > 0 else np.nan


def _title(row: HedgeRow) -> str:
    return f"{row.hedge}, {row.products}" if row.products else row.hedge


def show(run: StorageRun, result: HedgeTables) -> Sequence[Block]:
    """Standard deviations as bars, and the tables of all hedges and of their products."""
    if not result.hedges:
        reason = f"No hedge was simulated: {result.reason}."
        return [Text(reason)] if result.reason else [why_missing(run, HEDGE.name)]
    bars = [
        Bar(_title(x), x.deviation, x.deviation_error, strong=x.hedge == UNHEDGED)
        for x in result.hedges
    ]
    caption = (
        f"Standard deviation of contract and hedge on {number(result.paths, 0)} paths; whiskers "
        "are 95 % intervals."
    )
    unit, volume = run.unit, run.volume
    columns = [
        Column("Hedge", "hedge"),
        Column("Products", "products"),
        Column("Mean", _measured("mean"), unit, digits=6),
        Column("Standard deviation", _measured("deviation"), unit),
        Column("Value at risk, 95 %", _measured("value_at_risk"), unit),
        Column("Expected shortfall, 95 %", _measured("expected_shortfall"), unit),
        Column("Variance not hedged", lambda row: 100 * row.not_hedged, "%", decimal_places=1),
        Column("Volume traded", "traded", volume),
        Column("Cost of trading", "cost", unit),
    ]
    product = [
        Column("Hedge", "hedge"),
        Column("Products", "products"),
        Column("Product", "product"),
        Column(
            "Variance left with this product only",
            lambda row: 100 * row.single,
            "%",
            decimal_places=1,
        ),
        Column("Variance left without it", lambda row: 100 * row.without, "%", decimal_places=1),
        Column("Volume traded", "traded", volume),
        Column("Cost of trading", "cost", unit),
    ]
    return [
        Text(TEXT),
        ladder("hedge-deviation", bars, caption),
        table(result.hedges, columns),
        table(result.by_product, product, BY_PRODUCT, folded="By product"),
    ]


def _measured(name: str):
    return lambda row: WithError(getattr(row, name), getattr(row, f"{name}_error"))


HEDGE = Chapter("hedge", "Profit and loss with a hedge", HedgeTables, measure, show, "Hedge",
                key="hedge", optional=True)  # fmt: skip
