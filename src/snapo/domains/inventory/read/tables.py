"""The tables of an inventory case as they stand in the TOML file, each key with its meaning.

The description of a key is the text that an error message quotes as allowed.
"""

from typing import Annotated, Literal

from pydantic import Field

from snapo.case.given import CaseInput
from snapo.case.quantity import NOT_NEGATIVE, POSITIVE, Quantity
from snapo.case.table import TITLE, CaseTable, NotNegative, Title

ItemName = Annotated[str, Field(min_length=1, max_length=40)]

AMOUNT = "a number of at least 0"
NAME = "a name of at most 40 characters in quotation marks"
LONGEST_LEAD = 12
COST = Quantity("{currency}/{unit}", NOT_NEGATIVE, "costs")
HOLDING = Quantity("{currency}/{unit}/{period}", POSITIVE, "costs")
STOCK = Quantity("{unit}", NOT_NEGATIVE, "start", move=1.0)


class ItemTable(CaseTable):
    """`[item]`"""

    currency: ItemName = Field("EUR", description=NAME)
    unit: ItemName = Field("piece", description=NAME)
    period: ItemName = Field("week", description=NAME)
    unmet: Literal["lost", "waits"] = Field(description='"lost" or "waits"')
    lead_time: Annotated[int, Field(ge=0, le=LONGEST_LEAD)] = Field(
        description=f"a whole number of periods, 0 to {LONGEST_LEAD}"
    )
    holding: CaseInput = HOLDING("of a unit held, each period", name="holding_cost")
    shortage: CaseInput = HOLDING(
        "of a unit of demand that waits, each period", name="shortage_cost"
    )
    purchase: CaseInput = COST("of a unit ordered", 0.0, name="purchase_cost")
    order: CaseInput = COST("of an order of any size", 0.0, unit="{currency}", name="order_cost")
    whole: bool | None = Field(None, description="true or false")
    most: Annotated[int, Field(ge=1)] | None = Field(None, description="a whole number, 1 or more")
    stock: CaseInput | None = STOCK("at the start", None, name="start_stock")
    coming: list[NotNegative] | None = Field(
        None, description="a list of numbers of at least 0, one for each period of the lead time"
        " but the last",
    )  # fmt: skip


class HorizonTable(CaseTable):
    """`[horizon]`"""

    periods: Annotated[int, Field(ge=2, le=2000)] = Field(
        100, description="a whole number, 2 to 2,000"
    )
    warm_up: Annotated[int, Field(ge=0, le=2000)] | None = Field(
        None, description="a whole number, 0 to 2,000"
    )
    discount: Annotated[float, Field(gt=0, le=1)] = Field(
        1.0, description="a number above 0, at most 1"
    )


class SeasonTable(CaseTable):
    """`[season]`: of an item; of a place of a network, its key `season`"""

    file: ItemName = Field(description="the name of a CSV file with columns period,factor")


class ItemReportTable(CaseTable):
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
