"""Reads a case of any contract, a TOML file and its CSVs, into an `EnergyCase`."""

import datetime
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput, SourceNumbers
from snapo.case.quantity import by_name, numbers_in
from snapo.case.report import ReportKey, ReportTable
from snapo.case.settings import (
    EvaluationKey,
    EvaluationTable,
    FittedTable,
    ObjectiveKey,
    ObjectiveTable,
    TrainingKey,
    check_window,
    read_evaluation,
    read_objective,
    read_training,
)
from snapo.case.table import CaseTable, Formats, TableContext, Title, doc, parse, subtable
from snapo.problem.record import Input

from ...gas_storage.contract.records import GasMarket
from ...gas_storage.ladder.products import FORMATS as PRODUCTS
from ...gas_storage.ladder.products import TradedProducts, products_of
from ...gas_storage.prices.factors import OneFactorTable
from ...gas_storage.prices.process import Delivery, PriceProcess
from ...gas_storage.prices.registry import check_curve, kinds, read_prices
from ...gas_storage.read.case import read_market
from ...gas_storage.read.nomination import NominationTable, check_nomination, nominated_on
from ...gas_storage.read.tables import MarketTable
from ..contracts.battery import (
    BatteryTable,
    ChargeTable,
    CyclesTable,
    DischargeTable,
    IntradayTable,
    read_battery,
)
from ..contracts.fade import FadeTable
from ..contracts.park_and_loan import ParkAndLoanTable, WindowTable, read_park_and_loan
from ..contracts.plant_tables import (
    BeforeTable,
    EmissionTable,
    FuelTable,
    PowerPlantTable,
    PowerTable,
    StartTable,
    read_plant,
)
from ..contracts.reserve import ReserveTable
from ..contracts.stores_tables import StoresTable, open_stores, read_stores
from ..contracts.swing_tables import (
    AnnualTable,
    CarryTable,
    IndexTable,
    MakeUpTable,
    RightsTable,
    SwingTable,
    read_swing,
)
from ..core.contract import EnergyContract
from .auction import AuctionTable, at_auctions, check_auction
from .hours import HOURS, HourlyMarketTable, hours_of, read_hourly
from .pair import (
    GasMarketTable,
    PairMarketTable,
    PairModelTable,
    PowerMarketTable,
    read_pair_market,
    read_pair_model,
)


class EnergyTable(CaseTable):
    """The whole file."""

    kind: Literal["swing", "battery", "park-and-loan", "plant", "stores"] = doc("kind of the case")
    title: Title = ""
    contract: dict = subtable("dates, volumes, rates and costs", "contract")
    market: dict = subtable("valuation date, forward curves and interest rates", "market")
    model: dict = subtable("model of the spot prices", "model")
    objective: ObjectiveKey
    training: TrainingKey
    evaluation: EvaluationKey
    products: dict | None = doc("hedge products", None, "the table [products] of a daily contract")
    report: ReportKey


class ContractKind(NamedTuple):
    """The parts of a kind of contract: its table, its reader, its title, and the tables within its
    table. The reader takes the decision days of the contract, or its `Hours`. `hourly`: whether
    steps are hours of the local calendar, not days; `pair`: whether cash depends on two
    commodities; `steps`: the steps of a day, all at one price; `opened`: adds the tables of files
    that the table names.
    """

    table: type[CaseTable]
    read: Callable[[TableContext, Any, Any], EnergyContract]
    title: str
    inner: Mapping[str, type[CaseTable]]
    hourly: bool = False
    pair: bool = False
    steps: int = 1
    opened: Callable[[TableContext, Any, Any], Any] | None = None

    @property
    def market(self) -> type[CaseTable]:
        """The format of its `[market]`."""
        if self.pair:
            return PairMarketTable
        return HourlyMarketTable if self.hourly else MarketTable


