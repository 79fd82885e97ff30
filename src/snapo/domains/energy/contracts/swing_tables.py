"""The table `[contract]` of a swing contract, and its reader; see `swing.py`."""

import datetime
import re
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.quantity import NOT_NEGATIVE, Quantity, custom
from snapo.case.table import AnyTable, CaseTable, TableContext, doc

from ...gas_storage.read.tables import PRICE, Currency, DateKey, NominationKey, VolumeUnit
from .swing import SwingContract, layout_of

GROUP = "contract"
MONTH_DAY = re.compile(r"\d{2}-\d{2}", re.ASCII)
A_DAY, A_YEAR = "{volume_unit}/day", "{volume_unit}/year"
RATE = Quantity(A_DAY, NOT_NEGATIVE, GROUP, move=0.1, by="date", before=0.0)
STRIKE = Quantity(PRICE, group="strike", move=0.1, by="date", meaning="price paid for a unit")
FACTOR = Quantity("1", NOT_NEGATIVE, "strike", move=0.01)
ADDED = Quantity(PRICE, group="strike", move=0.1)
STRIKES = ('a number, the name of a CSV file with columns date,value, or a table such as '
           '{ index = "month-ahead", factor = 1.0, add = 0.25 }')  # fmt: skip
ANNUAL = Quantity(A_YEAR, NOT_NEGATIVE, GROUP, move=1.0)
TAKEN = Quantity("{volume_unit}", NOT_NEGATIVE, GROUP, move=1.0)
PAID = Quantity(PRICE, NOT_NEGATIVE, "strike", move=0.1)
SHORT = Quantity(PRICE, NOT_NEGATIVE, "strike", move=0.1, name="shortfall",
                 meaning="price paid for each unit short of the annual minimum")  # fmt: skip
SHORTFALL = '"firm", "strike", or a price of each unit such as 6.0'


class AnnualTable(CaseTable):
    """{ min = 200.0, max = 300.0 }: limits of the volume in each contract year."""

    min: CaseInput = ANNUAL("minimum volume of a contract year", 0.0, name="annual_min")
    max: CaseInput | None = ANNUAL("maximum volume of a contract year", None, name="annual_max")


class RightsTable(CaseTable):
    """{ most = 100, rest = 5 }: the number of days on which a volume may be taken, and the days of
    rest between them."""

    most: int = doc(
        "largest number of days on which a volume is taken",
        allowed="a whole number of days, 1 or more", ge=1, le=100_000,
    )  # fmt: skip
    rest: int = doc(
        "days of rest after a day with a volume",
        0,
        "a whole number of days, 0 to 365",
        ge=0,
        le=365,
    )


class MakeUpTable(CaseTable):
    """{ years = 2, price = 0.0 }: units short of the minimum are paid, and may be made up within
    that number of years."""

    years: int = doc(
        "number of contract years in which missing units may be made up", 1,
        "1 or 2, because the methods allow at most three volumes in the state", ge=1, le=2,
    )  # fmt: skip
    price: CaseInput = PAID("price of a unit that is made up", 0.0, name="make_up_price")
    units: CaseInput = TAKEN(
        "units short of the minimum in the last contract year", 0.0, name="make_up_units"
    )
    older_units: CaseInput | None = TAKEN(
        "units short in the year before that, still to be made up", None, name="make_up_older_units"
    )


class CarryTable(CaseTable):
    """{ years = 1, max = 8.0 }: units above the minimum lower the minimum of the next year."""

    years: int = doc(
        "number of contract years in which units carried forward count",
        1,
        "1",
        ge=1,
        le=1,
    )
    max: CaseInput = TAKEN("largest volume carried forward", name="carry_forward_max")
    units: CaseInput = TAKEN(
        "units carried forward into this contract year", 0.0, name="carry_forward_units"
    )


