"""Battery: energy bought and sold by the hour, with losses, wear and a limit on cycles.

    earnings = sum over hours of discount x (d (efficiency out S - wear) - c S / efficiency in)

c is the energy stored in an hour, and d the energy taken from the store, both measured in the
store: c is at most power in x efficiency in, and d at most power out. A cycle is `energy` taken;
the cycles of each calendar day, and of the whole term, may be limited.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import ceil

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.quantity import NOT_NEGATIVE, POSITIVE, Quantity, Range
from snapo.case.table import CaseTable, TableContext, doc
from snapo.problem.record import field
from snapo.problem.record.arrays import Array, Bool, NumbersOf
from snapo.problem.record.either import xp

from ..core.contract import (
    ContractLayout,
    EnergyContract,
    EnergyFlow,
    FallingLimit,
    Intraday,
    Level,
    StepTerms,
    Terms,
)
from ..methods.measure import common_measure
from ..read.auction import AUCTION
from ..read.hours import HourlyContractTable, Hours
from .fade import FADE, StoreFade, read_fade
from .reserve import IN_RESERVE, MODES, RESERVE, SoldReserve, read_reserve, with_reserve

NARROWEST, WIDEST = 0.01, 0.1  # of the energy: a wider bump would be no derivative
MAX_TRIES = 100
ROUND_OFF = 1e-9
GROUP = "contract"
ENERGY = Quantity("MWh", POSITIVE, GROUP, move=0.1, name="energy")
POWER = Quantity("MW", POSITIVE, GROUP, move=0.1)
EFFICIENCY = Quantity("1", Range(0.0, 1.0, "(]"), GROUP, move=0.01,
                      display_unit="percentage point", display_factor=100.0)  # fmt: skip
CYCLES = Quantity("1", POSITIVE, GROUP, move=0.1)


class ChargeTable(CaseTable):
    """{ power = 1.0, efficiency = 0.9 }: the power bought, in MW, and the share of it that is
    stored."""

    power: CaseInput = POWER("power bought while the battery charges", name="charge_power")
    efficiency: CaseInput = EFFICIENCY("efficiency of charging", 1.0, name="charge_efficiency")


class DischargeTable(CaseTable):
    """{ power = 1.0, efficiency = 0.95 }: the power taken from the store, in MW, and the share of
    it that is sold."""

    power: CaseInput = POWER("power taken from the store", name="discharge_power")
    efficiency: CaseInput = EFFICIENCY(
        "efficiency of discharging", 1.0, name="discharge_efficiency"
    )


class CyclesTable(CaseTable):
    """{ day = 1.5, term = 60.0 }: limits on the cycles of each calendar day and of the whole
    term."""

    day: CaseInput | None = CYCLES(
        "largest number of cycles on a calendar day", None, name="cycles_day"
    )
    term: CaseInput | None = CYCLES(
        "largest number of cycles in the whole term", None, name="cycles_term"
    )


class IntradayTable(CaseTable):
    """{ half_spread = 2.0 }: differences from the schedule are bought at the spot price of the hour
    plus the half spread, and sold at the spot price minus the half spread."""

    half_spread: CaseInput = Quantity("{currency}/MWh", NOT_NEGATIVE, "cost", move=0.1)(
        "half of the spread, paid for each MWh that differs from the schedule"
    )


class BatteryTable(HourlyContractTable):
    """`[contract]` of kind "battery"."""

    energy: CaseInput = ENERGY("largest energy in store")
    stored: CaseInput = Quantity("MWh", NOT_NEGATIVE, GROUP, move=0.1)(
        "energy in store at the start", 0.0
    )
    charge: dict = doc(
        "power bought, in MW, and the share of it that is stored",
        allowed="a table like { power = 1.0, efficiency = 0.9 }",
    )
    discharge: dict = doc(
        "power taken from the store, in MW, and the share of it that is sold",
        allowed="a table like { power = 1.0, efficiency = 0.95 }",
    )
    wear: CaseInput = Quantity("{currency}/MWh", NOT_NEGATIVE, "cost", move=0.1)(
        "cost of each MWh taken from the store", 0.0
    )
    cycles: dict | None = doc(
        "largest numbers of cycles; a cycle is `energy` taken", None, "a table like { day = 1.5 }"
    )
    auction: dict | None = doc("auctions that fix the flows of a block of hours", None, AUCTION)
    intraday: dict | None = doc(
        "terms of trading differences from the schedule of an auction",
        None,
        "a table like { half_spread = 2.0 }",
    )
    reserve: dict | None = doc(
        "capacity sold as reserve by the hour or by the block", None,
        "a table like { price = 10.0, stock = [1.0, 3.0] }",
    )  # fmt: skip
    fade: dict | None = doc(
        "how the largest energy in store falls with the energy taken",
        None,
        "a table like { every = 30.0, by = 0.5 }",
    )


class BatteryContract(EnergyContract):
    """The terms of a battery; see `BatteryTable`. `day_ends` [T]: whether an hour is the last one
    of a local day."""

    energy: CaseInput
    stored: CaseInput
    charge: CaseInput
    charge_efficiency: CaseInput
    discharge: CaseInput
    discharge_efficiency: CaseInput
    wear: CaseInput
    cycles_day: CaseInput | None
    cycles_term: CaseInput | None
    day_ends: Bool[np.ndarray, " T"]
    half_spread: CaseInput | None
    reserve: SoldReserve | None
    fade: StoreFade | None
    layout: ContractLayout = field(static=True)

    def terms(self, at: NumbersOf, paid: Array, settled: Array) -> Terms:
        count = len(self.day_ends)
        one, zero = xp.ones(count), xp.zeros(count)
        energy, into = at(self.energy), at(self.charge_efficiency)
        out, wear = at(self.discharge_efficiency), at(self.wear)
        charge, discharge = at(self.charge), at(self.discharge)
        high, again = [energy * one], [xp.zeros(count, bool)]
        day, term = self._cycles(at, discharge * count / energy)
        if day is not None:
            high.append(day * energy * one)
            again.append(xp.asarray(self.day_ends))
        stored, before, falling = at(self.stored), 0.0, None
        if self.fade is not None:
            fade = self.fade
            falling = FallingLimit(one * fade.every, one * at(fade.by))
            reach = fade.reach(count, stored, charge * into, discharge) / energy
            if day is not None:
                reach = xp.minimum(reach, day * xp.sum(self.day_ends))
            term, before = reach if term is None else xp.minimum(term, reach), fade.taken
        if term is not None:
            high.append((before + term * energy) * one)
            again.append(xp.zeros(count, bool))
        none = xp.zeros((count, len(high)))
        start = xp.append(stored, xp.zeros(len(high) - 1))
        if self.fade is not None:
            start = xp.append(start[:-1], before)
        intraday = None
        if self.half_spread is not None:
            sold = xp.stack([-one / into, one * out], axis=1)
            spread = at(self.half_spread) * one
            intraday = Intraday(spread, paid * one, sold)
        steps = StepTerms(
            xp.zeros((count, 2)),
            xp.stack([charge * into * one, discharge * one], axis=1),
            xp.stack([-paid / into, paid * out], axis=1),
            xp.stack([zero, -wear * paid], axis=1),
            none,
            xp.stack(high, axis=1),
            none,
            none,
            xp.stack(again, axis=1),
            xp.zeros((count, 1)),
            intraday=intraday,
            falling=falling,
        )
        if self.reserve is not None:
            power = xp.minimum(charge, discharge * out)
            steps = self.reserve.added(steps, at(self.reserve.price) * power * paid)
        return Terms(start, steps)

    def _cycles(self, at: NumbersOf, highest: Array) -> tuple[Array | None, Array | None]:
        """Limits of a day and of the term. If one of the two implies the other one, the implied
        limit is raised to at least `highest`, the cycles of all hours. No plan reaches that number,
        and methods need no nodes for it."""
        day, term = (x and at(x) for x in (self.cycles_day, self.cycles_term))
        if day is None or term is None:
            return day, term
        days = xp.sum(self.day_ends)
        return (
            xp.where(day > term, xp.maximum(day, highest), day),
            xp.where(term >= days * day, xp.maximum(term, highest), term),
        )

    def keys_at(self, levels: Mapping[str, float], mode: str, index: float | None) -> dict:
        if mode == MODES[IN_RESERVE]:
            raise ValueError(
                "the valuation date lies within a block in reserve, but a case cannot begin "
                "within such a block"
            )
        keys = {"stored": levels["energy"]}
        if self.fade is not None:
            keys["fade.taken"] = levels["taken"]
        if self.cycles_term is not None:
            before = 0.0 if self.fade is None else float(self.fade.taken)
            used = (levels["taken"] - before) / float(self.energy.used())
            keys["cycles.term"] = float(self.cycles_term.used()) - used
        return keys


def layout_of(day: bool, term: bool) -> ContractLayout:
    """The levels (energy in store, and the energy taken today and in the whole term) and the
    flows."""
    levels = [Level("energy", "MWh")]
    levels += [Level("taken today", "MWh")] * day + [Level("taken", "MWh")] * term
    counted = len(levels) - 1
    charge = EnergyFlow("charge", "MWh", (1.0, *(0.0,) * counted))
    return ContractLayout(
        tuple(levels), (charge, EnergyFlow("discharge", "MWh", (-1.0, *(1.0,) * counted)))
    )


def bumps(
    energy: float,
    others: Sequence[float],
    powers: tuple[ChargeTable, DischargeTable],
    cycles: CyclesTable,
) -> tuple[float | None, float | None]:
    """The smallest moves of energy and of cycles, of at least 1 %, that a finite difference can
    make. After such a move, or half of it, all volumes and `others` are still multiples of their
    common measure, as the nodes are. None for a move that would exceed `WIDEST`."""
    into, out = ([float(x.values[0]) for x in (y.power, y.efficiency)] for y in powers)
    limits = [float(x.values[0]) for x in (cycles.day, cycles.term) if x is not None]
    measure = common_measure(
        [energy, *others, into[0] * into[1], out[0], *(energy * x for x in limits)]
    )
    if measure is None or 2 * measure > WIDEST * energy:
        return None, None
    first, last = (share * energy / (2 * measure) for share in (NARROWEST, WIDEST))
    first = max(ceil(first - ROUND_OFF), 1)
    for times in range(first, min(int(last + ROUND_OFF), first + MAX_TRIES) + 1):
        if all(abs(x * times - round(x * times)) < ROUND_OFF for x in limits):
            return 2 * measure * times, 2 * measure * first / energy
    return None, 2 * measure * first / energy


def read_battery(where: TableContext, table: BatteryTable, hours: Hours) -> BatteryContract:
    """Reads the contract in these hours, with the auctions at which flows are fixed."""
    charge = where.nested(ChargeTable, table.charge, "charge")
    discharge = where.nested(DischargeTable, table.discharge, "discharge")
    cycles = where.nested(CyclesTable, table.cycles or {}, "cycles")
    intraday = table.intraday
    if intraday is not None:
        intraday = where.nested(IntradayTable, intraday, "intraday")
        unit = f"{table.currency}/{table.volume_unit}"
        intraday = replace(intraday.half_spread, unit=unit)
    stored, energy = float(table.stored.values[0]), float(table.energy.values[0])
    if stored > energy:
        raise where.error("stored", stored, f"it must be at most energy, {energy:g}")
    reserve, fade, others = None, None, [stored]
    for name in (RESERVE, FADE) if intraday is not None else ():
        if (raw := getattr(table, name)) is not None:
            message = "it cannot be combined with `intraday`; leave out one of the two"
            raise where.error(name, raw, message)
    if table.fade is not None:
        fade = read_fade(where, table.fade, energy)
        others += [float(x) for x in (fade.every, fade.by.values[0], fade.taken)]
    if table.reserve is not None:
        reserve = read_reserve(where, table.reserve, hours, energy, table.currency)
        others += reserve.stock.tolist()
    steps = bumps(energy, others, (charge, discharge), cycles)
    day, term = (x and replace(x, judge_bump=steps[1]) for x in (cycles.day, cycles.term))
    if fade is not None and steps[0] is not None and steps[0] <= fade.by.values[0]:
        fade = replace(fade, by=replace(fade.by, judge_bump=steps[0]))
    ends = [one != following for one, following in zip(hours.days, [*hours.days[1:], None])]
    return BatteryContract(  # pyright: ignore[reportCallIssue]
        replace(table.energy, judge_bump=steps[0]),
        table.stored,
        charge.power,
        charge.efficiency,
        discharge.power,
        discharge.efficiency,
        table.wear,
        day,
        term,
        np.array(ends, bool),
        intraday,
        reserve,
        fade,
        layout=with_reserve(  # pyright: ignore[reportCallIssue]
            layout_of(cycles.day is not None, cycles.term is not None or fade is not None), reserve
        ),
    )
