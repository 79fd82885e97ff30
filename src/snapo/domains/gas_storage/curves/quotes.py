"""Quotes of traded products, and the daily forward curve whose means over the products are the
quotes."""

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError
from snapo.case.given import CaseInput, SourceNumbers
from snapo.case.quantity import Quantity
from snapo.case.table import CaseTable, Positive, TableContext, doc
from snapo.problem.record.arrays import Float

from .products import delivery_of

LONGEST = 366 * 40  # days of a curve
AGREEMENT = 5e-4  # of the price, between quotes that are together those of the same days
WEEKDAYS = ("monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday")
Weekday = Literal["monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday"]


class QuotedCurveTable(CaseTable):
    """The settings for a daily curve that is made from quotes."""

    smoother: Literal["daily", "spline"] = doc(
        "whether the daily prices are smooth, or means of a smooth spline", "daily"
    )
    end: Literal["flat", "free"] = doc(
        "slope of a spline at the end of the curve: zero, or not fixed", "flat"
    )
    factors: dict[Weekday, Positive] = doc(
        "factors of the price on days of the week, relative to the smooth curve", {}
    )


@dataclass(frozen=True, eq=False)
class QuotedCurve:
    """Quotes and the curve that is linear in them.

    - `file`: the file of the quotes; `products`, `prices` [n]: the products and prices that
      determine the curve.
    - `source`: these quotes with their positions in the file, and the other quotes, which these
      imply.
    - `days`: the days of the matrix; `matrix` [D, n]: the derivative of each day's price with
      respect to each quote.
    """

    file: str
    products: tuple[str, ...]
    prices: Float[np.ndarray, " n"]
    days: tuple[datetime.date, ...]
    matrix: Float[np.ndarray, "D n"]
    source: SourceNumbers

    @property
    def curve(self) -> Float[np.ndarray, " D"]:
        """The forward price of each day."""
        return self.matrix @ self.prices


class _Product(NamedTuple):
    """A quoted product: its row in the file, its price, its first day and the day after its last
    day."""

    row: Row
    price: float
    first: datetime.date
    after: datetime.date

    @property
    def name(self) -> str:
        return self.row.cells["product"]


def read_quotes(
    section: TableContext,
    name: str,
    declaration: Quantity,
    table: QuotedCurveTable,
    days: Sequence[datetime.date],
) -> QuotedCurve:
    """The quotes in a CSV with columns product,price, and the prices of these days.

    `declaration`: the declaration of a price. A quote that other quotes imply is compared with
    these, and left out.

    **Raises:** `CaseError` if a product is unknown or quoted twice, if quotes of the same days
    disagree, if a day is in no product, and if several curves are equally smooth.
    """
    reference = FileReference(section, "quotes", name)
    from .smooth import Undetermined, prices_of_means  # SciPy: most cases are read without it

    products = _products(read_rows(reference, ("product", "price")), declaration)
    _cover(products, name, days)
    products, others, weights = _independent(products)
    if implied := [product.name for product in others]:
        section.notes.append(
            f"In {name}, {', '.join(implied)} agree{'s' if len(implied) == 1 else ''} with the "
            "other quotes for the same days, which determine the curve."
        )
    start = min(product.first for product in products)
    periods = [((x.first - start).days, (x.after - start).days) for x in products]
    all_days = [start + datetime.timedelta(i) for i in range(max(after for _, after in periods))]
    factors: Mapping[str, float] = {str(day): factor for day, factor in table.factors.items()}
    scale = np.array([factors.get(WEEKDAYS[day.weekday()], 1.0) for day in all_days])
    try:
        matrix = prices_of_means(periods, scale, table.smoother, table.end == "flat")
    except Undetermined:
        message = (
            "the quotes do not determine the curve: several curves are equally smooth; add "
            "a quote for other days"
        )
        raise CaseError(name, "", None, message) from None
    matrix = matrix[[(day - start).days for day in days]]
    quotes, implied = (_numbers(x, declaration) for x in (products, others))
    limits = tuple((x.first, x.after - datetime.timedelta(1)) for x in products)
    return QuotedCurve(
        name,
        quotes.labels,
        quotes.values,
        tuple(days),
        matrix,
        SourceNumbers(quotes, "forward_curve", matrix, limits, implied, weights),
    )


