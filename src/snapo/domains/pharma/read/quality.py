"""Reads parameters, attributes with limits, and uncertain numbers."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.table import Section, parse

from ..flowsheet.feed import Feed
from ..flowsheet.network import Network
from ..given import Entry
from ..quality.records import Attribute, Distribution, Parameter, Uncertainty
from ..units.operation import Unit
from .entries import Numbers
from .fitted import Fitted
from .numbers import ANY, POSITIVE, quantity, suggest, unit_of
from .plausible.drawn import check_drawn
from .quantities import UnitError, basis, check_basis, conversion, own_basis
from .tables import (
    AttributeTable,
    CorrelationTable,
    DistributionTable,
    ParameterTable,
    UncertaintyTable,
)

SMALL = 0.02  # of the room between limits, or of a limit: a small difference


def read_distribution(section: Section, raw, unit: str) -> Distribution:
    """A spread is a difference in the number's unit; that of "lognormal" is a pure number."""
    table = parse(DistributionTable, raw, str(section.file), f"{section.name}.distribution")
    inner = Section(section.file, f"{section.name}.distribution", section.notes)
    own = "1" if table.kind == "lognormal" else unit
    spread = quantity(inner, "spread", table.spread, own, POSITIVE, difference=True)
    return Distribution(table.kind, spread)


def read_parameters(file, raw: list[dict], numbers: Numbers, notes) -> tuple[Parameter, ...]:
    """`[[parameters]]`, each one entry of the case, with its ranges around the nominal value."""
    found: list[Parameter] = []
    for i, each in enumerate(raw):
        section = Section(file, f"parameters[{i}]", notes)
        parameter = _parameter(
            section, parse(ParameterTable, each, str(file), section.name), numbers
        )
        for other in found:
            if other.name == parameter.name:
                raise section.error("name", other.name, "another parameter has this name")
            if (other.input, other.entry) == (parameter.input, parameter.entry):
                raise section.error("of", each["of"], f"parameter {other.name} is this number too")
        found.append(parameter)
    return tuple(found)


def _parameter(section: Section, table: ParameterTable, numbers: Numbers) -> Parameter:
    name, entry = numbers.one(section, "of", table.of)
    unit, nominal = numbers.unit(name, entry), numbers.value((name, entry))
    own = unit_of(section, "range[0]", table.range[0], unit)
    low, high = _pair(section, "range", table.range, unit, own_basis(name))
    inner = _pair(section, "normal", table.normal, unit, own_basis(name))
    for end in (low, high):
        numbers.check(section, "range", table.range, (name, entry), end)
    change = conversion(own, unit)

    def said(number: float) -> str:
        return f"{(number - change.offset) / change.scale:.10g}{'' if own == '1' else f' {own}'}"

    if not low <= nominal <= high:
        what = f"the nominal value of {table.of}, {said(nominal)}, must lie in the range"
        raise section.error("range", table.range, what)
    if not low <= inner[0] <= inner[1] <= high:
        what = f"the normal range must lie in the range, {said(low)} to {said(high)}"
        raise section.error("normal", table.normal, what)
    if not inner[0] <= nominal <= inner[1]:
        what = f"the nominal value of {table.of}, {said(nominal)}, must lie in the normal range"
        raise section.error("normal", table.normal, what)
    spread = None
    if table.distribution is not None:
        spread = read_distribution(section, table.distribution, unit)
        check_drawn(section, table.distribution, spread, numbers, (name, entry))
    return Parameter(
        table.name, name, entry, own, change.scale, change.offset, low, high, *inner, spread,
        table.control, table.source,
    )  # fmt: skip


def _pair(section: Section, key: str, raw: list, unit: str, basis: str) -> tuple[float, float]:
    low, high = (
        quantity(section, f"{key}[{i}]", each, unit, ANY, basis=basis) for i, each in enumerate(raw)
    )
    if not low < high:
        raise section.error(key, raw, "the first number must lie below the second")
    return low, high


def read_attributes(
    file, raw: list[dict], network: Network, feeds: Sequence[Feed], units: Sequence[Unit], notes
) -> tuple[Attribute, ...]:
    """`[[attributes]]`: a measure of a unit, in the owner's unit, with cited limits."""
    known = every_measure(network, units)
    found: list[Attribute] = []
    for i, each in enumerate(raw):
        section = Section(file, f"attributes[{i}]", notes)
        table = parse(AttributeTable, each, str(file), section.name)
        attribute = _attribute(section, table, known, network, units)
        if attribute.name in [other.name for other in found]:
            raise section.error("name", table.name, "another attribute has this name")
        found.append(attribute)
    return tuple(found)


def every_measure(network: Network, units: Sequence[Unit]) -> dict[str, str]:
    """{"unit.measure": its unit in the domain} of all units and of the process."""
    found = {
        f"{unit.name}.{measure}": domain
        for unit in units
        for measure, domain in unit.measures(network.species).items()
    }
    species = network.species
    found |= {
        f"process.yield.{made}.{key}": "1" for made in species for key in species if made != key
    }
    return found | {f"process.product.{made}": "kg" for made in species}