class IndexTable(CaseTable):
    """{ index = "month-ahead", factor = 1.0, add = 0.25 }: an indexed strike."""

    index: Literal["month-ahead"] = doc(
        "index of the strike: the mean forward price of a month on the last day before it"
    )
    factor: CaseInput = FACTOR("factor of the index in the strike", 1.0, name="strike_factor")
    add: CaseInput = ADDED("amount added to the index in the strike", 0.0, name="strike_add")
    fixing: CaseInput | None = ADDED("index of the first month, fixed before today", None,
                                    name="strike_fixing")  # fmt: skip


def _strike(raw: Any, key: Any) -> CaseInput | IndexTable | None:
    """A number, a CSV, or a table."""
    if not isinstance(raw, dict):
        if isinstance(raw, bool) or not isinstance(raw, int | float | str):
            raise key.error(raw, f"it must be {STRIKES}")
        return STRIKE.read(raw, key)
    unit = key.filled(PRICE)
    return _with_units(key.table.nested(IndexTable, raw, key.name), {"add": unit, "fixing": unit})


def _with_units(table: AnyTable, units: dict[str, str]) -> AnyTable:
    """Sets the units of the numbers in a table within a table; there, names such as "currency" in a
    unit are not replaced yet."""
    numbers = {x: replace(y, unit=units[x]) for x, y in table if x in units and y is not None}
    return table.model_copy(update=numbers)


def _short(raw: Any, key: Any) -> CaseInput | str:
    """ "firm", "strike", or an amount."""
    if raw in ("firm", "strike"):
        return raw
    if isinstance(raw, str):
        raise key.error(raw, f"it must be {SHORTFALL}")
    result = SHORT.read(raw, key)
    assert result is not None
    return result


class SwingTable(CaseTable):
    """`[contract]` of kind "swing"."""

    volume_unit: VolumeUnit
    currency: Currency
    start: DateKey = doc("first day with a decision")
    end: DateKey = doc("first day without a decision")
    side: Literal["call", "put"] = doc("whether a volume is bought or sold at the strike", "call")
    max_daily: CaseInput = RATE("largest volume per day")
    min_daily: CaseInput = RATE("volume that must be taken each day", 0.0)
    strike: Any = custom(
        "price of a unit, in currency/volume_unit",
        _strike,
        STRIKES,
        types=("number", "string", "object"),
    )
    year_begins: str | None = doc(
        "first day of a contract year, by default that of start",
        None,
        'a day of the year such as "10-01"',
    )
    annual: dict | None = doc(
        "minimum and maximum volume of a contract year",
        None,
        "a table like { min = 200.0, max = 300.0 }",
    )
    shortfall: Any = custom(
        "price of a unit short of the annual minimum, in currency/volume_unit",
        _short,
        SHORTFALL,
        "firm",
        ("string", "number"),
    )
    taken: CaseInput = TAKEN("volume of this contract year before the first decision", 0.0)
    rights: dict | None = doc(
        "number of days on which a volume may be taken, and days of rest",
        None,
        "a table like { most = 100, rest = 5 }",
    )
    make_up: dict | None = doc(
        "units short of the minimum that may be made up in later years",
        None,
        "a table like { years = 1, price = 0.0 }",
    )
    carry_forward: dict | None = doc(
        "units above the minimum that lower the minimum of the next year",
        None,
        "a table like { years = 1, max = 8.0 }",
    )
    nomination: NominationKey


