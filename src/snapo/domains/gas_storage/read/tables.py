"""The tables of a gas-storage case, each number declared once, with unit, range and meaning.

The description of a key is the text on the allowed values in an error message.
"""

import datetime
from dataclasses import replace
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from snapo.case.given import CaseInput
from snapo.case.plausible import FRACTION, Plausible
from snapo.case.quantity import BELOW_ONE, NOT_NEGATIVE, Quantity, Range
from snapo.case.report import ReportKey
from snapo.case.settings import EvaluationKey, ObjectiveKey, TrainingKey
from snapo.case.table import CaseTable, Nonempty, NotNegative, Title, doc, subtable

from ..curves.quotes import QuotedCurveTable


def _plain_day(value: Any) -> Any:
    # A TOML date with a time is a datetime, which Python counts as a date.
    if isinstance(value, datetime.datetime):
        raise ValueError("a date without a time")
    # Payment rules reach a century beyond, and the calendar must not run out under them.
    if isinstance(value, datetime.date) and not 1900 <= value.year <= 2200:
        raise ValueError("a date out of range")
    return value


DATE = "a date from 1900 to 2200, YYYY-MM-DD"
DateKey = Annotated[datetime.date, pydantic.BeforeValidator(_plain_day), Field(description=DATE)]
ValuationDay = Annotated[
    DateKey, Field(title="date of today's prices, to which payments are discounted")
]
VolumeUnit = Annotated[Nonempty, doc("unit of all volumes", "MWh", 'a name such as "MWh"')]
Currency = Annotated[Nonempty, doc("currency of all money", "EUR", 'a name such as "EUR"')]
NominationKey = Annotated[
    dict | None,
    doc("how many days before its date a flow is fixed", None, "a table like { days = 1 }"),
]
END_VALUES = "a CSV file with columns inventory,value"
CURVE = (
    '{ smoother = "spline", end = "free", factors = { sunday = 0.94 } }: '
    'smoother "daily" or "spline", end "flat" or "free", factors above 0 by day of the week'
)
RULES = (
    '"flow", { days = 10 }, { date = 2021-06-20 }, { months = 1, day = 20 } '
    "or a CSV file with columns delivery_month,date"
)


PRICE, FLOW, GROUP = "{currency}/{volume_unit}", "{volume_unit}/day", "contract"
OF_VOLUME = Plausible(0.0, 0.2, "it is a share of the volume; 0.015 is 1.5 %")
OF_STOCK = Plausible(0.0, 0.01, "it is a share of the gas in store per day; 0.0001 is 3.6 % a year")
OF_SPOT = Plausible(
    0.0,
    1.5,
    "it is a share of the spot price; 0.9 is 90 %. A value in money needs a CSV inventory,value",
)
POINTS = Quantity(
    "1", group="cost", move=1e-3, display_unit="percentage point", display_factor=100.0
)
SHARE = replace(POINTS, range=BELOW_ONE, plausible=OF_VOLUME, by="date", before=0.0)
STOCK = Quantity("{volume_unit}", NOT_NEGATIVE, GROUP)
LIMIT = Quantity("{volume_unit}", NOT_NEGATIVE, GROUP, move=1.0, by="date")
RATE = Quantity(FLOW, NOT_NEGATIVE, GROUP, move=1.0, by="date")
# Forced flows of zero stay zero: a day has no more than one of them.
FORCED = Quantity(FLOW, NOT_NEGATIVE, GROUP, by="date", before=0.0)
COST = Quantity(PRICE, group="cost", move=0.01, by="date", before=0.0)
ZERO_RATE = Quantity(
    "1/year",
    Range(-1.0, 1.0, "()"),
    "interest rate",
    move=1e-3,  # ten basis points
    display_unit="bp",
    display_factor=10_000.0,
    limits=Range(-0.5, 1.0, note=" (-50 to 100 %)"),
    plausible=Plausible(-0.02, 0.25, FRACTION),
    by="date",
    column="zero_rate",
)
FORWARD = Quantity(
    PRICE, group="price", limits=Range(-1e6, 1e6), column="price",
    meaning="price today for delivery on the day",
)  # fmt: skip


class AfterDays(CaseTable):
    """{ days = 10 }: this number of calendar days after the flow."""

    days: Annotated[int, Range(0, 36500)] = doc("calendar days from the flow to its payment")


class OnDate(CaseTable):
    """{ date = 2019-10-20 }: everything is paid on one date."""

    date: DateKey = doc("day on which everything is paid")


class MonthsAfter(CaseTable):
    """{ months = 1, day = 20 }: this day of the month, this number of months after the month of
    delivery."""

    months: Annotated[int, Range(0, 1200)] = doc("months from delivery to payment")
    day: Annotated[int, Range(1, 31)] = doc("day of the month of the payment")


