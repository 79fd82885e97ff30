"""Reads `[optimise]`, `[goal]` and `[design_space]`."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from snapo.case.error import CaseError
from snapo.case.quantity import Range
from snapo.case.table import CaseTable, TableContext, doc, parse

from ..control.records import Goal
from ..quality.records import Attribute, DesignSpace, Parameter
from ..recipe.records import Decision, Optimise, Term
from .entries import EntryNumbers
from .numbers import quantity, suggest, unit_of
from .quantities import UnitError, check_basis, conversion, own_basis
from .reader import TextKey, tables, whole, within
from .reader import quantity as quantity_field
from .tables import DesignSpaceTable, GoalTable


class TermTable(CaseTable):
    """`[[optimise.terms]]`, `[[optimise.per]]`"""

    of: TextKey = doc(
        "measure or number that is added up",
        allowed='a measure or a number, such as "process.product.C"',
    )
    unit: str = doc("unit in which it counts", "1", 'the unit in which it counts, such as "kg"')
    weight: float = doc("weight in the sum", 1.0, "a number")


class DecisionTable(CaseTable):
    """`[[optimise.decisions]]`"""

    of: TextKey = doc(
        "number that is decided",
        allowed='a number of the case, such as "crystalliser.temperature[1]"',
    )
    low: Any = quantity_field("lower bound", '"273 K"')
    high: Any = quantity_field("upper bound", '"313 K"')


class OptimiseTable(CaseTable):
    """`[optimise]`"""

    sense: Literal["maximise", "minimise"] = doc(
        "whether the goal is maximised or minimised", "maximise"
    )
    terms: list[dict] = tables("terms of the goal", "[[optimise.terms]]")
    per: list[dict] = doc("terms by whose sum the goal is divided", [], "tables [[optimise.per]]")
    decisions: list[dict] = tables("numbers that are decided", "[[optimise.decisions]]")
    reserve: float = within(
        "number of margins by which the recipe stays away from every limit",
        Range(0.0, noun="a number of margins"),
        0.0,
    )
    deviations: float = within(
        "number of standard deviations by which it stays away from every limit",
        Range(0.0, noun="a number of standard deviations"),
        0.0,
    )
    starts: int = whole("number of points from which the search begins", 1, 1000, default=1)


def read_optimise(
    file, raw: dict | None, numbers: EntryNumbers, measures: Mapping[str, str], notes
) -> Optimise | None:
    """`measures`: {name: its unit in the domain} of all measures."""
    if raw is None:
        return None
    table = parse(OptimiseTable, raw, str(file), "optimise")
    sense: Any = 1 if table.sense == "maximise" else -1

    def terms(key: str) -> tuple[Term, ...]:
        result = getattr(table, key)
        sections = [TableContext(file, f"optimise.{key}[{i}]", notes) for i in range(len(result))]
        return tuple(_term(s, entry, numbers, measures) for s, entry in zip(sections, result))

    decisions: list[Decision] = []
    for i, item in enumerate(table.decisions):
        section = TableContext(file, f"optimise.decisions[{i}]", notes)
        for decision in _decisions(section, item, numbers):
            if (decision.input, decision.entry) in [(d.input, d.entry) for d in decisions]:
                raise section.error("of", item.get("of"), "this number is decided twice")
            decisions.append(decision)
    return Optimise(
        sense, terms("terms"), terms("per"), tuple(decisions), table.reserve, table.starts,
        table.deviations,
    )  # fmt: skip


def _term(
    section: TableContext, raw: dict, numbers: EntryNumbers, measures: Mapping[str, str]
) -> Term:
    table = parse(TermTable, raw, str(section.file), section.name)
    entry, domain = None, measures.get(table.of)
    name = table.of
    if domain is None:
        if name.partition("[")[0] not in numbers.givens:
            hint = suggest(name, [*measures, *numbers.givens], "name")
            raise section.error("of", name, f"there is no such measure or number; {hint}")
        name, entry = numbers.one(section, "of", table.of)
        domain = numbers.unit(name, entry)
    try:
        change = conversion(table.unit, domain)
        if domain == "1":
            check_basis(table.unit, own_basis(name))
    except UnitError as error:
        raise section.error("unit", table.unit, str(error)) from None
    if change.offset:
        raise section.error(
            "unit",
            table.unit,
            "the unit of a term must have its zero where the quantity is zero, such as K",
        )
    return Term(name, entry, table.unit, 1 / change.scale, table.weight)


def _decisions(section: TableContext, raw: dict, numbers: EntryNumbers) -> list[Decision]:
    """A decision for each number that `of` names, all with the same bounds."""
    table = parse(DecisionTable, raw, str(section.file), section.name)
    decisions = []
    for name, entry in numbers.all(section, "of", table.of):
        unit, start = numbers.unit(name, entry), numbers.value((name, entry))
        low, high = (
            quantity(section, key, getattr(table, key), unit, basis=own_basis(name))
            for key in ("low", "high")
        )
        if not low < high:
            raise section.error("high", table.high, "high must be above low")
        numbers.check(section, "low", table.low, (name, entry), low)
        numbers.check(section, "high", table.high, (name, entry), high)
        local = unit_of(section, "low", table.low, unit)
        change = conversion(local, unit)
        if not low <= start <= high:
            value = f"{(start - change.offset) / change.scale:.10g}"
            value += "" if local == "1" else f" {local}"
            message = (
                f"the number in the case, {value}, is the start, and must be within the bounds"
            )
            raise section.error("low", [table.low, table.high], message)
        several = len(numbers.givens[name].labels) > 1
        label = f"{name}[{entry}]" if several else name
        decisions.append(
            Decision(label, name, entry, local, change.scale, change.offset, low, high, start)
        )
    return decisions


def read_goal(file, raw: dict, attributes: Sequence[Attribute]) -> Goal:
    """`[goal]`: the probability of meeting all limits, or the mean or the tail of an attribute."""
    table = parse(GoalTable, raw, str(file), "goal")
    section = TableContext(file, "goal", [])
    names = [attribute.name for attribute in attributes]
    if table.kind == "probability" and "attribute" in raw:
        message = 'kind "probability" is for all limits together and has no such key'
        raise section.error("attribute", table.attribute, message)
    if table.kind != "probability" and table.attribute not in names:
        hint = suggest(table.attribute, names, "attribute")
        raise section.error("attribute", table.attribute, f"there is no such attribute; {hint}")
    if table.kind == "cvar" and table.sense == "minimise":
        message = 'kind "cvar" is the mean of the lowest values, so it can only be maximised'
        raise section.error("sense", table.sense, message)
    sense: Any = 1 if table.sense == "maximise" else -1
    return Goal(table.kind, table.attribute, sense, table.level, table.penalty)


def read_design_space(
    file, raw: dict | None, parameters: Sequence[Parameter], attributes: Sequence[Attribute]
) -> DesignSpace | None:
    """`[design_space]`: its parameters, its points, and the required probability."""
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
            raise section.error(f"axes[{i}]", axis, "this parameter appears twice")
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
