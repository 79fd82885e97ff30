"""Deltas by traded product, if a case has a table [products]."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Table, Text
from snapo.report.quantity import decimals, number
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..ladder.products import TradedProducts
from ..setup import case_of
from .deltas import futures_along

TEXT = (
    "Change of the value if the price of one product rises by 1 on all its days. Each day belongs "
    "to the shortest product that is traded on the valuation date, so that the sum of these "
    "deltas equals the sum of the deltas by day. Undiscounted, they are the volumes of futures "
    "that hedge the position: a positive volume is sold, and the volume per day is the same on "
    "each day of the product."
)


@dataclass(frozen=True)
class ProductDelta:
    """The derivative with respect to the price of a product, with its 95 % interval.

    - `days`: the days of delivery within the contract, from `first` to `last`.
    - `undiscounted`: the volume of futures; `daily`: the same volume per day.
    """

    product: str
    first: str
    last: str
    days: int
    discounted: Number = np.nan
    low: Number = np.nan
    high: Number = np.nan
    sampling: Number = np.nan
    policy: Number = np.nan
    undiscounted: Number = np.nan
    undiscounted_low: Number = np.nan
    undiscounted_high: Number = np.nan
    daily: Number = np.nan


@dataclass(frozen=True)
class ProductDeltas:
    """The deltas by product, in the order of delivery."""

    deltas_by_product: tuple[ProductDelta, ...] = ()


def deltas_by_product(
    run: StudyRun, products: TradedProducts | None, curve: str, discount: np.ndarray
) -> ProductDeltas:
    """The reported derivatives by day, summed for each product; writes products.csv.

    `curve`: the name of the input of the forward prices; `discount` [T]: discount factors of the
    payments.
    """
    table = run.solution.sensitivities
    if table is None or products is None:
        return ProductDeltas()
    delta, rows = table.of(curve), []
    for name, (first, after, *_) in products.named(-1 if products.before else 0):
        days = np.zeros(delta.value.size)
        days[first:after] = 1.0
        interval = futures_along(delta, days, discount)
        dates = [products.days[i].isoformat() for i in (first, after - 1)]
        about = name or "no product yet", dates[0], dates[1], after - first
        rows.append(
            ProductDelta(*about, *delta.along(days), *interval, interval[0] / (after - first))
        )
    run.write_records("products.csv", ProductDelta, rows)
    return ProductDeltas(tuple(rows))


def measure(run: StudyRun) -> ProductDeltas:
    """The deltas of a store."""
    case = case_of(run.setup)
    discount = run.setup.problem.schedule.steps.gas_discount
    return deltas_by_product(run, case.products, case.market.forward_curve.name, discount)


def show(run: RunFiles, deltas: ProductDeltas) -> Sequence[Block]:
    """A table with a row for each product."""
    rows = deltas.deltas_by_product
    if not rows:
        return [why_missing(run, PRODUCT_DELTAS.name)]
    digits = decimals([x.undiscounted for x in rows], 4)
    daily = decimals([x.daily for x in rows], 4)
    cells = [
        (
            x.product,
            f"{x.first} to {x.last}",
            *(number(v, digits) for v in (x.undiscounted, x.undiscounted_low, x.undiscounted_high)),
            number(x.daily, daily),
            number(x.discounted, digits),
            *(number(v, max(digits, 1)) for v in (x.sampling, x.policy)),
        )
        for x in rows
    ]
    unit = str(run.get("volume_unit", "units"))
    head = [("Product", ""), ("Delivery", ""), ("Delta", unit), ("95 % low", unit),
            ("95 % high", unit), ("Volume per day", unit), ("Discounted", unit),
            ("± sampling", unit), ("± policy", unit)]  # fmt: skip
    return [Text(TEXT), Table(head, cells, texts=2)]


PRODUCT_DELTAS = Chapter("deltas by product", "Deltas by traded product", ProductDeltas, measure,
                         show, "Products", optional=True)  # fmt: skip
