"""Reads `[optimise]`: decisions within their bounds, and the goal."""

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from snapo.case.quantity import Range
from snapo.case.table import CaseTable, TableContext, parse

from ..recipe.records import Decision, Optimise, Term
from .entries import EntryNumbers
from .fields import TextKey, tables, whole, within, word
from .fields import quantity as quantity_field
from .numbers import quantity, suggest, unit_of
from .quantities import UnitError, check_basis, conversion, own_basis


class TermTable(CaseTable):
    """`[[optimise.terms]]`, `[[optimise.per]]`"""

    of: TextKey = Field(description='a measure or a number, such as "process.product.C"')
    unit: str = Field("1", description='the unit in which it counts, such as "kg"')
    weight: float = Field(1.0, description="a number")


class DecisionTable(CaseTable):
    """`[[optimise.decisions]]`"""

    of: TextKey = Field(description='a number of the case, such as "crystalliser.temperature[1]"')
    low: Any = quantity_field('"273 K"')
    high: Any = quantity_field('"313 K"')


class OptimiseTable(CaseTable):
    """`[optimise]`"""

    sense: Literal["maximise", "minimise"] = word("maximise", "minimise", default="maximise")
    terms: list[dict] = tables("[[optimise.terms]]")
    per: list[dict] = Field([], description="tables [[optimise.per]]")
    decisions: list[dict] = tables("[[optimise.decisions]]")
    reserve: float = within(Range(0.0, noun="a number of margins"), 0.0)
    deviations: float = within(Range(0.0, noun="a number of standard deviations"), 0.0)
    starts: int = whole(1, 1000, default=1)


def read_optimise(
    file, raw: dict | None, numbers: EntryNumbers, measures: Mapping[str, str], notes
) -> Optimise | None:
    """`measures`: {name: its unit in the domain} of all that can be measured."""
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
        raise section.error("unit", table.unit, "a term needs a unit with a true zero")
    return Term(name, entry, table.unit, 1 / change.scale, table.weight)


def _decisions(section: TableContext, raw: dict, numbers: EntryNumbers) -> list[Decision]:
    """One for each entry that `of` stands for, all with the same bounds."""
    table = parse(DecisionTable, raw, str(section.file), section.name)
    decisions = []
    for name, entry in numbers.all(section, "of", table.of):
        unit, start = numbers.unit(name, entry), numbers.value((name, entry))
        low, high = (
            quantity(section, key, getattr(table, key), unit, basis=own_basis(name))
            for key in ("low", "high")
        )
        if not low < high:
            raise section.error("high", table.high, "high must lie above low")
        numbers.check(section, "low", table.low, (name, entry), low)
        numbers.check(section, "high", table.high, (name, entry), high)
        local = unit_of(section, "low", table.low, unit)
        change = conversion(local, unit)
        if not low <= start <= high:
            value = f"{(start - change.offset) / change.scale:.10g}"
            value += "" if local == "1" else f" {local}"
            message = f"the case's own number, {value}, must lie within the bounds: it is the start"
            raise section.error("low", [table.low, table.high], message)
        several = len(numbers.givens[name].labels) > 1
        label = f"{name}[{entry}]" if several else name
        decisions.append(
            Decision(label, name, entry, local, change.scale, change.offset, low, high, start)
        )
    return decisions
