"""Reads the closed loop, the goal and the design space."""

from collections.abc import Sequence
from typing import Any

from snapo.case.error import CaseError
from snapo.case.table import Section, parse

from ..control.records import Control, Goal, Manipulated, Measurement
from ..quality.records import Attribute, DesignSpace, Parameter
from ..units.operation import Unit, timed
from .entries import Numbers
from .numbers import NOT_NEGATIVE, POSITIVE, quantity, suggest
from .tables import (
    ControlTable,
    DesignSpaceTable,
    GoalTable,
    ManipulatedTable,
    MeasurementTable,
)


def read_control(
    file, raw: dict | None, numbers: Numbers, species, units: Sequence[Unit], notes
) -> Control | None:
    """`[control]`: who decides what, how often and on what."""
    if raw is None:
        return None
    section = Section(file, "control", notes)
    table = parse(ControlTable, raw, str(file), "control")
    names = [unit.name for unit in units]
    for name in table.steps:
        if name not in names:
            hint = suggest(name, names, "unit")
            raise section.error(
                f"steps.{name}", table.steps[name], f"there is no such unit; {hint}"
            )
    # A unit that is not integrated over time has no reading until it is too late to decide.
    known = {
        f"{each.name}.{state}": unit
        for each in timed(units)
        for state, unit in each.states(species).items()
    }
    margin = table.solubility_margin
    if margin is not None:
        margin = quantity(section, "solubility_margin", margin, "1", POSITIVE)
    return Control(
        manipulated=tuple(
            _manipulated(file, each, i, numbers, notes) for i, each in enumerate(table.manipulated)
        ),
        measurements=tuple(
            _measurement(file, each, i, known, notes) for i, each in enumerate(table.measurements)
        ),
        steps=tuple(table.steps.items()),
        substeps=table.substeps,
        solubility_margin=margin,
    )


def _manipulated(file, raw, i: int, numbers: Numbers, notes) -> Manipulated:
    section = Section(file, f"control.manipulated[{i}]", notes)
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


def _measurement(file, raw, i: int, known: dict[str, str], notes) -> Measurement:
    section = Section(file, f"control.measurements[{i}]", notes)
    table = parse(MeasurementTable, raw, str(file), section.name)
    if table.state not in known:
        hint = suggest(table.state, known, "state")
        raise section.error("state", table.state, f"there is no such state; {hint}")
    unit = known[table.state]
    return Measurement(
        table.state,
        quantity(section, "error", table.error, unit, NOT_NEGATIVE, difference=True),
        quantity(section, "centre", table.centre, unit),
        quantity(section, "width", table.width, unit, POSITIVE, difference=True),
    )


def read_goal(file, raw: dict, attributes: Sequence[Attribute]) -> Goal:
    """`[goal]`: the probability of keeping all limits, or the mean or tail of an attribute."""
    table = parse(GoalTable, raw, str(file), "goal")
    section = Section(file, "goal", [])
    names = [each.name for each in attributes]
    if table.kind == "probability" and "attribute" in raw:
        what = 'kind "probability" is of all limits together and has no such key'
        raise section.error("attribute", table.attribute, what)
    if table.kind != "probability" and table.attribute not in names:
        hint = suggest(table.attribute, names, "attribute")
        raise section.error("attribute", table.attribute, f"there is no such attribute; {hint}")
    if table.kind == "cvar" and table.sense == "minimise":
        what = 'kind "cvar" is the mean of the lowest values, which only makes sense to maximise'
        raise section.error("sense", table.sense, what)
    sense: Any = 1 if table.sense == "maximise" else -1
    return Goal(table.kind, table.attribute, sense, table.level, table.penalty)


def read_design_space(
    file, raw: dict | None, parameters: Sequence[Parameter], attributes: Sequence[Attribute]
) -> DesignSpace | None:
    """`[design_space]`: its parameters, its points, and the probability it must keep."""
    if raw is None:
        return None
    section = Section(file, "design_space", [])
    table = parse(DesignSpaceTable, raw, str(file), "design_space")
    names = [each.name for each in parameters]
    for i, axis in enumerate(table.axes):
        if axis not in names:
            hint = suggest(axis, names, "parameter")
            raise section.error(f"axes[{i}]", axis, f"there is no such parameter; {hint}")
        if axis in table.axes[:i]:
            raise section.error(f"axes[{i}]", axis, "this parameter stands there twice")
    if all(each.low is None and each.high is None for each in attributes):
        what = "no attribute has a limit, so nothing bounds a design space"
        raise CaseError(str(file), "design_space", None, what)
    return DesignSpace(
        tuple(table.axes),
        (table.points,) * len(table.axes),
        table.samples,
        tuple(sorted(table.levels)),
        table.required,
    )
