"""Gamma by pair of products or delivery months: `snapo solve --gamma`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

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
from ..contract.simulator import simulator_of
from ..explain.chain import delivery_periods
from ..hedges.gamma import PriceRise, gamma_matrix, price_rises
from ..setup import case_of

FILE = "gamma.csv"
TEXT = (
    "Change of the delta of one product if the price of another one rises by 1 on all its days, "
    "with the decisions that are best at the new prices. The diagonal is the change of a "
    "delta if its own price rises: this is the amount by which a hedge has to be adjusted. Each "
    "number is the mean of two estimates, one from a bump of each of the two products."
)
SCALED = (
    "The last column of the table by product is the change of each delta if all prices rise by "
    "1 %. Without costs and fixed strikes it is zero: prices and value then rise in proportion."
)
MAX_PRODUCTS = 16  # products in a map


@dataclass(frozen=True)
class GammaProduct:
    """A product, or a delivery month.

    - `first`, `last`: days of delivery within the contract; `price`: mean forward price; `bump`:
      the bump of the price.
    - `gamma`, `standard_error`: the diagonal element and its error. `scaled`: the change of the
      delta if all prices rise by 1 %, with the error `scaled_error`.
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

    - `standard_error`: the sampling error, increased by the bias of the bump; `policy`: half of the
      difference between the two estimates, beyond its sampling error; the error of the policy may
      cause it.
    """

    product: str
    other: str
    gamma: Number = np.nan
    standard_error: Number = np.nan
    policy: Number = np.nan


@dataclass(frozen=True)
class ProductGammas:
    """The products in the order of delivery, and each pair of them once; estimated on `paths`
    paths."""

    products: tuple[GammaProduct, ...] = ()
    pairs: tuple[GammaPair, ...] = ()
    paths: int = 0
    volume_unit: str = ""
    currency: str = ""

    @property
    def unit(self) -> str:
        """The unit of a second derivative."""
        return f"{self.volume_unit} per {self.currency}/{self.volume_unit}"


class EnergyUnits(Protocol):
    """The units of a case."""

    @property
    def volume_unit(self) -> str: ...

    @property
    def currency(self) -> str: ...


def gamma_by_product(
    run: StudyRun, case: EnergyUnits, rises: Sequence[PriceRise], curve: str, prices: Schedule
) -> ProductGammas:
    """The gammas of a run; writes gamma.csv.

    `curve`: the input of the forward prices; `prices`: the schedule of the price process.
    """
    setup, policy = run.setup, run.solution.policy
    if policy is None:
        return ProductGammas()
    problem, engine, paths = (
        setup.problem,
        setup.engines.evaluate,
        setup.evaluation.sensitivity_paths,
    )
    of = gamma_matrix(problem, policy, curve, rises, prices, engine, paths, run.progress)
    gamma, error, policy_error = of.symmetric.value, of.standard_error, of.policy
    scaled = [0.01 * x for x in of.along(np.array([rise.price for rise in rises]))]
    products, pairs = [], []
    for i, rise in enumerate(rises):
        numbers = rise.price, of.bumps[i], gamma[i, i], error[i, i], *(x[i] for x in scaled)
        products.append(GammaProduct(rise.name, *rise.dates, *map(float, numbers)))
        for j in range(i, len(rises)):
            numbers = (float(x[i, j]) for x in (gamma, error, policy_error))
            pairs.append(GammaPair(rise.name, rises[j].name, *numbers))
    run.write_records(FILE, GammaPair, pairs)
    available = problem.sources.evaluation.available(paths)
    units = case.volume_unit, case.currency
    return ProductGammas(tuple(products), tuple(pairs), available, *units)


def measure(run: StudyRun) -> ProductGammas:
    """The gammas of a store."""
    case, problem = case_of(run.setup), run.setup.problem
    curve = simulator_of(problem).curve
    values = problem.inputs_by_name[curve.name].value
    rises = price_rises(delivery_periods(case.days, case.products), case.days, curve, values)
    return gamma_by_product(run, case, rises, curve.name, of_prices(problem.schedule))


def show(run: RunFiles, result: ProductGammas) -> Sequence[Block]:
    """A map of all pairs, a table by product, and a table of all pairs."""
    products, pairs = result.products, result.pairs
    if not products:
        return [why_missing(run, GAMMA.name)]
    unit = result.unit
    columns = [
        Column("Product", "product"),
        Column("Delivery", lambda x: f"{x.first} to {x.last}"),
        Column("Price", "price", digits=4),
        Column("Bump", "bump", digits=3),
        Column("Gamma", lambda x: WithError(x.gamma, x.standard_error), unit),
        Column("All prices + 1 %", lambda x: WithError(x.scaled, x.scaled_error),
               result.volume_unit),
    ]  # fmt: skip
    of_pairs = [
        Column("Product", "product"),
        Column("Other", "other"),
        Column("Gamma", lambda x: WithError(x.gamma, x.standard_error), unit),
        Column("± policy", "policy", unit, digits=2),
    ]
    caption = f"On {number(result.paths, 0)} paths; ± is half of a 95 % interval."
    blocks: list[Block] = [Text(TEXT)]
    blocks += [_map(products, pairs, unit)] if 1 < len(products) <= MAX_PRODUCTS else []
    blocks += [table(products, columns, caption), Text(SCALED, caveat=True)]
    folded = f"All {len(pairs)} pairs, with their errors"
    return [*blocks, table(pairs, of_pairs, folded=folded)]


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
