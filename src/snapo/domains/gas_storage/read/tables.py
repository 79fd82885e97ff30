"""The tables of a gas-storage case as they stand in the TOML file, each key with its meaning.

The description of a key is the text that an error message quotes as allowed.
"""

import datetime
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from snapo.case.table import TITLE, Table, Title


def _plain_day(value: Any) -> Any:
    # A TOML date with a time is a datetime, which Python counts as a date.
    if isinstance(value, datetime.datetime):
        raise ValueError("a date without a time")
    # Payment rules reach a century beyond, and the calendar must not run out under them.
    if isinstance(value, datetime.date) and not 1900 <= value.year <= 2200:
        raise ValueError("a date out of range")
    return value


Day = Annotated[datetime.date, pydantic.BeforeValidator(_plain_day)]
FileName = Annotated[str, Field(min_length=1)]
NotNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, lt=1)]
Days = Annotated[int, Field(ge=0, le=36500)]

DATE = "a date from 1900 to 2200, YYYY-MM-DD"
DATED = "or the name of a CSV file with columns date,value"
AMOUNT = f"a number of at least 0, {DATED}"
SHARE = f"a number from 0 up to but not 1, {DATED}"
RULES = (
    '"flow", { days = 10 }, { date = 2021-06-20 }, { months = 1, day = 20 } '
    "or a CSV file with columns delivery_month,date"
)


def limit(default: Any = None, what: str = AMOUNT) -> Any:
    """A field for a number that may change on given dates."""
    return Field(default, description=what)


class AfterDays(Table):
    """{ days = 10 }: so many calendar days after the flow."""

    days: Days


class OnDate(Table):
    """{ date = 2019-10-20 }: everything on one date."""

    date: Day


class MonthsAfter(Table):
    """{ months = 1, day = 20 }: that day of the month so many months after delivery."""

    months: Annotated[int, Field(ge=0, le=1200)]
    day: Annotated[int, Field(ge=1, le=31)]


Settlement = str | AfterDays | OnDate | MonthsAfter


class ContractTable(Table):
    """`[contract]`"""

    start: Day = Field(description=DATE)
    end: Day = Field(description=DATE)
    inventory: NotNegative = Field(description="a number of at least 0")
    max_inventory: NotNegative | FileName = Field(description=AMOUNT)
    min_inventory: NotNegative | FileName = limit(0.0)
    max_injection: NotNegative | FileName | None = limit()
    max_withdrawal: NotNegative | FileName | None = limit()
    ratchets: FileName | None = Field(
        None,
        description="a CSV file with columns date,inventory,max_withdrawal,max_injection",
    )
    ratchet_interpolation: Literal["linear", "step"] = Field(
        "linear", description='"linear" or "step"'
    )
    min_injection: NotNegative | FileName = limit(0.0)
    min_withdrawal: NotNegative | FileName = limit(0.0)
    injection_cost: float | FileName = limit(0.0, f"a number, {DATED}")
    withdrawal_cost: float | FileName = limit(0.0, f"a number, {DATED}")
    injection_cost_settlement: Settlement = Field("flow", description=f'"gas", {RULES}')
    withdrawal_cost_settlement: Settlement = Field("flow", description=f'"gas", {RULES}')
    fixed_costs: FileName | None = Field(None, description="a CSV file with columns date,amount")
    injection_fuel: Fraction | FileName = limit(0.0, SHARE)
    withdrawal_fuel: Fraction | FileName = limit(0.0, SHARE)
    inventory_loss: Fraction | FileName = limit(0.0, SHARE)
    inventory_cost: float | FileName = limit(0.0, f"a number, {DATED}")
    end_inventory: NotNegative | Literal["free"] = Field(
        0.0, description='a number of at least 0, or "free"'
    )
    end_value: NotNegative | FileName | None = Field(
        None,
        description="a number of at least 0, or a CSV file with columns inventory,value",
    )
    outages: list[str] | FileName = Field(
        [],
        description='a list like ["2021-07-01/2021-07-14"], or a CSV file with columns '
        "from,to,injection_factor,withdrawal_factor",
    )
    first_decision: Literal["valuation-date", "next-day"] = Field(
        "valuation-date", description='"valuation-date" or "next-day"'
    )
    volume_unit: FileName = Field("MWh", description='a name such as "MWh"')
    currency: FileName = Field("EUR", description='a name such as "EUR"')


class MarketTable(Table):
    """`[market]`"""

    valuation_date: Day = Field(description=DATE)
    forward_curve: FileName = Field(description="a CSV file with columns date,price")
    interest_rate: Annotated[float, Field(gt=-1, lt=1)] | FileName = Field(
        0.0, description="a number between -1 and 1, or a CSV file with columns date,zero_rate"
    )
    settlement: Settlement = Field("flow", description=RULES)


class StorageTable(Table):
    """The whole file."""

    kind: Literal["gas-storage"] = Field(description='"gas-storage"')
    title: Title = Field("Gas storage", description=TITLE)
    contract: dict = Field(description="the table [contract]")
    market: dict = Field(description="the table [market]")
    model: dict = Field(description="the table [model]")
    objective: dict = Field({}, description="the table [objective]")
    training: dict = Field({}, description="the table [training]")
    evaluation: dict = Field({}, description="the table [evaluation]")