# Kinds of prices whose steps may be hours.
BY_STEP = ("one-factor", "multi-factor", "three-factor-seasonal")
BY_STEP += ("one-factor-normal", "one-factor-shifted")
BY_HOUR = ("one-factor", "multi-factor", "one-factor-normal", "one-factor-shifted")
KINDS: dict[str, ContractKind] = {
    "swing": ContractKind(
        SwingTable,
        read_swing,
        "Swing contract",
        {
            "strike": IndexTable,
            "annual": AnnualTable,
            "rights": RightsTable,
            "make_up": MakeUpTable,
            "carry_forward": CarryTable,
            "nomination": NominationTable,
        },
    ),
    "battery": ContractKind(
        BatteryTable,
        read_battery,
        "Battery",
        {
            "charge": ChargeTable,
            "discharge": DischargeTable,
            "cycles": CyclesTable,
            "auction": AuctionTable,
            "intraday": IntradayTable,
            "reserve": ReserveTable,
            "fade": FadeTable,
        },
        hourly=True,
    ),
    "park-and-loan": ContractKind(
        ParkAndLoanTable,
        read_park_and_loan,
        "Park and loan",
        {
            "deliver_window": WindowTable,
            "take_window": WindowTable,
            "nomination": NominationTable,
        },
    ),
    "plant": ContractKind(
        PowerPlantTable,
        read_plant,
        "Power plant",
        {
            "power": PowerTable,
            "fuel": FuelTable,
            "emission": EmissionTable,
            "starts[]": StartTable,
            "before": BeforeTable,
        },
        hourly=True,
        pair=True,
    ),
    "stores": ContractKind(
        StoresTable,
        read_stores,
        "Gas stores with joint limits",
        {},
        steps=2,
        opened=open_stores,
    ),
}


@dataclass(frozen=True, eq=False)
class EnergyCase:
    """All data of a case.

    - `kind`: the kind of the contract; `file`, `title`, `volume_unit`, `currency`: for reports.
    - `days` [T]: dates of the steps; `day` [T]: the same in days since the valuation date; `time`
      [T]: the same in years; `first_step`: steps from the valuation date to the first step.
    - `products`: the traded products; None if the case names none.
    - `scheduled`: the model of prices at auctions, if the contract trades differences from its
      schedules intraday; else None, and `model` is the model of prices for all decisions.
    - `sources`: numbers of the case from which inputs are made.
    """

    kind: str
    file: Path
    title: str
    volume_unit: str
    currency: str
    valuation_date: datetime.date
    days: tuple[datetime.date, ...]
    day: np.ndarray
    time: np.ndarray
    first_step: int
    contract: EnergyContract
    market: GasMarket
    model: PriceProcess
    objective: ObjectiveTable
    training: FittedTable
    evaluation: EvaluationTable
    notes: tuple[str, ...] = ()
    products: TradedProducts | None = None
    scheduled: PriceProcess | None = None
    sources: tuple[SourceNumbers, ...] = ()

    def numbers(self) -> Iterator[CaseInput]:
        """Every number of the contract, the market and the prices."""
        return numbers_in((self.contract, self.market, self.model))

    def inputs(self) -> dict[str, Input]:
        """{name: Input} of the contract, the market and the model."""
        return {name: entry.input() for name, entry in by_name(self.numbers()).items()}


