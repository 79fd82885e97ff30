"""Reads parameters, attributes with limits, and uncertain numbers."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.table import TableContext, parse

from ..flowsheet.feed import Feed
from ..flowsheet.network import FlowNetwork
from ..given import Entry
from ..quality.records import Attribute, Distribution, Parameter, Uncertainty
from ..units.operation import Unit
from .entries import EntryNumbers
from .fitted import FittedRows
from .numbers import ANY, POSITIVE, quantity, suggest, unit_of
from .plausible.checks import check_drawn
from .quantities import UnitError, basis, check_basis, conversion, own_basis
from .tables import (
    AttributeTable,
    CorrelationTable,
    DistributionTable,
    ParameterTable,
    UncertaintyTable,
)

SMALL = 0.02  # of the room between limits, or of a limit: a small difference


def read_distribution(section: TableContext, raw, unit: str) -> Distribution:
    """A spread is a difference in the number's unit; that of "lognormal" is a pure number."""
    table = parse(DistributionTable, raw, str(section.file), f"{section.name}.distribution")
    inner = TableContext(section.file, f"{section.name}.distribution", section.notes)
    local = "1" if table.kind == "lognormal" else unit
    spread = quantity(inner, "spread", table.spread, local, POSITIVE, difference=True)
    return Distribution(table.kind, spread)


def read_parameters(file, raw: list[dict], numbers: EntryNumbers, notes) -> tuple[Parameter, ...]:
    """`[[parameters]]`, each one entry of the case, with its ranges around the nominal value."""
    parameters: list[Parameter] = []
    for i, item in enumerate(raw):
        section = TableContext(file, f"parameters[{i}]", notes)
        parameter = _parameter(
            section, parse(ParameterTable, item, str(file), section.name), numbers
        )
        for other in parameters:
            if other.name == parameter.name:
                raise section.error("name", other.name, "another parameter has this name")
            if (other.input, other.entry) == (parameter.input, parameter.entry):
                raise section.error("of", item["of"], f"parameter {other.name} has this number too")
        parameters.append(parameter)
    return tuple(parameters)


def _parameter(section: TableContext, table: ParameterTable, numbers: EntryNumbers) -> Parameter:
    name, entry = numbers.one(section, "of", table.of)
    unit, nominal = numbers.unit(name, entry), numbers.value((name, entry))
    local = unit_of(section, "range[0]", table.range[0], unit)
    low, high = _pair(section, "range", table.range, unit, own_basis(name))
    inner = _pair(section, "normal", table.normal, unit, own_basis(name))
    for end in (low, high):
        numbers.check(section, "range", table.range, (name, entry), end)
    change = conversion(local, unit)

    def number_text(number: float) -> str:
        return (
            f"{(number - change.offset) / change.scale:.10g}{'' if local == '1' else f' {local}'}"
        )

    if not low <= nominal <= high:
        message = f"the nominal value of {table.of}, {number_text(nominal)}, must lie in the range"
        raise section.error("range", table.range, message)
    if not low <= inner[0] <= inner[1] <= high:
        message = (
            f"the normal range must lie in the range, {number_text(low)} to {number_text(high)}"
        )
        raise section.error("normal", table.normal, message)
    if not inner[0] <= nominal <= inner[1]:
        message = (
            f"the nominal value of {table.of}, {number_text(nominal)}, must lie in the normal range"
        )
        raise section.error("normal", table.normal, message)
    spread = None
    if table.distribution is not None:
        spread = read_distribution(section, table.distribution, unit)
        check_drawn(section, table.distribution, spread, numbers, (name, entry))
    return Parameter(
        table.name, name, entry, local, change.scale, change.offset, low, high, *inner, spread,
        table.control, table.source,
    )  # fmt: skip


def _pair(section: TableContext, key: str, raw: list, unit: str, basis: str) -> tuple[float, float]:
    low, high = (
        quantity(section, f"{key}[{i}]", item, unit, ANY, basis=basis) for i, item in enumerate(raw)
    )
    if not low < high:
        raise section.error(key, raw, "the first number must lie below the second")
    return low, high


def read_attributes(
    file, raw: list[dict], network: FlowNetwork, feeds: Sequence[Feed], units: Sequence[Unit], notes
) -> tuple[Attribute, ...]:
    """`[[attributes]]`: a measure of a unit, in the case's unit, with cited limits."""
    available = every_measure(network, units)
    attributes: list[Attribute] = []
    for i, item in enumerate(raw):
        section = TableContext(file, f"attributes[{i}]", notes)
        table = parse(AttributeTable, item, str(file), section.name)
        attribute = _attribute(section, table, available, network, units)
        if attribute.name in [other.name for other in attributes]:
            raise section.error("name", table.name, "another attribute has this name")
        attributes.append(attribute)
    return tuple(attributes)


def every_measure(network: FlowNetwork, units: Sequence[Unit]) -> dict[str, str]:
    """{"unit.measure": its unit in the domain} of all units and of the process."""
    domains = {
        f"{unit.name}.{measure}": domain
        for unit in units
        for measure, domain in unit.measures(network.species).items()
    }
    species = network.species
    domains |= {
        f"process.yield.{made}.{key}": "1" for made in species for key in species if made != key
    }
    return domains | {f"process.product.{made}": "kg" for made in species}