def share_of(measure: str, unit: str, network: Network, units: Sequence[Unit]) -> float:
    """By what a measure is multiplied to be a share on the basis that `unit` names: that of a yield
    or of an impurity follows from molar masses.

    **Raises:** `UnitError` where it is not known.
    """
    said, own = basis(unit), own_basis(measure)
    mass = dict(zip(network.species, network.molar_mass))
    *_, kind, one, other = ("", "", *measure.split("."))
    if kind == "yield" and said == "w/w":
        return float(mass[one] / mass[other])
    solutes: set[Any] = {getattr(each, "solute", None) for each in units} - {None}
    if one == "impurity" and said == "n/n" and len(solutes) == 1:
        return float(mass[solutes.pop()] / mass[other])
    check_basis(unit, own)
    return 1.0


def _attribute(
    section: Section, table: AttributeTable, known: dict[str, str], network: Network, units
) -> Attribute:
    if table.measure not in known:
        hint = suggest(table.measure, known, "measure")
        raise section.error("measure", table.measure, f"there is no such measure; {hint}")
    domain = known[table.measure]
    try:
        change = conversion(table.unit, domain)
        factor = share_of(table.measure, table.unit, network, units) if domain == "1" else 1.0
    except UnitError as error:
        raise section.error("unit", table.unit, str(error)) from None
    if change.offset:
        raise section.error("unit", table.unit, "a quality attribute needs a unit with a true zero")
    own = basis(table.unit) or own_basis(table.measure)
    limits = {
        key: None if raw is None else quantity(section, key, raw, domain, basis=own) / change.scale
        for key, raw in (("low", table.low), ("high", table.high))
    }
    # A limit written in the attribute's unit keeps its digits through both conversions.
    low, high = (None if x is None else float(f"{x:.14g}") for x in limits.values())
    if low is not None and high is not None and not low < high:
        what = f"the lower limit, {low:g} {table.unit}, must lie below it"
        raise section.error("high", table.high, what)
    if (low is not None or high is not None) and not table.citation.strip():
        raise section.error("citation", None, "a limit needs its source, or that it is your own")
    if table.margin is None:
        margin = _margin(low, high)
    else:
        margin = quantity(section, "margin", table.margin, domain, POSITIVE, basis=own)
        margin /= change.scale
    return Attribute(
        table.name, table.measure, table.unit, factor / change.scale, low, high, table.citation,
        margin,
    )  # fmt: skip


def _margin(low: float | None, high: float | None) -> float:
    if low is not None and high is not None:
        return SMALL * (high - low)
    return SMALL * abs(low if low is not None else high or 0.0) or 1.0


def read_uncertainty(
    file, raw: list[dict], correlations: list[dict], numbers: Numbers, notes, fitted: Fitted
) -> Uncertainty:
    """`[[uncertainty]]` and `[[correlations]]`, and after them what was fitted to data."""
    which: list[Entry] = []
    spreads, when, between = [], [], []
    for i, each in enumerate(raw):
        section = Section(file, f"uncertainty[{i}]", notes)
        table = parse(UncertaintyTable, each, str(file), section.name)
        for entry in numbers.all(section, "of", table.of):
            if entry in which:
                raise section.error("of", table.of, "this number stands there twice")
            if entry in fitted.entries:
                what = "the uncertainty of this number comes with its fit, from the file `fitted`"
                raise section.error("of", table.of, what)
            unit = numbers.unit(*entry)
            distribution = read_distribution(section, table.distribution, unit)
            if distribution.kind == "lognormal" and numbers.value(entry) <= 0:
                what = f'"lognormal" needs a nominal value above 0; {table.of} has another'
                raise section.error("distribution", table.distribution, what)
            check_drawn(section, table.distribution, distribution, numbers, entry)
            which.append(entry)
            spreads.append(distribution)
            when.append(table.when)
            between.append(table.between_batches or table.when == "step")
    matrix = np.eye(len(which) + len(fitted.entries))
    matrix[len(which) :, len(which) :] = fitted.correlation
    which += fitted.entries
    spreads += fitted.distributions
    when += ["batch"] * len(fitted.entries)
    between += [False] * len(fitted.entries)
    for i, each in enumerate(correlations):
        section = Section(file, f"correlations[{i}]", notes)
        table = parse(CorrelationTable, each, str(file), section.name)
        one, other = (numbers.one(section, "between", text) for text in table.between)
        for entry, text in zip((one, other), table.between):
            if entry not in which:
                raise section.error("between", text, "this number is not under [[uncertainty]]")
        if one == other:
            raise section.error("between", table.between, "a number correlates with another")
        row, column = which.index(one), which.index(other)
        matrix[row, column] = matrix[column, row] = table.value
    if which and np.linalg.eigvalsh(matrix).min() <= 1e-12:
        what = "the correlations together are not those of any numbers (not positive definite)"
        raise CaseError(str(file), "correlations", None, what)
    return Uncertainty(
        tuple(name for name, _ in which), tuple(entry for _, entry in which), tuple(spreads),
        matrix, tuple(when), tuple(between),
    )  # fmt: skip
