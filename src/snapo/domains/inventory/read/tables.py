"""The tables of an inventory case of the TOML file, each key with its meaning.

The description of a key is the text that an error message quotes as allowed.
"""

from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import Field

from snapo.case.error import counted
from snapo.case.given import CaseInput, positions
from snapo.case.quantity import NOT_NEGATIVE, POSITIVE, KeyContext, Quantity, Range, custom
from snapo.case.report import ReportTable
from snapo.case.table import TITLE, CaseTable, Title

ItemName = Annotated[str, Field(min_length=1, max_length=40)]

NAME = "a name of at most 40 characters in quotation marks"
LONGEST_LEAD = 12
COST = Quantity("{currency}/{unit}", NOT_NEGATIVE, "costs")
HOLDING = Quantity("{currency}/{unit}/{period}", POSITIVE, "costs")
STOCK = Quantity("{unit}", NOT_NEGATIVE, "start", move=1.0)
DISCOUNT = Quantity("1", Range(0.0, 1.0, "(]"))
COMING = (
    "a list of numbers of at least 0, one for each period of the lead time but the last, "
    "the next arrival first"
)


def whole_number(
    low: int, high: int | None = None, default: Any = ..., noun: str = "a whole number"
) -> Any:
    """A key for a whole number from `low` to `high`, with its description."""
    text = f"{noun}, {low:,} or more" if high is None else f"{noun}, {low:,} to {high:,}"
    return Field(default, ge=low, le=high, description=text)


def lead_time() -> Any:
    """The key `lead_time`."""
    return whole_number(0, LONGEST_LEAD, noun="a whole number of periods")


def _coming(raw: Any, key: KeyContext) -> CaseInput | None:
    """The orders on their way at the start; their number follows from the keys before it."""
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

    currency: ItemName = Field("EUR", description=NAME)
    unit: ItemName = Field("piece", description=NAME)
    period: ItemName = Field("week", description=NAME)
    unmet: Literal["lost", "waits"] = Field(description='"lost" or "waits"')
    lead_time: int = lead_time()
    holding: CaseInput = HOLDING("cost of a unit in stock, each period", name="holding_cost")
    shortage: CaseInput = HOLDING(
        "cost of a unit of demand that waits, each period", name="shortage_cost"
    )
    purchase: CaseInput = COST("cost of a unit ordered", 0.0, name="purchase_cost")
    order: CaseInput = COST(
        "cost of an order of any size", 0.0, unit="{currency}", name="order_cost"
    )
    whole: bool | None = Field(None, description="true or false")
    most: int | None = whole_number(1, default=None)
    stock: CaseInput | None = STOCK("stock at the start", None, name="start_stock")
    coming: CaseInput | None = custom(_coming, COMING, None, ("array",))


class HorizonTable(CaseTable):
    """`[horizon]`"""

    periods: int = whole_number(2, 2000, 100)
    warm_up: int | None = whole_number(0, 2000, None)
    discount: CaseInput = DISCOUNT("discount factor of a period", 1.0)

    @property
    def factor(self) -> float:
        """The discount factor of a period."""
        return float(self.discount.values[0])


class SeasonTable(CaseTable):
    """`[season]`: of an item; of a place of a network, its key `season`"""

    file: ItemName = Field(description="the name of a CSV file with columns period,factor")


class ItemReportTable(ReportTable):
    """`[report]`"""

    lead_time: bool = Field(True, description="true or false")


class InventoryTable(CaseTable):
    """The whole file."""

    kind: Literal["inventory"] = Field(description='"inventory"')
    title: Title = Field("Inventory", description=TITLE)
    item: dict = Field(description="the table [item]")
    demand: dict = Field(description="the table [demand]")
    season: dict = Field({}, description="the table [season]")
    horizon: dict = Field({}, description="the table [horizon]")
    report: dict = Field({}, description="the table [report]")
    objective: dict = Field({}, description="the table [objective]")
    training: dict = Field({}, description="the table [training]")
    evaluation: dict = Field({}, description="the table [evaluation]")