def read_swing(where: TableContext, table: SwingTable, days) -> SwingContract:
    """The contract on its decision days."""
    notes, annual, rights = where.notes, None, None
    if table.annual is not None:
        annual = where.nested(AnnualTable, table.annual, "annual")
    if table.rights is not None:
        rights = where.nested(RightsTable, table.rights, "rights")
    daily_max, daily_min = (x.on(days, notes) for x in (table.max_daily, table.min_daily))
    strike, index = table.strike, None
    if isinstance(strike, IndexTable):
        strike, index = None, strike
        if table.start.day != 1:
            message = "with an indexed strike it must be the first day of a month"
            raise where.error("start", table.start, message)
        if table.shortfall == "strike":
            message = 'with an indexed strike it must be "firm", or a price such as 6.0'
            raise where.error("shortfall", "strike", message)
    else:
        strike = strike.on(days, notes)
    for t in np.flatnonzero(daily_min.used() > daily_max.used())[:1]:
        message = f"on {days[t]} at most {daily_max.used()[t]:g} may be taken"
        raise where.error("min_daily", float(daily_min.used()[t]), message)
    limits = _annual(where, table, annual)
    if rights is not None and np.any(daily_min.used() > 0):
        raise where.error("min_daily", float(daily_min.used().max()), "with rights, it must be 0")
    minimum = limits[0]
    firm = table.shortfall == "firm"
    last_days = year_ends(where, table, days)
    if rights is not None and firm and minimum is not None and minimum.values[0] > 0:
        _check_promise(where, table, rights, float(minimum.values[0]), daily_max.used(), last_days)
    made_up, carried = _banked(where, table)
    banks = 0
    if made_up is not None or carried is not None:
        banks = 1 if made_up is None else made_up.years
        _check_bank(where, table, (made_up, carried), limits, strike, daily_max.used(), last_days)
    limited = limits[0] is not None or limits[1] is not None
    short = table.shortfall if isinstance(table.shortfall, CaseInput) else None
    return SwingContract(  # pyright: ignore[reportCallIssue]
        daily_max,
        daily_min,
        strike,
        *((None, None, None) if index is None else (index.factor, index.add, index.fixing)),
        *limits,
        table.taken,
        short if minimum is not None else None,
        *((None, None) if made_up is None else (made_up.price, made_up.units)),
        None if made_up is None else made_up.older_units,
        *((None, None) if carried is None else (carried.max, carried.units)),
        last_days,
        layout=layout_of(  # pyright: ignore[reportCallIssue]
            table.volume_unit,
            limited,
            None if rights is None else rights.rest,
            index is not None,
            banks,
        ),
        sign=1.0 if table.side == "call" else -1.0,
        at_strike=table.shortfall == "strike",
        firm=firm,
        most_rights=0 if rights is None else rights.most,
    )


