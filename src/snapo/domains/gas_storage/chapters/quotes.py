"""Deltas by quoted product, for a curve that is made from quotes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from snapo.report.missing import why_missing
from snapo.report.page import Block, Table, Text
from snapo.report.quantity import decimals, number
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..setup import case_of
from .deltas import futures_along
from .run import StorageRun

TEXT = (
    "Change of the value if the price of one quoted product rises by 1 and all other quotes stay "
    "the same. The daily curve is linear in the quotes, so each of these deltas is a sum of the "
    "deltas by day, with the weights of the curve. Undiscounted, they are the volumes of futures "
    "that hedge the "
    "position: a positive volume is sold."
)


@dataclass(frozen=True)
class QuoteDelta:
    """The derivative with respect to one quote, in the unit of gas, with its 95 % interval.

    - `price`: the quote; `undiscounted`: the volume of futures on the product.
    - `sampling`, `policy`: the parts of the half-width of the interval.
    """

    product: str
    price: Number = np.nan
    discounted: Number = np.nan
    low: Number = np.nan
    high: Number = np.nan
    sampling: Number = np.nan
    policy: Number = np.nan
    undiscounted: Number = np.nan
    undiscounted_low: Number = np.nan
    undiscounted_high: Number = np.nan


@dataclass(frozen=True)
class QuoteDeltas:
    """The deltas by quote, in the order of the file."""

    deltas_by_quote: tuple[QuoteDelta, ...] = ()


def measure(run: StudyRun) -> QuoteDeltas:
    """The reported derivatives with respect to the quotes, from those by day; writes quotes.csv."""
    case, table = case_of(run.setup), run.solution.sensitivities
    quoted = case.quotes
    if table is None or quoted is None:
        return QuoteDeltas()
    delta = table.of(case.market.forward_curve.name)
    discount, rows = run.setup.problem.schedule.steps.gas_discount, []
    for product, price, weights in zip(quoted.products, quoted.prices, quoted.matrix.T):
        interval = futures_along(delta, weights, discount)
        rows.append(QuoteDelta(product, float(price), *delta.along(weights), *interval))
    run.write_records("quotes.csv", QuoteDelta, rows)
    return QuoteDeltas(tuple(rows))


def show(run: StorageRun, deltas: QuoteDeltas) -> Sequence[Block]:
    """A table with a row for each quote."""
    rows = deltas.deltas_by_quote
    if not rows:
        return [why_missing(run, QUOTE_DELTAS.name)]
    digits = decimals([x.undiscounted for x in rows], 4)
    cells = [
        (
            x.product,
            f"{x.price:g}",
            *(number(v, digits) for v in (x.undiscounted, x.undiscounted_low, x.undiscounted_high)),
            number(x.discounted, digits),
            *(number(v, max(digits, 1)) for v in (x.sampling, x.policy)),
        )
        for x in rows
    ]
    names = ("Delta", "95 % low", "95 % high", "Discounted", "± sampling", "± policy")
    head = [("Product", ""), ("Quote", run.price), *((name, run.volume) for name in names)]
    return [Text(TEXT), Table(head, cells, texts=1)]


QUOTE_DELTAS = Chapter("deltas by quote", "Deltas by quoted product", QuoteDeltas, measure, show,
                       "Quotes", optional=True)  # fmt: skip
