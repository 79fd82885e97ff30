"""The tables of an inventory case in its TOML file; every key has its meaning.

The description of a key is the text of allowed values in an error message.
"""

from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import Field

from snapo.case.error import counted
from snapo.case.given import CaseInput, positions
from snapo.case.quantity import NOT_NEGATIVE, POSITIVE, KeyContext, Quantity, Range, custom
from snapo.case.report import ReportKey, ReportTable
from snapo.case.settings import EvaluationKey, ObjectiveKey, TrainingKey
from snapo.case.table import CaseTable, Title, doc, subtable

ItemName = Annotated[str, Field(min_length=1, max_length=40)]

NAME = "a name of at most 40 characters in quotation marks"
LONGEST_LEAD = 12
COST = Quantity("{currency}/{unit}", NOT_NEGATIVE, "costs")
HOLDING = Quantity("{currency}/{unit}/{period}", POSITIVE, "costs")
STOCK = Quantity("{unit}", NOT_NEGATIVE, "start", move=1.0)
DISCOUNT = Quantity("1", Range(0.0, 1.0, "(]"))
COMING = (
    "a list of numbers of at least 0, one for each period of the lead time except the last, the "
    "next arrival first"
)


def whole_number(
    meaning: str,
    low: int,
    high: int | None = None,
    default: Any = ...,
    noun: str = "a whole number",
) -> Any:
    """A key for a whole number from `low` to `high`."""
    text = f"{noun}, {low:,} or more" if high is None else f"{noun}, {low:,} to {high:,}"
    return doc(meaning, default, text, ge=low, le=high)


MoneyName = Annotated[ItemName, doc("currency of all amounts of money", "EUR", NAME)]
UnitName = Annotated[ItemName, doc("unit of stock and demand", "piece", NAME)]
PeriodName = Annotated[ItemName, doc("time from one decision to the next", "week", NAME)]
WholeOrders = Annotated[
    bool | None,
    doc("whether orders are in whole units; by default they are if demand is in whole units", None),
]
LeadTime = Annotated[
    int,
    whole_number(
        "periods from an order to its arrival", 0, LONGEST_LEAD, noun="a whole number of periods"
    ),
]
HorizonKey = Annotated[dict, subtable("periods and discount factor", "horizon", {})]
OTHER_LEADS = "whether policies are also trained with lead times one period shorter and longer"


def _coming(raw: Any, key: KeyContext) -> CaseInput | None:
    """The orders on their way at the start; the lead time determines how many there must be."""
    if raw is None or "lead_time" not in key.values:
        return None
    if not isinstance(raw, list):
        raise key.error(raw, f"it must be {COMING}")
    numbers = [STOCK.checked(x, key) for x in raw]
    lead_time, period = key.values["lead_time"], key.filled("{period}")
    arrivals = max(lead_time - 1, 0)
    if len(raw) != arrivals:
        message = f"a lead time of {lead_time} needs {arrivals} numbers, the next arrival first"
        raise key.error(raw, message)
    if not numbers:
        return None
    labels = [f"in {counted(i + 1, period)}" for i in range(arrivals)]
    quantity = replace(
        STOCK, unit=key.filled(STOCK.unit), meaning="arrival of an outstanding order"
    )
    rows = positions(key.path, (arrivals,))
    return quantity.input("start_coming", numbers, labels, positions=rows)


class ItemTable(CaseTable):
    """`[item]`"""

    currency: MoneyName
    unit: UnitName
    period: PeriodName
    unmet: Literal["lost", "waits"] = doc("whether unmet demand is lost or waits")
    lead_time: LeadTime
    holding: CaseInput = HOLDING("cost per period of a unit in stock", name="holding_cost")
    shortage: CaseInput = HOLDING(
        "cost per period of a unit of demand that waits", name="shortage_cost"
    )
    purchase: CaseInput = COST("cost of a unit ordered", 0.0, name="purchase_cost")
    order: CaseInput = COST(
        "cost of an order of any size", 0.0, unit="{currency}", name="order_cost"
    )
    whole: WholeOrders
    most: int | None = whole_number(
        "largest order, in units; by default there is no limit", 1, default=None
    )
    stock: CaseInput | None = STOCK("stock at the start", None, name="start_stock")
    coming: CaseInput | None = custom(
        "orders on their way at the start, in units", _coming, COMING, None, ("array",)
    )


class HorizonTable(CaseTable):
    """`[horizon]`"""

    periods: int = whole_number("periods that count", 2, 2000, 100)
    warm_up: int | None = whole_number(
        "number of periods before those that count; by default 10 times (lead time + 1)",
        0,
        2000,
        None,
    )
    discount: CaseInput = DISCOUNT("discount factor of a period", 1.0)

    @property
    def factor(self) -> float:
        """The discount factor of a period."""
        return float(self.discount.values[0])


class SeasonTable(CaseTable):
    """`[season]` of an item, or the key `season` of a place of a network"""

    file: ItemName = doc(
        "demand of a period of the season relative to the mean",
        allowed="the name of a CSV file with columns period,factor",
    )


class ItemReportTable(ReportTable):
    """`[report]`"""

    lead_time: bool = doc(OTHER_LEADS, True)


class InventoryTable(CaseTable):
    """The whole file."""

    kind: Literal["inventory"] = doc("kind of the case")
    title: Title = "Inventory"
    item: dict = subtable("lead time, costs and stock of an item", "item")
    demand: dict = subtable("distribution of the demand of a period", "demand")
    season: dict = subtable("season of the demand", "season", {})
    horizon: HorizonKey
    report: ReportKey
    objective: ObjectiveKey
    training: TrainingKey
    evaluation: EvaluationKey