def _check_promise(
    where: TableContext,
    table: SwingTable,
    rights: RightsTable,
    minimum: float,
    daily_max: np.ndarray,
    last_days: np.ndarray,
) -> None:
    """Refuses a firm minimum with rights over several contract years, with a daily volume that
    changes, or that cannot be met."""
    if np.sum(last_days) > 1:
        message = "with rights the minimum cannot be firm in several contract years; use "
        raise where.error("shortfall", "firm", f'{message}"strike" or a price of each unit')
    if np.ptp(daily_max) > 0:
        message = "with rights and a firm minimum it must be one number for all days"
        raise where.error("max_daily", float(daily_max.max()), message)
    uses = min(rights.most, -(-len(last_days) // (rights.rest + 1)))
    highest = float(table.taken.values[0]) + uses * float(daily_max[0])
    if minimum > highest * (1 + 1e-12):
        message = f"it must be at most {highest:g}, the volume of {uses} uses of {daily_max[0]:g}"
        raise where.error("annual.min", minimum, message)


def _banked(where: TableContext, table: SwingTable) -> tuple[MakeUpTable | None, CarryTable | None]:
    """The clauses `make_up` and `carry_forward`, with the units of their numbers."""
    unit = table.volume_unit
    units = {"units": unit, "older_units": unit, "max": unit, "price": f"{table.currency}/{unit}"}
    made_up, carried = None, None
    if table.make_up is not None:
        raw = ({"older_units": 0.0} if table.make_up.get("years") == 2 else {}) | table.make_up
        made_up = _with_units(where.nested(MakeUpTable, raw, "make_up"), units)
    if table.carry_forward is not None:
        read = where.nested(CarryTable, table.carry_forward, "carry_forward")
        carried = _with_units(read, units)
    return made_up, carried


def _check_bank(
    where: TableContext, table: SwingTable, clauses, limits, strike, daily_max, last_days
) -> None:
    """Refuses clauses between contract years (see `_banked`) whose conditions are not met."""
    made_up, carried = clauses
    key = "carry_forward" if made_up is None else "make_up"
    if limits[0] is None:
        raise where.error(
            key, None, "this clause needs an annual minimum, such as annual = { min = 200.0 }"
        )
    if table.rights is not None:
        raise where.error(key, None, "this clause cannot be combined with rights")
    minimum, units = float(limits[0].values[0]), [0.0, 0.0]
    if made_up is not None:
        if table.shortfall != "strike":
            message = 'with make_up it must be "strike": missing units are paid, and made up later'
            raise where.error("shortfall", table.shortfall, message)
        if table.side == "put":
            raise where.error("side", "put", 'with make_up it must be "call"')
        price, balances = float(made_up.price.values[0]), {"units": made_up.units}
        lowest = float(strike.used().min()) if strike is not None else np.inf
        if price > lowest:
            raise where.error("make_up.price", price, f"it must be at most the strike, {lowest:g}")
        if made_up.older_units is not None:
            balances["older_units"] = made_up.older_units
            if made_up.years == 1:
                wrong = float(made_up.older_units.values[0])
                raise where.error("make_up.older_units", wrong, "it needs make_up.years = 2")
        for name, number in balances.items():
            balance = float(number.values[0])
            units[0] += balance
            if balance > minimum:
                message = f"it must be at most annual.min, {minimum:g}"
                raise where.error(f"make_up.{name}", balance, message)
    if carried is not None:
        units[1], highest = float(carried.units.values[0]), float(carried.max.values[0])
        if units[1] > highest:
            message = f"it must be at most carry_forward.max, {highest:g}"
            raise where.error("carry_forward.units", units[1], message)
    if min(units) > 0:
        message = "it must be 0: a year is either short of its minimum or in excess"
        raise where.error("make_up.units", units[0], message)
    if table.shortfall != "firm":
        return
    before, first = float(table.taken.values[0]) + units[1], 0
    for last in np.flatnonzero(last_days):
        highest = before + float(daily_max[first : last + 1].sum())
        if minimum > highest * (1 + 1e-12):
            message = f"in a contract year at most {highest:g} can be taken"
            raise where.error("annual.min", minimum, message)
        before, first = 0.0, last + 1


def _annual(where: TableContext, table: SwingTable, annual: AnnualTable | None):
    """Minimum and maximum of a year with their units; None for a limit that is absent."""
    if annual is None:
        return None, None
    unit = f"{table.volume_unit}/year"
    limits = _with_units(annual, {"min": unit, "max": unit})
    if limits.max is not None and limits.min.values[0] > limits.max.values[0]:
        message = f"it must be at most annual.max, {limits.max.values[0]:g}"
        raise where.error("annual.min", float(limits.min.values[0]), message)
    return limits.min, limits.max


def year_ends(where: TableContext, table: SwingTable, days) -> np.ndarray:
    """[T] whether a day is the last of its contract year; the last decision day always is.

    A year that begins on 29 February begins on 1 March in other years.
    """
    first = table.start
    if table.year_begins is not None:
        text = table.year_begins
        try:
            first = datetime.date.fromisoformat(f"2000-{text}")
        except ValueError:
            first = None
        if first is None or not MONTH_DAY.fullmatch(text):
            message = 'it must be a day of the year such as "10-01"'
            raise where.error("year_begins", text, message)

    def begins(day: datetime.date) -> bool:
        try:
            return day == first.replace(year=day.year)
        except ValueError:
            return (day.month, day.day) == (3, 1)

    last_days = np.array([begins(day + datetime.timedelta(1)) for day in days], bool)
    if len(last_days):
        last_days[-1] = True
    return last_days