CostSettlement = Literal["flow", "gas"] | str | AfterDays | OnDate | MonthsAfter
Settlement = Literal["flow"] | str | AfterDays | OnDate | MonthsAfter


class ContractTable(CaseTable):
    """`[contract]`"""

    volume_unit: VolumeUnit
    currency: Currency
    start: DateKey = doc("first day with a decision")
    end: DateKey = doc("first day without a decision")
    inventory: CaseInput = STOCK("gas in store at the start")
    max_inventory: CaseInput = LIMIT("largest volume of gas in store")
    min_inventory: CaseInput = LIMIT("smallest volume of gas in store", 0.0, before=0.0)
    max_injection: CaseInput | None = RATE("largest injection per day", None)
    max_withdrawal: CaseInput | None = RATE("largest withdrawal per day", None)
    ratchets: Nonempty | None = doc(
        "largest withdrawal and injection by inventory, in volume_unit/day", None,
        "a CSV file with columns date,inventory,max_withdrawal,max_injection",
    )  # fmt: skip
    ratchet_interpolation: Literal["linear", "step"] = doc(
        "whether rates between two ratchet rows are interpolated, or those of the lower row",
        "linear",
    )
    min_injection: CaseInput = FORCED("injection that must flow", 0.0)
    min_withdrawal: CaseInput = FORCED("withdrawal that must flow", 0.0)
    injection_cost: CaseInput = COST("cost per unit injected", 0.0)
    withdrawal_cost: CaseInput = COST("cost per unit withdrawn", 0.0)
    injection_cost_settlement: CostSettlement = doc(
        "when injection costs are paid", "flow", f'"gas", {RULES}'
    )
    withdrawal_cost_settlement: CostSettlement = doc(
        "when withdrawal costs are paid", "flow", f'"gas", {RULES}'
    )
    fixed_costs: Nonempty | None = doc(
        "amounts that are due whatever is decided, in currency",
        None,
        "a CSV file with columns date,amount",
    )
    injection_fuel: CaseInput = SHARE(
        "fuel: share of the injection that is bought in addition", 0.0
    )
    withdrawal_fuel: CaseInput = SHARE("fuel: share of the withdrawal that is not sold", 0.0)
    inventory_loss: CaseInput = SHARE(
        "lost gas", 0.0, unit="1/day", display_unit="percentage point a day", move=1e-4, bump=1e-6,
        plausible=OF_STOCK,
    )  # fmt: skip
    inventory_cost: CaseInput = COST("cost per unit in store and day", 0.0, unit=f"{PRICE}/day")
    end_inventory: NotNegative | Literal["free"] = doc(
        "gas that must be in store at the end, in volume_unit", 0.0
    )
    end_value: NotNegative | Annotated[Nonempty, Field(description=END_VALUES)] | None = doc(
        "value of gas left at the end: a share of the spot price, or money by inventory", None
    )
    outages: list[str] | Nonempty = doc(
        "days without flow, including the first and the last day; or a file with the shares of the "
        "rates that remain", [],
        'a list like ["2021-07-01/2021-07-14"], or a CSV file with columns '
        "from,to,injection_factor,withdrawal_factor",
    )  # fmt: skip
    first_decision: Literal["valuation-date", "next-day"] = doc(
        "first day whose flow is decided: tomorrow if the flow of today is already nominated",
        "valuation-date",
    )
    nomination: NominationKey


class MarketTable(CaseTable):
    """`[market]`"""

    valuation_date: ValuationDay
    forward_curve: Nonempty | None = doc(
        "price today by day or month of delivery, in currency/volume_unit", None,
        "a CSV file with columns date,price; or quotes",
    )  # fmt: skip
    quotes: Nonempty | None = doc(
        "prices of traded products from which the forward curve is made, in currency/volume_unit",
        None,
        "a CSV file with columns product,price",
    )
    curve: QuotedCurveTable | None = doc(
        "how the daily forward curve is made from the quotes", None, CURVE
    )
    interest_rate: CaseInput = ZERO_RATE("continuous zero rate", 0.0)
    settlement: Settlement = doc("when the gas of a day is paid", "flow", RULES)


class StorageTable(CaseTable):
    """The whole file."""

    kind: Literal["gas-storage"] = doc("kind of the case")
    title: Title = "Gas storage"
    contract: dict = subtable("dates, volumes, rates and costs", "contract")
    market: dict = subtable("valuation date, forward curve and interest rates", "market")
    model: dict = subtable("model of the spot price", "model")
    products: dict | None = subtable(
        "traded products, for rolling intrinsic values and hedges", "products", None
    )
    hedge: dict | None = subtable("hedges that are simulated", "hedge", None)
    backtest: dict | None = subtable("estimates of the model in a back-test", "backtest", None)
    report: ReportKey
    objective: ObjectiveKey
    training: TrainingKey
    evaluation: EvaluationKey
