"""The table `[contract]` of a power plant, and its reader; see `plant.py`."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.quantity import ANY, NOT_NEGATIVE, POSITIVE, Quantity, stacked
from snapo.case.table import CaseTable, TableContext, doc, parse

from ..read.hours import HourlyContractTable, Hours
from .plant import PlantContract, layout_of
from .ramp import PowerSteps, power_steps

GROUP, COST = "contract", "cost"
LONGEST = 72  # modes: hours off until the last class of starts, and least hours on
MODES = 150  # on, of a plant with a ramp: least hours on times powers
POWER = Quantity("MW", NOT_NEGATIVE, GROUP, move=1.0)
FUEL = Quantity("MWh", NOT_NEGATIVE, GROUP, move=1.0)
RATE = Quantity("1", POSITIVE, GROUP, move=0.01)
MONEY = Quantity("{currency}", NOT_NEGATIVE, COST, move=100.0)
BY_MWH = Quantity("{currency}/MWh", ANY, COST, move=0.1, by="date")
HOURS = f"a whole number of hours, 1 to {LONGEST}"
ANY_HOURS = "a whole number of hours, 1 or more"
STARTS = "a list like [{ off = 3, money = 2500.0, fuel = 60.0 }]"


class PowerTable(CaseTable):
    """{ market = "power", min = 50.0, max = 110.0, ramp = 60.0 }: limits of the power, in MW, while
    the plant is on."""

    market: Literal["power"] = doc("market in which the power is sold", "power")
    min: CaseInput = POWER("minimum power while the plant is on", 0.0, name="power_min")
    max: CaseInput = POWER("largest power while the plant is on", range=POSITIVE, name="power_max")
    ramp: CaseInput | None = POWER(
        "largest change of the power from one hour to the next", None, range=POSITIVE, name="ramp"
    )


class FuelTable(CaseTable):
    """{ market = "gas", idle = 45.0, per_mwh = 1.6 }: the fuel in MWh, for each hour in which the
    plant is on and for each MWh of power."""

    market: Literal["gas"] = doc("market in which the fuel is bought", "gas")
    idle: CaseInput = FUEL(
        "fuel for each hour in which the plant is on, at any power", 0.0, name="fuel_idle"
    )
    per_mwh: CaseInput = RATE("fuel for each MWh of power", name="fuel_per_mwh")


class EmissionTable(CaseTable):
    """{ per_fuel = 0.2, price = 70.0 }: the number of certificates for each MWh of fuel, and their
    price; or { per_fuel = 0.2, market = "co2" }."""

    per_fuel: CaseInput = Quantity("1", NOT_NEGATIVE, GROUP, move=0.01)(
        "certificates for each MWh of fuel", 1.0, name="emission_per_fuel"
    )
    price: CaseInput | None = replace(BY_MWH, unit="{currency}", range=NOT_NEGATIVE)(
        "price of a certificate", None, name="emission_price"
    )
    market: Literal["co2"] | None = doc(
        "market of the certificates, instead of a price", None,
        '"co2", if the price moves as in [market.co2] and [model.co2]',
    )  # fmt: skip


class StartTable(CaseTable):
    """{ off = 12, money = 5200.0, fuel = 140.0 }: the cost of a start after at least that number of
    hours off."""

    off: int = doc(
        "hours off from which a start belongs to this class", allowed=HOURS, ge=1, le=LONGEST
    )
    money: CaseInput = MONEY("money paid for a start", 0.0, name="start_money")
    fuel: CaseInput = FUEL("fuel for a start", 0.0, name="start_fuel")


class BeforeTable(CaseTable):
    """{ off = 12 } or { on = 6, power = 80.0 }: for how many hours the plant has been off, or on,
    before the first hour."""

    off: int | None = doc("hours off before the first hour", None, ANY_HOURS, ge=1, le=100_000)
    on: int | None = doc("hours on before the first hour", None, ANY_HOURS, ge=1, le=100_000)
    power: CaseInput | None = POWER(
        "power in the hour before the first one, if the plant has a ramp", None, name="power_before"
    )


class PowerPlantTable(HourlyContractTable):
    """`[contract]` of kind "plant"."""

    power: dict = doc(
        "power while the plant is on, in MW",
        allowed='a table like { market = "power", min = 50.0, max = 110.0 }',
    )
    fuel: dict = doc(
        "fuel for each hour in which the plant is on, and for the power, in MWh",
        allowed='a table like { market = "gas", idle = 45.0, per_mwh = 1.6 }',
    )
    emission: dict | None = doc(
        "certificates for the fuel, and their price",
        None,
        "a table like { per_fuel = 0.2, price = 70.0 }",
    )
    other_cost: CaseInput = BY_MWH("other costs for each MWh of power", 0.0)
    starts: list[Any] = doc(
        "classes of starts by hours off; without classes starts are free", [], STARTS
    )
    min_up: int = doc(
        "smallest number of hours that the plant stays on after a start", 1, HOURS, ge=1, le=LONGEST
    )
    min_down: int = doc(
        "smallest number of hours that the plant stays off after a stop", 1, HOURS, ge=1, le=LONGEST
    )
    most_starts: int | None = doc(
        "largest number of starts in the term", None, "a whole number of starts, 1 or more", ge=1
    )
    before: dict | None = doc(
        "hours on or off before the first hour, by default off for a long time",
        None,
        "a table like { off = 12 } or { on = 6 }",
    )


def read_plant(where: TableContext, table: PowerPlantTable, hours: Hours) -> PlantContract:
    """The contract in these hours."""
    days = hours.days
    power = where.nested(PowerTable, table.power, "power")
    fuel = where.nested(FuelTable, table.fuel, "fuel")
    emission = where.nested(
        EmissionTable, {"price": 0.0} if table.emission is None else table.emission, "emission"
    )
    if (emission.price is None) == (emission.market is None):
        message = 'it must have one of `price` and `market = "co2"`'
        raise where.error("emission", table.emission, message)
    low, high = (float(x.values[0]) for x in (power.min, power.max))
    if low > high:
        raise where.error("power.min", low, f"it must be at most power.max, {high:g}")
    starts, before = _starts(where, table), where.nested(BeforeTable, table.before or {}, "before")
    if before.on is not None and before.off is not None:
        raise where.error("before", table.before, "it must be `off` or `on`, not both")
    steps = _power_steps(where, power, before)
    first = (False, before.off or LONGEST) if before.on is None else (True, before.on)
    # A limit that no plant of these minimum times can reach is none.
    possible = -(-(len(days) + table.min_down) // (table.min_up + table.min_down))
    limited = table.most_starts is not None and table.most_starts < possible
    off = tuple(start.off for start in starts)
    numbers = table.min_up, table.min_down, off, first, limited
    layout, classes, runs, powers = layout_of(*numbers, steps)
    if steps is not None and sum(name.startswith("on") for name in layout.modes) > MODES:
        raise _too_many(where, power)
    return PlantContract(  # pyright: ignore[reportCallIssue]
        power.min,
        power.max,
        fuel.idle,
        fuel.per_mwh,
        emission.per_fuel,
        None
        if emission.price is None
        else replace(emission.price, unit=table.currency).on(days, where.notes),
        table.other_cost.on(days, where.notes),
        _by_class("start_money", starts, [replace(x.money, unit=table.currency) for x in starts]),
        _by_class("start_fuel", starts, [x.fuel for x in starts]),
        layout=layout,  # pyright: ignore[reportCallIssue]
        classes=classes,
        runs=runs,
        start_limit=(table.most_starts or 0) if limited else 0,
        ramp=power.ramp,
        power_before=before.power if before.on is not None else None,
        steps=steps,
        powers=powers if steps is not None and steps.steps else (),
    )


def _power_steps(where: TableContext, power: PowerTable, before: BeforeTable) -> PowerSteps | None:
    """The powers of a plant with a ramp; None without a ramp."""
    before_power = None if before.power is None else float(before.power.values[0])
    if before_power is not None and (power.ramp is None or before.on is None):
        message = "it may have a power only if the plant is on and has a ramp"
        raise where.error("before.power", before_power, message)
    if power.ramp is None:
        return None
    low, high, ramp = (float(x.values[0]) for x in (power.min, power.max, power.ramp))
    if before_power is not None and not low <= before_power <= high:
        message = f"it must be from power.min, {low:g}, to power.max, {high:g}"
        raise where.error("before.power", before_power, message)
    if before.on is not None and before_power is None and ramp < high:
        message = "with a ramp it needs the power of that hour, such as { on = 6, power = 80.0 }"
        raise where.error("before", {"on": before.on}, message)
    if high - low > MODES * ramp:
        raise _too_many(where, power)
    return power_steps(low, high, ramp, before_power)


def _too_many(where: TableContext, power: PowerTable) -> CaseError:
    """The error for a plant with too many modes in which it runs."""
    ramp = None if power.ramp is None else float(power.ramp.values[0])
    message = (
        f"the plant has more than {MODES} states in which it runs, by hours and power; a larger "
    )
    return where.error("power.ramp", ramp, f"{message}ramp, or a smaller min_up, gives fewer")


def _by_class(
    name: str, starts: Sequence[StartTable], numbers: Sequence[CaseInput]
) -> CaseInput | None:
    """One number of every class of starts, index [classes]; None without classes."""
    if not starts:
        return None
    labels = tuple(f"{start.off} hours off" for start in starts)
    return replace(stacked(name, numbers), labels=labels)


def _starts(where: TableContext, table: PowerPlantTable) -> list[StartTable]:
    """The classes of starts, by rising hours off; the first is that of the earliest start."""
    starts = [
        parse(StartTable, entry, str(where.file), f"{where.name}.starts.{i + 1}", where.notes,
              (*where.keys, "starts", i))
        for i, entry in enumerate(table.starts)
    ]  # fmt: skip
    for i, start in enumerate(starts):
        if not i and start.off > table.min_down:
            message = (
                f"it must be at most min_down = {table.min_down}, so that every start has a class"
            )
            raise where.error("starts.1.off", start.off, message)
        if i and start.off <= starts[i - 1].off:
            message = f"it must be more than that of the class before, {starts[i - 1].off}"
            raise where.error(f"starts.{i + 1}.off", start.off, message)
    return starts
