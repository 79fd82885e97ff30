"""`[products]`: the traded products, the last trading days, and the cost of a trade.

    [products]
    day_ahead = { bid_offer = 0.05 }
    balance_of_month = { bid_offer = 0.10 }
    months = { bid_offer = 0.10, lot = 10.0, ahead = 6 }
    seasons = { bid_offer = 0.20 }

On a trading day each later day of delivery belongs to the shortest product that contains it and can
still be traded. The day itself is traded at its spot price, which is the day-ahead price.
"""

import datetime
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError
from snapo.case.table import AnyTable, CaseTable, Nonempty, Range, TableContext, doc, parse

from ..curves.products import ONE, months
from .rolling import TradeBlock

SPREAD = (
    "difference between the prices at which a unit is bought and sold; a trade costs half of it"
)
COLUMNS = ("name", "first", "last", "bid_offer", "lot", "last_trading_day")


class DayAheadTable(CaseTable):
    """`products.day_ahead`: the trading day itself, at its spot price."""

    bid_offer: Annotated[float, Range(0.0, note=f": the {SPREAD}")] = doc(
        "bid-offer spread, in currency/volume_unit", 0.0
    )


class BalanceTable(DayAheadTable):
    """`products.balance_of_month`: the days of the month after the trading day."""

    lot: Annotated[
        float, Range(0.0, note=": forward volumes per day are multiples of it; 0 allows any volume")
    ] = doc("lot size, in volume_unit/day", 0.0)


class FamilyTable(BalanceTable):
    """`products.months`, and in the same way `products.quarters` and `products.seasons`."""

    ahead: Annotated[int, Range(1)] | None = doc(
        "number of traded periods after the present period, by default all", None
    )
    last_trading: Annotated[int, Range(0, 400, note=" days before delivery")] = doc(
        "days from the last trading day to the first day of delivery", 1
    )


FAMILY = "a table like { bid_offer = 0.1, lot = 10.0, ahead = 6, last_trading = 1 }"


class ProductsTable(CaseTable):
    """`[products]`: the traded products; a family that is left out is not traded."""

    day_ahead: dict = doc(
        "spot market of the trading day itself", {}, "a table like { bid_offer = 0.05 }"
    )
    balance_of_month: dict | None = doc(
        "the days of the month after the trading day", None, "a table like { lot = 10.0 }"
    )
    months: dict | None = doc("calendar months", None, FAMILY)
    quarters: dict | None = doc("calendar quarters", None, FAMILY)
    seasons: dict | None = doc("summers from April and winters from October", None, FAMILY)
    others: Nonempty | None = doc(
        "products with other periods of delivery",
        None,
        f"a CSV file with columns {','.join(COLUMNS)}",
    )


FORMATS = {
    "products": ProductsTable,
    "products.day_ahead": DayAheadTable,
    "products.balance_of_month": BalanceTable,
    "products.months": FamilyTable,
    "products.quarters": FamilyTable,
    "products.seasons": FamilyTable,
}
PERIODS = {"months": (1, 1), "quarters": (3, 1), "seasons": (6, 4)}  # length, first month
DAY_AHEAD, BALANCE = "day_ahead", "balance_of_month"
FAMILIES = (DAY_AHEAD, BALANCE, *PERIODS, "others")  # the keys of [products]


class TradedProduct(NamedTuple):
    """A product with its first and last day of delivery, and its last trading day.

    - `opens`: the first trading day, None for any; `family`: the key of [products] to which it
      belongs.
    """

    name: str
    first: datetime.date
    last: datetime.date
    bid_offer: float = 0.0
    lot: float = 0.0
    last_trading: datetime.date = datetime.date.max
    opens: datetime.date | None = None
    family: str = "others"

    def trades(self, day: datetime.date) -> bool:
        return day <= self.last_trading and (self.opens is None or self.opens <= day)


class ProductDays(NamedTuple):
    """A product, and its days from `first` up to, but not including, `after`; the name is "" if
    there is no product."""

    product: str
    block: TradeBlock


@dataclass(frozen=True)
class TradedProducts:
    """The products of a contract on its days.

    - `days`: the days of delivery; `valuation`: the first trading day; `products`: all products
      that may be traded.
    - `day_ahead`: the bid-offer of the trading day itself; `balance`: the terms of the balance of
      the month, or None.
    """

    days: tuple[datetime.date, ...]
    valuation: datetime.date
    products: tuple[TradedProduct, ...]
    day_ahead: float = 0.0
    balance: tuple[float, float] | None = (0.0, 0.0)

    @property
    def families(self) -> tuple[str, ...]:
        """The keys of [products] with at least one traded product; the day-ahead is always among
        them."""
        there = {DAY_AHEAD, *(product.family for product in self.products)}
        there |= set() if self.balance is None else {BALANCE}
        return tuple(family for family in FAMILIES if family in there)

    def only(self, families: Collection[str]) -> Self:
        """The products of these families, and the trading day itself."""
        products = tuple(product for product in self.products if product.family in families)
        balance = self.balance if BALANCE in families else None
        return replace(self, products=products, balance=balance)

    def family(self, name: str) -> str:
        """The key of [products] to which a product belongs."""
        return next((x.family for x in self.products if x.name == name), BALANCE)

    @property
    def before(self) -> bool:
        """Whether the valuation date is before the first day of delivery."""
        return bool(self.days) and self.valuation < self.days[0]

    def named(self, t: int) -> tuple[ProductDays, ...]:
        """The products that can be traded on step t, or on the valuation date for -1, in the order
        of delivery."""
        today = self.days[t] if t >= 0 else self.valuation
        rows = []
        if t >= 0:
            rows.append(ProductDays("day ahead", TradeBlock(t, t + 1, self.day_ahead / 2)))
        later = range(t + 1, len(self.days))
        trading = sorted(self._trading(today), key=lambda x: x.last - x.first)

        def of(i: int) -> TradedProduct:
            day = self.days[i]
            return next((x for x in trading if x.first <= day <= x.last), self._untraded(day))

        for product, steps in groupby(later, of):
            numbers = list(steps)
            block = TradeBlock(
                numbers[0], numbers[-1] + 1, product.bid_offer / 2, product.lot, bool(product.name)
            )
            rows.append(ProductDays(product.name, block))
        return tuple(rows)

    def blocks(self, t: int) -> tuple[TradeBlock, ...]:
        """The products of `named`, without their names."""
        return tuple(row.block for row in self.named(t))

    def _trading(self, today: datetime.date) -> list[TradedProduct]:
        trading = [product for product in self.products if product.trades(today)]
        if self.balance is not None:
            _, last = months(today.year, today.month, 1)
            if today < last:
                name = f"balance of {today:%Y-%m}"
                trading.append(TradedProduct(name, today + ONE, last, *self.balance))
        return trading

    def _untraded(self, day: datetime.date) -> TradedProduct:
        return TradedProduct("", *months(day.year, day.month, 1), self.day_ahead)


