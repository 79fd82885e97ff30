"""Reads `[control]`: the policy's decisions and sensors, and the rules next to it."""

from collections.abc import Sequence

from snapo.case.table import TableContext, parse

from ...control.records import Control, Manipulated, Measurement
from ...units.operation import Unit, timed
from ..entries import EntryNumbers
from ..numbers import NOT_NEGATIVE, POSITIVE, quantity, suggest
from ..tables import (
    ControlTable,
    ManipulatedTable,
    MeasurementTable,
)
from .rules import read_rules


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
        margin = quantity(section, "solubility_margin", margin, "1", POSITIVE)
    manipulated = tuple(
        _manipulated(file, entry, i, numbers, notes) for i, entry in enumerate(table.manipulated)
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


def _manipulated(file, raw, i: int, numbers: EntryNumbers, notes) -> Manipulated:
    section = TableContext(file, f"control.manipulated[{i}]", notes)
    table = parse(ManipulatedTable, raw, str(file), section.name)
    name = table.of
    if name not in numbers.givens:
        hint = suggest(name, numbers.givens, "number")
        raise section.error("of", name, f"there is no such number; {hint}")
    unit = numbers.unit(name, 0)
    low = quantity(section, "low", table.low, unit)
    high = quantity(section, "high", table.high, unit)
    if not low < high:
        raise section.error("high", table.high, "high must lie above low")
    numbers.check(section, "low", table.low, (name, 0), low)
    numbers.check(section, "high", table.high, (name, 0), high)
    ramp = None
    if table.ramp is not None:
        ramp = quantity(section, "ramp", table.ramp, f"{unit}/s", POSITIVE, difference=True)
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
        quantity(section, "error", table.error, unit, NOT_NEGATIVE, difference=True),
        quantity(section, "centre", table.centre, unit),
        quantity(section, "width", table.width, unit, POSITIVE, difference=True),
        quantity(section, "delay", table.delay, "s", NOT_NEGATIVE),
    )
