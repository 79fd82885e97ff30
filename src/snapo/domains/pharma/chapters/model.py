"""The statement of a case: purpose, flowsheet, equations, parameters with their sources, numbers.

It is available before any number is computed, so it is a part of a study's `about`.
"""

import re
from dataclasses import dataclass

from snapo.case.quantity import numbers_in
from snapo.problem.record import Input
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Missing, Table, Text
from snapo.report.quantity import finite, quantity, raised, unit_words
from snapo.report.rows import Column, table
from snapo.study.chapter import Chapter, Number

from ..derivatives.sensitivities import entry_name
from ..flowsheet.case import PharmaCase
from ..flowsheet.inputs import pharma_inputs
from ..flowsheet.network import FlowNetwork
from ..given import Entry
from ..quality.design_space import in_case_unit
from ..quality.draws import entries, nominal
from ..quality.records import Distribution
from ..shared import open_loop

POWERS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
ASSUMPTIONS = (
    "Concentrations refer to the volume of the stream, which mixing, reaction and crystallisation "
    "do not change.",
    "Units are ideally mixed and hold their temperature profile, unless they have a heat balance.",
)
SCOPE = (
    "This report supports decisions. The software is not validated in the sense of GMP, and the "
    "model has not been compared with data of this process unless an estimation is reported below."
)


@dataclass(frozen=True)
class AttributeStatement:
    """A quality attribute with its limits in `unit`; `citation`: their source."""

    name: str
    measure: str = ""
    unit: str = "1"
    low: float | None = None
    high: float | None = None
    citation: str = ""
    margin: float = 0.0

    @property
    def limited(self) -> bool:
        """Whether the attribute has a limit."""
        return self.low is not None or self.high is not None

    @property
    def shown_unit(self) -> str:
        """Its unit in typeset form."""
        return unit_words(self.unit)

    @property
    def limits(self) -> str:
        """The limits as text, such as "70 to 100 um" or "at most 720 ppm"."""
        unit = "" if self.unit == "1" else self.unit
        if self.low is not None and self.high is not None:
            return f"{quantity(self.low, '')} to {quantity(self.high, unit)}"
        if self.low is not None:
            return f"at least {quantity(self.low, unit)}"
        return f"at most {quantity(self.high, unit)}" if self.high is not None else "no limit"


@dataclass(frozen=True)
class ParameterStatement:
    """A process parameter in the case's unit; `of`: the name of its number in the model."""

    name: str
    of: str
    unit: str
    nominal: float
    range: tuple[float, float]
    normal: tuple[float, float]
    distribution: str
    control: bool
    source: str

    @property
    def shown_unit(self) -> str:
        """Its unit in typeset form."""
        return unit_words(self.unit)


@dataclass(frozen=True)
class ReactionStatement:
    """A mass-action reaction, in the units of the computation."""

    name: str
    equation: str
    rate: str
    prefactor: float
    prefactor_unit: str
    activation: float
    heat: float
    reference: float | None = None


@dataclass(frozen=True)
class UnitStatement:
    """A unit of the flowsheet, with its measures, the states that it records, and their units."""

    name: str
    type: str
    equations: tuple[str, ...]
    measures: dict[str, str]
    states: dict[str, str]


@dataclass(frozen=True)
class UncertaintyStatement:
    """An uncertain number; `when`: the interval after which it is drawn again, "batch" or
    "step"."""

    of: str
    nominal: float
    unit: str
    distribution: str
    when: str


@dataclass(frozen=True)
class NumberStatement:
    """A number as used in the computation; `parameter`: the name of its parameter, or ""."""

    input: str
    label: str
    value: Number
    unit: str
    parameter: str


@dataclass(frozen=True)
class NumericsStatement:
    """The method of integration over time, its steps per piece, and its tolerance."""

    method: str
    steps: int
    tolerance: float


@dataclass(frozen=True)
class Statement:
    """The description of a case before any number is computed; `connections`: rows with "from" and
    "to"."""

    purpose: str = ""
    scope: str = ""
    assumptions: tuple[str, ...] = ()
    symbols: str = ""
    reactions: tuple[ReactionStatement, ...] = ()
    units: tuple[UnitStatement, ...] = ()
    connections: tuple[dict[str, str], ...] = ()
    attributes: tuple[AttributeStatement, ...] = ()
    parameters: tuple[ParameterStatement, ...] = ()
    uncertainty: tuple[UncertaintyStatement, ...] = ()
    numbers: tuple[NumberStatement, ...] = ()
    numerics: NumericsStatement | None = None

    @property
    def attribute_names(self) -> list[str]:
        return [attribute.name for attribute in self.attributes]

    @property
    def parameter_names(self) -> list[str]:
        return [parameter.name for parameter in self.parameters]


