"""Gamma by pair of products or delivery months: `snapo solve --gamma`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.simulator import Schedule
from snapo.report.bands import heat
from snapo.report.drawing import draw
from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Chart, Text
from snapo.report.quantity import decimals, number
from snapo.report.rows import Column, WithError, table
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..contract.schedule import of_prices
from ..explain.chain import delivery_periods
from ..explain.curve import DeliveryPeriod
from ..hedges.gamma import ProductMove, gamma_matrix
from ..setup import case_of

FILE = "gamma.csv"
TEXT = (
    "Change of the delta of one product if the price of another one rises by 1 on all its days, "
    "with the decisions that are then the best. The diagonal is the change of a delta with its own "
    "price: by so much a hedge has to be adjusted. Each number is the mean of two estimates, from "
    "a bump of either product."
)
SCALED = (
    "The last column of the table by product is the change of each delta if all prices rise by "
    "1 %. Without costs and fixed strikes it is zero: prices and value then rise in proportion."
)
MOST = 16  # products in a map


@dataclass(frozen=True)
class GammaProduct:
    """A product, or a delivery month.

    - `first`, `last`: days of delivery within the contract; `price`: mean forward price; `bump`.
    - `gamma`, `standard_error`: on the diagonal. `scaled`: change of the delta if all prices rise
      by 1 %, with `scaled_error`.
    """

    product: str
    first: str
    last: str
    price: Number = np.nan
    bump: Number = np.nan
    gamma: Number = np.nan
    standard_error: Number = np.nan
    scaled: Number = np.nan
    scaled_error: Number = np.nan


@dataclass(frozen=True)
class GammaPair:
    """The second derivative with respect to the prices of two products, discounted.

    - `standard_error`: of sampling, with the bias of the bump; `policy`: half of the difference of
      both estimates beyond its sampling error, by which the policy may be wrong.
    """

    product: str
    other: str
    gamma: Number = np.nan
    standard_error: Number = np.nan
    policy: Number = np.nan


@dataclass(frozen=True)
class ProductGammas:
    """The products in the order of delivery, and each pair of them once; on `paths` paths."""

    products: tuple[GammaProduct, ...] = ()
    pairs: tuple[GammaPair, ...] = ()
    paths: int = 0


def moves_of(
    periods: Sequence[DeliveryPeriod], curve: CaseInput, steps_a_day: int = 1
) -> list[ProductMove]:
    """A rise of the price of each period; `steps_a_day`: steps of the simulator for each of the
    period's days."""
    place, prices, moves = np.asarray(curve.index)[::steps_a_day], curve.used()[::steps_a_day], []
    for name, first, after in periods:
        along = np.zeros(len(curve.values))
        along[place[first:after]] = 1.0
        steps = slice(first * steps_a_day, after * steps_a_day)
        moves.append(ProductMove(name, along, steps, float(prices[first:after].mean())))
    return moves


def gamma_by_product(
    run: StudyRun,
    periods: Sequence[DeliveryPeriod],
    days: Sequence[Any],
    curve: CaseInput,
    prices: Schedule,
    steps_a_day: int = 1,
) -> ProductGammas:
    """The gammas of a run whose deliveries are on `days`; writes gamma.csv.

    `prices`: the schedule of the price process.
    """
    setup, policy = run.setup, run.solution.policy
    if policy is None:
        return ProductGammas()
    moves, engine = moves_of(periods, curve, steps_a_day), setup.engines.evaluate
    problem, paths = setup.problem, setup.evaluation.sensitivity_paths
    of = gamma_matrix(problem, policy, curve.name, moves, prices, engine, paths, run.progress)
    gamma, error, policy_error = of.symmetric.value, of.standard_error, of.policy
    scaled = [0.01 * x for x in of.along(np.array([move.price for move in moves]))]
    products, pairs = [], []
    for i, (name, first, after) in enumerate(periods):
        start, end = (str(days[k])[:10] for k in (first, after - 1))
        numbers = moves[i].price, of.bumps[i], gamma[i, i], error[i, i], *(x[i] for x in scaled)
        products.append(GammaProduct(name, start, end, *map(float, numbers)))
        for j in range(i, len(periods)):
            numbers = (float(x[i, j]) for x in (gamma, error, policy_error))
            pairs.append(GammaPair(name, periods[j].name, *numbers))
    run.write_records(FILE, GammaPair, pairs)
    available = problem.sources.evaluation.available(paths)
    return ProductGammas(tuple(products), tuple(pairs), available)


def measure(run: StudyRun) -> ProductGammas:
    """The gammas of a store."""
    case, schedule = case_of(run.setup), run.setup.problem.schedule
    periods = delivery_periods(case.days, case.products)
    return gamma_by_product(run, periods, case.days, case.market.forward_curve, of_prices(schedule))


def show(run: RunFiles, result: ProductGammas) -> Sequence[Block]:
    """A map of all pairs, a table by product, and one of all pairs."""
    products, pairs = result.products, result.pairs
    if not products:
        return [why_missing(run, GAMMA.name)]
    unit = _unit(run)
    columns = [
        Column("Product", "product"),
        Column("Delivery", lambda x: f"{x.first} to {x.last}"),
        Column("Price", "price", digits=4),
        Column("Bump", "bump", digits=3),
        Column("Gamma", lambda x: WithError(x.gamma, x.standard_error), unit),
        Column("All prices 1 % up", lambda x: WithError(x.scaled, x.scaled_error),
               str(run.get("volume_unit", ""))),
    ]  # fmt: skip
    of_pairs = [
        Column("Product", "product"),
        Column("Other", "other"),
        Column("Gamma", lambda x: WithError(x.gamma, x.standard_error), unit),
        Column("± policy", "policy", unit, digits=2),
    ]
    caption = f"On {number(result.paths, 0)} paths; ± is half of a 95 % interval."
    blocks: list[Block] = [Text(TEXT)]
    blocks += [_map(products, pairs, unit)] if 1 < len(products) <= MOST else []
    blocks += [table(products, columns, caption), Text(SCALED, caveat=True)]
    folded = f"All {len(pairs)} pairs, with their errors"
    return [*blocks, table(pairs, of_pairs, folded=folded)]


def _unit(run: RunFiles) -> str:
    volume, currency = run.get("volume_unit", ""), run.get("currency", "")
    return f"{volume} per {currency}/{volume}" if volume and currency else ""


def _map(products: Sequence[GammaProduct], pairs: Sequence[GammaPair], unit: str) -> Chart:
    names = [x.product for x in products]
    grid = np.zeros((len(names), len(names)))
    for pair in pairs:
        i, j = names.index(pair.product), names.index(pair.other)
        grid[i, j] = grid[j, i] = pair.gamma
    digits = decimals(grid.ravel().tolist(), 3)
    svg = draw(
        "gamma",
        "Map of gamma by pair of products, the first product at the top.",
        lambda axes: heat(axes, grid[::-1], names, names[::-1], unit, lambda x: number(x, digits)),
        60.0 + 22 * len(names),
    )
    return Chart(svg, "Gamma by pair of products: positive in one colour, negative in the other.")


GAMMA = Chapter("gamma", "Gamma by pair of products", ProductGammas, measure, show, "Gamma",
                key="gamma", optional=True)  # fmt: skip