def products_of(
    file: Path,
    data: Any,
    notes: list[str],
    days: Sequence[datetime.date],
    valuation: datetime.date,
) -> TradedProducts | None:
    """The products of the table [products], None for a case without one.

    **Raises:** `CaseError` if a product is traded as a whole while its parts are traded, or after
    they were.
    """
    if data is None:
        return None
    section = TableContext(file, "products", notes)
    table = parse(ProductsTable, data, str(file), "products", notes)

    def inner(kind: type[AnyTable], key: str) -> AnyTable | None:
        entry = getattr(table, key)
        return None if entry is None else section.nested(kind, entry, key)

    products = []
    for name in PERIODS:
        if (family := inner(FamilyTable, name)) is not None:
            products += _family(name, family, days)
    if table.others is not None:
        rows = read_rows(FileReference(section, "others", table.others), COLUMNS)
        products += [_product(row) for row in rows]
    balance, day_ahead = inner(BalanceTable, "balance_of_month"), inner(DayAheadTable, "day_ahead")
    assert day_ahead is not None
    result = TradedProducts(
        tuple(days),
        valuation,
        tuple(products),
        day_ahead.bid_offer,
        None if balance is None else (balance.bid_offer, balance.lot),
    )
    _check_nested(section, result)
    return result


def usual_products(days: Sequence[datetime.date], valuation: datetime.date) -> TradedProducts:
    """Day-ahead, balance of month and months, without a spread, for a case without [products]."""
    family = FamilyTable()  # pyright: ignore[reportCallIssue]
    return TradedProducts(tuple(days), valuation, tuple(_family("months", family, days)))


def _family(name: str, table: FamilyTable, days: Sequence[datetime.date]) -> list[TradedProduct]:
    """The periods of a family that contain days of delivery."""
    length, begins = PERIODS[name]
    products, last = [], datetime.date.min
    for day in days:
        if day <= last:
            continue
        month = day.year * 12 + day.month - 1
        month -= (month - (begins - 1)) % length
        first, last = months(month // 12, month % 12 + 1, length)
        opens = None
        if table.ahead is not None:
            earlier = month - length * table.ahead
            opens = datetime.date(earlier // 12, earlier % 12 + 1, 1)
        ends = first - table.last_trading * ONE
        products.append(
            TradedProduct(
                _label(name, first), first, last, table.bid_offer, table.lot, ends, opens, name
            )
        )
    return products


def _label(name: str, first: datetime.date) -> str:
    """The name of a period, as in quotes."""
    if name == "months":
        return f"{first:%Y-%m}"
    if name == "quarters":
        return f"{first.year}-Q{(first.month + 2) // 3}"
    return f"{'summer' if first.month == 4 else 'winter'} {first.year}"


def _product(row: Row) -> TradedProduct:
    first, last = row.day("first"), row.day("last")
    if last < first:
        raise row.error("last", f"the last day of delivery must not be before the first, {first}")
    last_trading = row.day("last_trading_day")
    if last_trading > last:
        raise row.error(
            "last_trading_day", f"it must not be after the last day of delivery, {last}"
        )
    name = row.cells["name"].strip()
    if not name:
        raise row.error("name", "a product must have a name")
    bid_offer, lot = row.number("bid_offer", 0.0), row.number("lot", 0.0)
    return TradedProduct(name, first, last, bid_offer, lot, last_trading)


def _check_nested(section: TableContext, products: TradedProducts) -> None:
    earlier: set[int] = set()
    for t in range(-1 if products.before else 0, len(products.days)):
        rows, met = products.named(t), set()
        for name, block in rows:
            inside = earlier & set(range(block.first + 1, block.after))
            if name and (name in met or inside):
                day = products.days[t] if t >= 0 else products.valuation
                message = (
                    f"on {day} it would be traded as a whole, although a part of it is traded on "
                    "that day or was traded before; products must follow one another, or shorter "
                    "products must replace a longer one from its first day on"
                )
                raise CaseError(str(section.file), f"{section.name}: {name}", None, message)
            met.add(name)
        earlier = {row.block.first for row in rows}