def statement(case: PharmaCase) -> Statement:
    """The statement of a case, in user units."""
    available = dict(pair for unit in case.units for pair in unit.symbols)
    of_units = dict.fromkeys(text for unit in case.units for text in unit.assumptions)
    numerics, species = case.numerics, case.network.species
    return Statement(
        purpose=case.purpose,
        scope=SCOPE,
        assumptions=(*ASSUMPTIONS, *of_units, *case.assumptions),
        symbols="; ".join(f"{symbol}: {meaning}" for symbol, meaning in available.items()),
        reactions=tuple(_reaction(case.network, i) for i in range(len(case.network.reactions))),
        units=tuple(
            UnitStatement(
                unit.name, unit.title, tuple(unit.equations()), dict(unit.measures(species)),
                dict(unit.states(species)),
            )
            for unit in case.units
        ),
        connections=tuple(
            {"from": f"{c.source}.{c.outlet}".rstrip("."), "to": f"{c.target}.{c.inlet}"}
            for c in case.connections
        ),
        attributes=tuple(
            AttributeStatement(x.name, x.measure, x.unit, x.low, x.high, x.citation, x.margin)
            for x in case.attributes
        ),
        parameters=_parameters(case),
        uncertainty=_uncertainty(case),
        numbers=_numbers(case),
        numerics=NumericsStatement(numerics.method, numerics.steps, numerics.tolerance),
    )  # fmt: skip


def _parameters(case: PharmaCase) -> tuple[ParameterStatement, ...]:
    return tuple(
        ParameterStatement(
            name=p.name, of=entry_name(case, p.input, p.entry), unit=p.unit,
            nominal=float(in_case_unit(p, nominal(case, [(p.input, p.entry)])[0])),
            range=(in_case_unit(p, p.low), in_case_unit(p, p.high)),
            normal=(in_case_unit(p, p.normal_low), in_case_unit(p, p.normal_high)),
            distribution=_in_words(p.distribution, p.scale, p.unit), control=p.control,
            source=p.source,
        )
        for p in case.parameters
    )  # fmt: skip


def _uncertainty(case: PharmaCase) -> tuple[UncertaintyStatement, ...]:
    units = {x.name: x.unit for x in numbers_in((case.network, case.feeds, case.units))}
    values, uncertainty = nominal(case, entries(case)), case.uncertainty
    return tuple(
        UncertaintyStatement(
            entry_name(case, *entry), float(value), units[entry[0]],
            _in_words(kind, 1.0, units[entry[0]]), when,
        )
        for entry, value, kind, when in zip(
            entries(case), values, uncertainty.distributions, uncertainty.when
        )
    )  # fmt: skip


def _in_words(kind: Distribution | None, scale: float, unit: str) -> str:
    """The distribution as text, "normal, 0.3 K"; a pure spread is in per cent."""
    if kind is None:
        return "held"
    if kind.kind == "lognormal":
        return f"lognormal, {100 * kind.spread:g} %"
    if kind.kind == "logarithm":
        return f"lognormal about the median, {100 * kind.spread:g} %"
    spread = f"{kind.spread / scale:.4g}" + ("" if unit == "1" else f" {unit}")
    return f"uniform, {spread} to either side" if kind.kind == "uniform" else f"normal, {spread}"


def _numbers(case: PharmaCase) -> tuple[NumberStatement, ...]:
    """Every number of the model, as it enters the computation."""
    names: dict[Entry, str] = {(x.input, x.entry): x.name for x in case.parameters}
    inputs: dict[str, Input] = pharma_inputs(case)
    return tuple(
        NumberStatement(name, label, value, entry.unit, names.get((name, i), ""))
        for name, entry in inputs.items()
        for i, (label, value) in enumerate(zip(entry.labels, entry.value.ravel().tolist()))
    )


def _reaction(network: FlowNetwork, i: int) -> ReactionStatement:
    sides: list[list[str]] = [[], []]
    for name, amount in zip(network.species, network.stoichiometry[i]):
        if amount:
            count = "" if abs(amount) == 1 else f"{abs(amount):g} "
            sides[int(amount > 0)].append(f"{count}{name}")
    orders = [
        f"c_{name}" + ("" if order == 1 else f"^{order:g}")
        for name, order in zip(network.species, network.order[i])
        if order
    ]
    return ReactionStatement(
        name=network.reactions[i], equation=f"{' + '.join(sides[0])} → {' + '.join(sides[1])}",
        rate=" ".join(["k", *orders]), prefactor=float(network.prefactor.values[i]),
        prefactor_unit=network.prefactor.unit, activation=float(network.activation.values[i]),
        heat=float(network.heat.values[i]), reference=network.reference,
    )  # fmt: skip