def read_case(file: Path, data: Mapping[str, Any]) -> EnergyCase:
    """The case in the TOML file `file`; `data`: the tables of this file.

    **Raises:** `CaseError` if a table, a file or a number is wrong.
    """
    name, notes = str(file), []
    top = parse(EnergyTable, data, name, "")
    parse(ReportTable, top.report, name, "report")
    kind = KINDS[top.kind]
    table: Any = parse(kind.table, top.contract, name, "contract", notes)
    market_table: Any = parse(kind.market, top.market, name, "market", notes)
    valuation, where = market_table.valuation_date, TableContext(file, "contract", notes)
    if kind.opened is not None:
        table = kind.opened(where, table, market_table)
    section, unit = TableContext(file, "market", notes), f"{table.currency}/{table.volume_unit}"
    delivery: Any
    others = at_auction = quoted = None
    if kind.hourly:
        hours = hours_of(where, table, valuation)
        if kind.pair:
            market, others = read_pair_market(section, market_table, hours, unit)
        else:
            market = read_hourly(section, market_table, hours, unit)
        days, delivery = hours.days, replace(hours, curve=market.forward_curve)
        time = np.array(hours.ahead[:-1]) / HOURS
        if not kind.pair:
            auctioned = at_auctions(where, table, delivery)
            delivery, at_auction = (
                (auctioned, None) if table.intraday is None else (delivery, auctioned)
            )
    else:
        days = decision_days(where, table.start, table.end, valuation)
        moving = np.ones(len(days), bool)
        market, quoted = read_market(section, market_table, days, days, moving, unit)
        nominated = nominated_on(where, table, (*days, table.end))
        if kind.steps > 1:
            days = tuple(day for day in days for _ in range(kind.steps))
            market = _by_steps(market, kind.steps)
        delivery = Delivery(days, days, table.end, valuation, market.forward_curve, nominated)
        time = np.array([(date - valuation).days for date in days]) / 365.0
    contract: EnergyContract = kind.read(where, table, delivery if kind.hourly else days)
    section = TableContext(file, "model", notes)
    if others is None:
        if kind.steps > 1 and top.model.get("kind") not in BY_STEP:
            allowed = ", ".join(f'"{item}"' for item in BY_STEP)
            raise section.error("kind", top.model.get("kind"), f"for stores it must be {allowed}")
        if kind.hourly and top.model.get("kind") not in BY_HOUR:
            allowed = ", ".join(f'"{item}"' for item in BY_HOUR)
            raise section.error(
                "kind", top.model.get("kind"), f"for prices by the hour the kind must be {allowed}"
            )
        model = read_prices(section, top.model, delivery)
        check_curve(_curve_file(market_table), model, delivery)
        model = contract.priced(where, model, delivery)
    else:
        table_of_both = parse(PairModelTable, top.model, name, "model", notes)
        model = read_pair_model(section, table_of_both, delivery, others, contract.third_share)
    if kind.hourly and top.products is not None:
        message = "traded products are for daily contracts; a contract by the hour has none"
        raise CaseError(name, "products", None, message)
    products = products_of(file, top.products, notes, days[:: kind.steps], valuation)
    objective = read_objective(top.objective, name)
    training = read_training(top.training, name, FittedTable)
    check_window(training, [objective.kind], name)
    if not kind.hourly:
        check_nomination(where, table, objective.kind, products)
    elif not kind.pair:
        check_auction(where, table, objective.kind)
    day = np.array([(date - valuation).days for date in days], np.int64)
    return EnergyCase(
        top.kind,
        file,
        top.title or kind.title,
        table.volume_unit,
        table.currency,
        valuation,
        days,
        day,
        time,
        delivery.ahead[0],
        contract,
        market,
        model,
        objective,
        training,
        read_evaluation(top.evaluation, name),
        tuple(notes),
        products,
        None if at_auction is None else replace(model, delivery=at_auction.times),  # pyright: ignore
        () if quoted is None else (quoted.source,),
    )


def _by_steps(market: GasMarket, count: int) -> GasMarket:
    """The market of days, with each day repeated for its `count` steps."""
    curve = market.forward_curve
    curve = replace(curve, index=np.repeat(curve.index, count))
    return replace(market, forward_curve=curve, gas_day=np.repeat(market.gas_day, count))


def decision_days(
    where: TableContext, start: datetime.date, end: datetime.date, valuation: datetime.date
) -> tuple[datetime.date, ...]:
    """The remaining decision days of the contract, from the valuation date on."""
    first = max(start, valuation)
    if end <= first:
        message = f"the first day without a decision must come after {first}"
        raise where.error("end", end, message)
    return tuple(first + datetime.timedelta(n) for n in range((end - first).days))


def formats(kind: str) -> Formats:
    """The tables of a kind of contract."""
    this = KINDS[kind]
    inner = {f"contract.{key}": table for key, table in this.inner.items()}
    return {
        "": EnergyTable,
        "contract": this.table,
        **inner,
        "market": this.market,
        **(PAIR if this.pair else {"model": [process.table for process in kinds().values()]}),
        **({} if this.hourly else PRODUCTS),
        "objective": ObjectiveTable,
        "training": FittedTable,
        "evaluation": EvaluationTable,
        "report": ReportTable,
    }


PAIR: Formats = {
    "market.power": PowerMarketTable,
    "market.gas": GasMarketTable,
    "market.co2": GasMarketTable,
    "model": PairModelTable,
    "model.power": OneFactorTable,
    "model.gas": OneFactorTable,
    "model.co2": OneFactorTable,
}


def plant_formats() -> Formats:
    """The tables of a power plant."""
    return formats("plant")


def swing_formats() -> Formats:
    """The tables of a swing contract."""
    return formats("swing")


def battery_formats() -> Formats:
    """The tables of a battery."""
    return formats("battery")


def park_and_loan_formats() -> Formats:
    """The tables of a park-and-loan contract."""
    return formats("park-and-loan")


def stores_formats() -> Formats:
    """The tables of stores."""
    return formats("stores")


def _curve_file(market: Any) -> str:
    """The file of the forward prices, or of the quotes from which they are made."""
    return market.forward_curve or market.quotes
