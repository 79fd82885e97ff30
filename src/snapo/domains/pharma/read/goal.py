"""Reads the goal and the design space."""

from collections.abc import Sequence
from typing import Any

from snapo.case.error import CaseError
from snapo.case.table import TableContext, parse

from ..control.records import Goal
from ..quality.records import Attribute, DesignSpace, Parameter
from .numbers import suggest
from .tables import DesignSpaceTable, GoalTable


def read_goal(file, raw: dict, attributes: Sequence[Attribute]) -> Goal:
    """`[goal]`: the probability of keeping all limits, or the mean or tail of an attribute."""
    table = parse(GoalTable, raw, str(file), "goal")
    section = TableContext(file, "goal", [])
    names = [attribute.name for attribute in attributes]
    if table.kind == "probability" and "attribute" in raw:
        message = 'kind "probability" is of all limits together and has no such key'
        raise section.error("attribute", table.attribute, message)
    if table.kind != "probability" and table.attribute not in names:
        hint = suggest(table.attribute, names, "attribute")
        raise section.error("attribute", table.attribute, f"there is no such attribute; {hint}")
    if table.kind == "cvar" and table.sense == "minimise":
        message = 'kind "cvar" is the mean of the lowest values, which only makes sense to maximise'
        raise section.error("sense", table.sense, message)
    sense: Any = 1 if table.sense == "maximise" else -1
    return Goal(table.kind, table.attribute, sense, table.level, table.penalty)


def read_design_space(
    file, raw: dict | None, parameters: Sequence[Parameter], attributes: Sequence[Attribute]
) -> DesignSpace | None:
    """`[design_space]`: its parameters, its points, and the probability it must keep."""
    if raw is None:
        return None
    section = TableContext(file, "design_space", [])
    table = parse(DesignSpaceTable, raw, str(file), "design_space")
    names = [parameter.name for parameter in parameters]
    for i, axis in enumerate(table.axes):
        if axis not in names:
            hint = suggest(axis, names, "parameter")
            raise section.error(f"axes[{i}]", axis, f"there is no such parameter; {hint}")
        if axis in table.axes[:i]:
            raise section.error(f"axes[{i}]", axis, "this parameter stands there twice")
    if all(attribute.low is None and attribute.high is None for attribute in attributes):
        message = "no attribute has a limit, so nothing bounds a design space"
        raise CaseError(str(file), "design_space", None, message)
    return DesignSpace(
        tuple(table.axes),
        (table.points,) * len(table.axes),
        table.samples,
        tuple(sorted(table.levels)),
        table.required,
    )
