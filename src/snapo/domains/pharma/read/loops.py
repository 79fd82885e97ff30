"""Reads `[control]`: the decisions and sensors of a policy, and the controllers with which it is
compared.
"""

from collections.abc import Sequence
from typing import Any, Literal

from snapo.case.table import CaseTable, TableContext, doc, parse

from ..control.records import PI, Cascade, Control, ControlRule, Manipulated, Measurement
from ..units.operation import Unit, timed
from .entries import EntryNumbers
from .numbers import NOT_NEGATIVE, POSITIVE, listed, suggest
from .numbers import quantity as number
from .reader import TextKey, quantity, tables
from .tables import (
    ControlTable,
    ManipulatedTable,
    MeasurementTable,
)

NOT_ZERO = "a gain that is not 0; its sign is the direction of the control"


class RuleTable(CaseTable):
    """`[[control.rules]]`"""

    name: TextKey = doc("name of the rule", allowed="a name")
    tuning: Literal["simc", "ziegler-nichols"] = doc(
        "formula for gains and times that are missing in the case", "simc"
    )
    loops: list[dict] = tables("control loops of the rule", "[[control.rules.loops]]")


class LoopTable(CaseTable):
    """`[[control.rules.loops]]`"""

    of: TextKey = doc("control that the loop decides", allowed="one of [[control.manipulated]]")
    measure: TextKey = doc(
        "state that the loop controls", allowed="the state of one of [[control.measurements]]"
    )
    setpoint: Any = doc(
        "setpoint over the unit's time",
        None,
        'quantities, evenly spaced over the time, such as ["20 g/L", "9 g/L"]',
    )
    gain: Any = quantity("gain, by default tuned", '"-0.5 K/(kg/m^3)"', None)
    integral_time: Any = quantity("integral time, by default tuned", '"10 min"', None)
    inner: dict | None = doc("inner loop of a cascade", None, "the table `inner` of a cascade")


class InnerTable(CaseTable):
    """`inner` of `[[control.rules.loops]]`"""

    measure: TextKey = doc(
        "state that the inner loop controls", allowed="the state of one of [[control.measurements]]"
    )
    low: Any = quantity("lower bound of its setpoint", '"300 K"')
    high: Any = quantity("upper bound of its setpoint", '"320 K"')
    gain: Any = quantity("gain, by default tuned", '"2 K/K"', None)
    integral_time: Any = quantity("integral time, by default tuned", '"2 min"', None)


def read_rules(
    file, raw: Sequence[Any], numbers: EntryNumbers, manipulated: Sequence[Manipulated],
    sensors: Sequence[Measurement], units: dict[str, str], timed: set[str], notes: list[str],
) -> tuple[ControlRule, ...]:  # fmt: skip
    """`units`: the units of every state that may be measured. `timed`: names of units with a
    time."""
    rules: list[ControlRule] = []
    for i, item in enumerate(raw):
        section = TableContext(file, f"control.rules[{i}]", notes)
        table = parse(RuleTable, item, str(file), section.name)
        if table.name in [rule.name for rule in rules]:
            raise section.error("name", table.name, "this name appears twice")
        read = _Loops(section, numbers, manipulated, sensors, units, timed)
        loops = tuple(read.loop(loop, k) for k, loop in enumerate(table.loops))
        for k, loop in enumerate(loops):
            if loop.of in [other.of for other in loops[:k]]:
                message = "a control can have only one loop in a rule"
                raise section.error(f"loops[{k}].of", manipulated[loop.of].input, message)
        rules.append(ControlRule(table.name, table.tuning, loops))
    return tuple(rules)


class _Loops:
    """The loops of one rule while they are read."""

    def __init__(self, section: TableContext, numbers, manipulated, sensors, units, timed):
        self.section, self.numbers, self.units, self.timed = section, numbers, units, timed
        self.controls = [item.input for item in manipulated]
        self.states = [sensor.state for sensor in sensors]

    def loop(self, raw: Any, number_: int) -> Cascade:
        file, notes = self.section.file, self.section.notes
        section = TableContext(file, f"{self.section.name}.loops[{number_}]", notes)
        table = parse(LoopTable, raw, str(file), section.name)
        of = _among(section, "of", table.of, self.controls, "control")
        unit = table.of.partition(".")[0]
        if unit not in self.timed:
            message = "a loop must move a number that is decided over a unit's time"
            raise section.error("of", table.of, message)
        moved = self.numbers.unit(table.of, 0)
        if table.inner is None:
            return Cascade(
                of, self._pi(section, table, unit, moved, table.setpoint), None, 0.0, 1.0
            )
        inside = TableContext(file, f"{section.name}.inner", notes)
        inner = parse(InnerTable, table.inner, str(file), inside.name)
        below = self._pi(inside, inner, unit, moved, None)
        local = self.units[inner.measure]  # known, as `below` was read
        above = self._pi(section, table, unit, local, table.setpoint)
        low, high = (number(inside, key, getattr(inner, key), local) for key in ("low", "high"))
        if not low < high:
            raise inside.error("high", inner.high, "high must be above low")
        return Cascade(of, above, below, low, high)

    def _pi(self, section: TableContext, table, unit: str, manipulated: str, setpoint: Any) -> PI:
        sensor = _among(section, "measure", table.measure, self.states, "measurement")
        if table.measure.partition(".")[0] != unit:
            message = f"a loop must measure a state of the unit that it controls, {unit}"
            raise section.error("measure", table.measure, message)
        local, gain, integral, nodes = self.units[table.measure], None, None, None
        if table.gain is not None:
            gain = number(section, "gain", table.gain, per(manipulated, local), difference=True)
            if gain == 0:
                raise section.error("gain", table.gain, f"it must be {NOT_ZERO}")
        if table.integral_time is not None:
            integral = number(section, "integral_time", table.integral_time, "s", POSITIVE)
        if setpoint is not None:
            nodes = tuple(listed(section, "setpoint", setpoint, local))
        return PI(sensor, nodes, gain, integral)