def show(run: RunFiles, result: Statement) -> list[Block]:
    """Purpose, flowsheet, equations, parameters with their sources, and uncertain numbers."""
    blocks: list[Block] = [Text(result.purpose)] if result.purpose else []
    if result.scope:
        blocks.append(Text(result.scope, caveat=True))
    if not result.units:
        return [*blocks, Missing("This run has no record of its flowsheet.")]
    flow = [" → ".join(pair.values()) for pair in result.connections]
    if flow:
        blocks.append(Text("Flowsheet: " + "; ".join(flow) + "."))
    blocks.append(_reactions(result))
    columns = (
        Column("Unit", "name"),
        Column("Type", "type"),
        Column("Equations", lambda unit: "; ".join(unit.equations)),
    )
    blocks.append(table(result.units, columns, "Model of each unit"))
    if result.symbols:
        blocks.append(Text(f"Symbols: {result.symbols}."))
    return [*blocks, *_tables(result)]


def number_text(value: float, unit: str = "") -> str:
    """A number of the case with all its digits: 313.15 K, 4.46 × 10¹⁰ 1/m3/s."""
    if value == 0 or 1e-3 <= abs(value) < 1e7:
        text = f"{value:,.10f}".rstrip("0").rstrip(".").replace("-", "−")
        if value != float(f"{value:.10f}"):
            text = f"{value:.10g}".replace("-", "−")
    else:
        mantissa, _, power = f"{value:.9e}".partition("e")
        displayed = str(int(power)).translate(POWERS)
        text = f"{mantissa.rstrip('0').rstrip('.')} × 10{displayed}".replace("-", "−")
    return f"{text}\u00a0{unit_words(unit)}" if unit and unit != "1" else text


def location(value: float | None, unit: str = "") -> str:
    """A position on a parameter's axis, with five digits: enough for 313.15 K."""
    available = finite(value)
    return "–" if available is None else number_text(float(f"{available:.5g}"), unit)


def _reactions(result: Statement) -> Table | Text:
    if not result.reactions:
        return Text("Nothing reacts.")
    rows = [
        (
            x.name, x.equation, x.rate, number_text(x.prefactor, x.prefactor_unit),
            number_text(x.activation / 1000, "kJ/mol"), number_text(x.heat / 1000, "kJ/mol"),
        )
        for x in result.reactions
    ]  # fmt: skip
    names = ("Reaction", "Equation", "Rate", "Prefactor", "Activation", "Heat of reaction")
    reference = result.reactions[0].reference
    power = "E/(R T)" if reference is None else f"E/R (1/T − 1/{number_text(reference, 'K')})"
    caption = f"Mass-action reactions; k = prefactor exp(−{power})"
    return Table([(name, "") for name in names], rows, caption, 3)


def _tables(result: Statement) -> list[Block]:
    """Parameters, uncertain numbers, and every number."""
    parameters = [
        (
            x.name, x.of, x.source, number_text(x.nominal, x.shown_unit),
            *(" – ".join(map(number_text, endpoints)) for endpoints in (x.normal, x.range)),
            x.distribution,
        )
        for x in result.parameters
    ]  # fmt: skip
    uncertain = [
        (x.of, x.distribution, x.when, number_text(x.nominal, x.unit)) for x in result.uncertainty
    ]
    numbers = [
        (x.input, label, x.parameter, number_text(x.value, unit))
        for x in result.numbers
        for label, unit in [_of_power(x.label, x.unit)]
    ]
    names = ("Parameter", "Number of the case", "Source", "Set point", "Normal range",
             "Studied range", "Varies")  # fmt: skip
    head = [(name, "") for name in names]
    texts = frozenset({0, 1, 2, 6})
    blocks: list[Block] = [Table(head, parameters, "Process parameters", texts)]
    if uncertain:
        head = [("Number", ""), ("Distribution", ""), ("New in every", ""), ("Nominal", "")]
        caption = "Uncertain numbers of the model"
        blocks.append(Table(head, uncertain, caption, 3))
    else:
        blocks.append(Text("Every number of the model counts as known exactly."))
    head = [("Input", ""), ("Entry", ""), ("Parameter", ""), ("Value", "")]
    caption = "Every number of the model, in the units of the computation"
    return [*blocks, Table(head, numbers, caption, 3, folded="Every number")]


def _of_power(label: str, unit: str) -> tuple[str, str]:
    """A coefficient's label and unit in typeset form: "t^2", "kg/m3/K^k" as "t²", "kg/m3/K2"."""
    power = re.fullmatch(r"t\^(\d+)", label)
    if power is None:
        return label, unit
    kelvins = {"0": "", "1": "/K"}.get(power[1], f"/K{power[1]}")
    text = unit.replace("/K^k", kelvins)
    return f"t{raised(power[1])}", "" if text == "1" else text


MODEL = Chapter(
    "model", "Purpose, model and equations", Statement,
    lambda run: statement(open_loop(run).case), show
)  # fmt: skip


def stated(run: RunFiles) -> Statement:
    """The statement of the case in the files of a run."""
    return MODEL.of(run) or Statement()