def share_of(measure: str, unit: str, network: FlowNetwork, units: Sequence[Unit]) -> float:
    """The factor from a measure to a share on the basis that `unit` names: for a yield or an
    impurity it follows from molar masses.

    **Raises:** `UnitError` if it is not known.
    """
    metadata, local = basis(unit), own_basis(measure)
    mass = dict(zip(network.species, network.molar_mass))
    *_, kind, one, other = ("", "", *measure.split("."))
    if kind == "yield" and metadata == "w/w":
        return float(mass[one] / mass[other])
    solutes: set[Any] = {getattr(item, "solute", None) for item in units} - {None}
    if one == "impurity" and metadata == "n/n" and len(solutes) == 1:
        return float(mass[solutes.pop()] / mass[other])
    check_basis(unit, local)
    return 1.0


def _attribute(
    section: TableContext,
    table: AttributeTable,
    available: dict[str, str],
    network: FlowNetwork,
    units,
) -> Attribute:
    if table.measure not in available:
        hint = suggest(table.measure, available, "measure")
        raise section.error("measure", table.measure, f"there is no such measure; {hint}")
    domain = available[table.measure]
    try:
        change = conversion(table.unit, domain)
        factor = share_of(table.measure, table.unit, network, units) if domain == "1" else 1.0
    except UnitError as error:
        raise section.error("unit", table.unit, str(error)) from None
    if change.offset:
        raise section.error(
            "unit",
            table.unit,
            "the unit of a quality attribute must have its "
            "zero where the quantity is zero, such as K",
        )
    local = basis(table.unit) or own_basis(table.measure)
    limits = {
        key: None
        if raw is None
        else quantity(section, key, raw, domain, basis=local) / change.scale
        for key, raw in (("low", table.low), ("high", table.high))
    }
    # A limit written in the attribute's unit keeps its digits through both conversions.
    low, high = (None if x is None else float(f"{x:.14g}") for x in limits.values())
    if low is not None and high is not None and not low < high:
        message = f"it must be above the lower limit, {low:g} {table.unit}"
        raise section.error("high", table.high, message)
    if (low is not None or high is not None) and not table.citation.strip():
        raise section.error("citation", None, "a limit needs a source, or a note that you set it")
    if table.margin is None:
        margin = _margin(low, high)
    else:
        margin = quantity(section, "margin", table.margin, domain, POSITIVE, basis=local)
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
    file, raw: list[dict], correlations: list[dict], numbers: EntryNumbers, notes, fit: FittedRows
) -> Uncertainty:
    """`[[uncertainty]]` and `[[correlations]]`, followed by the numbers fitted to data."""
    which: list[Entry] = []
    spreads, when, between = [], [], []
    for i, correlation in enumerate(raw):
        section = TableContext(file, f"uncertainty[{i}]", notes)
        table = parse(UncertaintyTable, correlation, str(file), section.name)
        for entry in numbers.all(section, "of", table.of):
            if entry in which:
                raise section.error("of", table.of, "this number appears twice")
            if entry in fit.entries:
                message = "the file `fitted` has the uncertainty of this number; remove this entry"
                raise section.error("of", table.of, message)
            unit = numbers.unit(*entry)
            distribution = read_distribution(section, table.distribution, unit)
            if distribution.kind == "lognormal" and numbers.value(entry) <= 0:
                message = (
                    f'"lognormal" needs a nominal value above 0, which {table.of} does not have'
                )
                raise section.error("distribution", table.distribution, message)
            check_drawn(section, table.distribution, distribution, numbers, entry)
            which.append(entry)
            spreads.append(distribution)
            when.append(table.when)
            between.append(table.between_batches or table.when == "step")
    matrix = np.eye(len(which) + len(fit.entries))
    matrix[len(which) :, len(which) :] = fit.correlation
    which += fit.entries
    spreads += fit.distributions
    when += ["batch"] * len(fit.entries)
    between += [False] * len(fit.entries)
    for i, correlation in enumerate(correlations):
        section = TableContext(file, f"correlations[{i}]", notes)
        table = parse(CorrelationTable, correlation, str(file), section.name)
        one, other = (numbers.one(section, "between", text) for text in table.between)
        for entry, text in zip((one, other), table.between):
            if entry not in which:
                raise section.error("between", text, "this number is not under [[uncertainty]]")
        if one == other:
            raise section.error("between", table.between, "these two numbers are the same")
        row, column = which.index(one), which.index(other)
        matrix[row, column] = matrix[column, row] = table.value
    if which and np.linalg.eigvalsh(matrix).min() <= 1e-12:
        message = "the matrix of all correlations is not positive definite"
        raise CaseError(str(file), "correlations", None, message)
    return Uncertainty(
        tuple(name for name, _ in which), tuple(entry for _, entry in which), tuple(spreads),
        matrix, tuple(when), tuple(between),
    )  # fmt: skip