def _among(section: TableContext, key: str, name: str, names: Sequence[str], noun: str) -> int:
    if name not in names:
        raise section.error(key, name, f"there is no such {noun}; {suggest(name, names, noun)}")
    return list(names).index(name)


def per(unit: str, by: str) -> str:
    """The name of the unit `unit` per `by`, such as "K/kmol*m3" of "K" and "kmol/m3"."""
    if unit == by:
        return "1"
    above, *below = by.split("/")
    result = unit if above == "1" else f"{unit}/{above}"
    return result + "".join(f"*{item}" for item in below)


def read_control(
    file, raw: dict | None, numbers: EntryNumbers, species, units: Sequence[Unit], notes
) -> Control | None:
    """`[control]`: the decisions, their times and the measurements."""
    if raw is None:
        return None
    section = TableContext(file, "control", notes)
    table = parse(ControlTable, raw, str(file), "control")
    names = [unit.name for unit in units]
    for name in table.steps:
        if name not in names:
            hint = suggest(name, names, "unit")
            raise section.error(
                f"steps.{name}", table.steps[name], f"there is no such unit; {hint}"
            )
    # A unit that is not integrated over time has no reading until it is too late to decide.
    available = {
        f"{item.name}.{state}": unit
        for item in timed(units)
        for state, unit in item.states(species).items()
    }
    margin = table.solubility_margin
    if margin is not None:
        margin = number(section, "solubility_margin", margin, "1", POSITIVE)
    ramps = {profile.value.name: profile.ramp for x in timed(units) for profile in x.profiles}
    manipulated = tuple(
        _manipulated(file, entry, i, numbers, ramps, notes)
        for i, entry in enumerate(table.manipulated)
    )
    sensors = tuple(
        _measurement(file, measurement, i, available, notes)
        for i, measurement in enumerate(table.measurements)
    )
    over_time = {value.name for value in timed(units)}
    return Control(
        manipulated=manipulated,
        measurements=sensors,
        steps=tuple(table.steps.items()),
        substeps=table.substeps,
        solubility_margin=margin,
        rules=read_rules(
            file, table.rules, numbers, manipulated, sensors, available, over_time, notes
        ),
    )


def _manipulated(file, raw, i: int, numbers: EntryNumbers, ramps, notes) -> Manipulated:
    """`ramps`: {profile: its largest change per second, None without limit}, the defaults."""
    section = TableContext(file, f"control.manipulated[{i}]", notes)
    table = parse(ManipulatedTable, raw, str(file), section.name)
    name = table.of
    if name not in numbers.givens:
        hint = suggest(name, numbers.givens, "number")
        raise section.error("of", name, f"there is no such number; {hint}")
    unit = numbers.unit(name, 0)
    low = number(section, "low", table.low, unit)
    high = number(section, "high", table.high, unit)
    if not low < high:
        raise section.error("high", table.high, "high must be above low")
    numbers.check(section, "low", table.low, (name, 0), low)
    numbers.check(section, "high", table.high, (name, 0), high)
    ramp = ramps.get(name)
    if table.ramp is not None:
        ramp = number(section, "ramp", table.ramp, f"{unit}/s", POSITIVE, difference=True)
    return Manipulated(name, low, high, ramp)


def _measurement(file, raw, i: int, available: dict[str, str], notes) -> Measurement:
    section = TableContext(file, f"control.measurements[{i}]", notes)
    table = parse(MeasurementTable, raw, str(file), section.name)
    if table.state not in available:
        hint = suggest(table.state, available, "state")
        raise section.error("state", table.state, f"there is no such state; {hint}")
    unit = available[table.state]
    return Measurement(
        table.state,
        number(section, "error", table.error, unit, NOT_NEGATIVE, difference=True),
        number(section, "centre", table.centre, unit),
        number(section, "width", table.width, unit, POSITIVE, difference=True),
        number(section, "delay", table.delay, "s", NOT_NEGATIVE),
    )