def _numbers(products: Sequence[_Product], declaration: Quantity) -> CaseInput:
    """The quotes of some products as numbers of the case."""
    meaning = "quoted price, the mean of the prices of its days"
    return replace(declaration, meaning=meaning).input(
        "quotes",
        [product.price for product in products],
        [product.name for product in products],
        positions=tuple(product.row.position("price") for product in products),
    )


def _products(rows: Sequence[Row], declaration: Quantity) -> list[_Product]:
    products: dict[tuple[datetime.date, datetime.date], _Product] = {}
    for row in rows:
        first, last = delivery_of(row)
        price = declaration.cell(row)
        product = _Product(row, price, first, last + datetime.timedelta(1))
        if products.setdefault((first, last), product) is not product:
            earlier = products[first, last].row.line
            raise row.error("product", f"line {earlier} has a price for the same days already")
    return list(products.values())


def _cover(products: Sequence[_Product], name: str, days: Sequence[datetime.date]) -> None:
    """**Raises:** `CaseError` for the first day that is in no product, or for too many days."""
    first, last = min(x.first for x in products), max(products, key=lambda x: x.after)
    if (last.after - first).days > LONGEST:
        message = (
            f"the first quoted day is {first}; all quotes together may span at most "
            f"{LONGEST:,} days"
        )
        raise last.row.error("product", message)
    for day in days:
        if not any(product.first <= day < product.after for product in products):
            message = (
                "no quoted product contains this day; the contract needs quotes that contain every "
                f"day from {days[0]} to {days[-1]}"
            )
            raise CaseError(name, day.isoformat(), None, message)


def _independent(
    products: Sequence[_Product],
) -> tuple[list[_Product], list[_Product], Float[np.ndarray, "m n"]]:
    """The products whose prices are not implied by others, in the order of the file; the implied
    products; and the weights [implied, products] of the former in the prices of the latter.

    Short products are considered first, so that the months imply a quarter.

    **Raises:** `CaseError` if an implied price is not the quoted one.
    """
    limits = sorted({limit for product in products for limit in (product.first, product.after)})
    intervals = list(pairwise(limits))
    shares = [
        [
            (after - first).days * (x.first <= first and after <= x.after)
            for first, after in intervals
        ]
        for x in products
    ]
    rows = np.array(shares) / np.sum(shares, axis=1, keepdims=True)
    selected: list[int] = []
    implied: list[_Product] = []
    shares_of: list[dict[int, float]] = []
    for i in sorted(range(len(products)), key=lambda i: products[i].after - products[i].first):
        weights = np.linalg.lstsq(rows[selected].T, rows[i])[0]
        if np.abs(weights @ rows[selected] - rows[i]).max() > 1e-9:
            selected.append(i)
            continue
        product, others = products[i], [products[j] for j in selected]
        price = float(weights @ [other.price for other in others])
        if abs(price - product.price) > AGREEMENT * abs(price):
            used = [j for j, weight in zip(selected, weights) if abs(weight) > 1e-9]
            names = [products[j].name for j in sorted(used)]
            raise product.row.error(
                "price",
                f"{', '.join(names)} together give {price:.6g} for the days of {product.name}; "
                f"quotes for the same days must agree within {100 * AGREEMENT:g} %",
            )
        implied.append(product)
        shares_of.append(dict(zip(selected, weights.tolist())))
    order = sorted(selected)
    rows = [[share.get(j, 0.0) for j in order] for share in shares_of]
    return [products[i] for i in order], implied, np.reshape(rows, (len(implied), len(order)))
