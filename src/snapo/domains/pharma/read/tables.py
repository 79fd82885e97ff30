"""The tables of a pharma case of the TOML file, each key with its meaning.

A quantity is any value here: whether its number and unit are right is decided by `numbers`. Tables
of units are those of the unit operations.
"""

from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from snapo.case.parts import PartNames, names_of_parts
from snapo.case.quantity import Range
from snapo.case.report import ReportTable
from snapo.case.table import TITLE, CaseTable, Title

from .reader import PROBABILITY, TextKey, pair, quantity, tables, whole, within, word


class SpeciesTable(CaseTable):
    """`[species]`, one line for each."""

    molar_mass: Any = quantity('"150 g/mol"')


class ReactionTable(CaseTable):
    """`[[reactions]]`"""

    name: TextKey = Field(description="a name")
    equation: TextKey = Field(description='an equation such as "A + 2 B -> C"')
    prefactor: Any = quantity('"2.65e4 L/mol/s"', meaning="prefactor of the rate")
    activation: Any = quantity('"40 kJ/mol"', meaning="activation energy")
    heat: Any = quantity('"-50 kJ/mol"', "0 J/mol", meaning="heat of reaction")
    order: dict[str, Any] = Field({}, description="exponents such as { A = 2 }")


# `from` is a word of Python, so this table is not written as a class.
ENDS: dict[str, Any] = {
    "from": (TextKey, Field(description='a feed, or "unit.outlet"')),
    "to": (TextKey, Field(description='"unit.inlet"')),
}
ConnectionTable = pydantic.create_model("ConnectionTable", __base__=CaseTable, **ENDS)


class DistributionTable(CaseTable):
    """{ kind = "lognormal", spread = 0.1 }"""

    kind: Literal["normal", "lognormal", "uniform"] = word("normal", "lognormal", "uniform")
    spread: Any = Field(description='a number, or a quantity such as "0.5 K"')


class ParameterTable(CaseTable):
    """`[[parameters]]`"""

    name: TextKey = Field(description="a name")
    of: TextKey = Field(description='a number of the case, such as "crystalliser.temperature[1]"')
    range: list[Any] = pair('quantities such as ["303 K", "323 K"]')
    normal: list[Any] = pair('quantities such as ["312 K", "314 K"]')
    distribution: dict | None = Field(None, description='{ kind = "normal", spread = "0.5 K" }')
    control: bool = Field(True, description="true or false")
    source: TextKey = Field(description="a sentence on the origin of the range")


class AttributeTable(CaseTable):
    """`[[attributes]]`"""

    name: TextKey = Field(description="a name")
    measure: TextKey = Field(description='a measure such as "dryer.solvent"')
    unit: str = Field(description='a unit such as "um", or "1"')
    low: Any = quantity('"80 um"', None)
    high: Any = quantity('"100 um"', None)
    citation: str = Field("", description="the source of the limit, a sentence")
    margin: Any = quantity('"1 um"', None)


class UncertaintyTable(CaseTable):
    """`[[uncertainty]]`"""

    of: TextKey = Field(description='a number of the case, such as "kinetics.prefactor[0]"')
    distribution: dict = Field(description='{ kind = "lognormal", spread = 0.1 }')
    when: Literal["batch", "step"] = word("batch", "step", default="batch")
    between_batches: bool = Field(False, description="true or false")


class CorrelationTable(CaseTable):
    """`[[correlations]]`"""

    between: list[TextKey] = pair("of the numbers under [[uncertainty]]")
    value: float = within(Range(-1.0, 1.0, "()"))


class ManipulatedTable(CaseTable):
    """`[[control.manipulated]]`"""

    of: TextKey = Field(description='a control of a unit, such as "crystalliser.temperature"')
    low: Any = quantity('"273 K"')
    high: Any = quantity('"313 K"')
    ramp: Any = quantity('"0.5 K/min"', None)


class MeasurementTable(CaseTable):
    """`[[control.measurements]]`"""

    state: TextKey = Field(description='a state of a unit, such as "crystalliser.concentration"')
    error: Any = quantity('"0.1 kg/m^3"')
    centre: Any = quantity('"10 kg/m^3"')
    width: Any = quantity('"5 kg/m^3"')
    delay: Any = quantity('"2 min"', "0 s")


class ControlTable(CaseTable):
    """`[control]`"""

    manipulated: list[dict] = tables("[[control.manipulated]]")
    measurements: list[dict] = tables("[[control.measurements]]")
    steps: dict[str, Annotated[int, whole(1, 1000)]] = Field(
        description="decisions per unit, such as { crystalliser = 12 }"
    )
    substeps: int = whole(1, 64, default=32)
    solubility_margin: Any = Field(None, description="a number above 0")
    rules: list[dict] = Field([], description="tables [[control.rules]]")


class GoalTable(CaseTable):
    """`[goal]`"""

    kind: Literal["mean", "cvar", "probability"] = word(
        "mean", "cvar", "probability", default="probability"
    )
    attribute: str = Field("", description="the name of an attribute")
    sense: Literal["maximise", "minimise"] = word("maximise", "minimise", default="maximise")
    level: float = within(PROBABILITY, 0.95)
    penalty: float = within(Range(0.0), 1.0)


class DesignSpaceTable(CaseTable):
    """`[design_space]`"""

    axes: list[TextKey] = Field(
        min_length=2, max_length=3, description="the names of two or three parameters"
    )
    points: int = whole(3, 201, default=17, note=", of points along each axis")
    samples: int = whole(16, 10**6, default=256, note=", of draws at each point")
    levels: list[Annotated[float, within(PROBABILITY)]] = Field(
        [0.85, 0.95, 0.99], min_length=1, description=f"a list, each {PROBABILITY}"
    )
    required: float = within(PROBABILITY, 0.9)


class FitTable(CaseTable):
    """`[[estimation.fit]]`"""

    of: TextKey = Field(description='a number of the case, such as "kinetics.prefactor[0]"')
    low: Any = quantity('"1e3 L/mol/s"')
    high: Any = quantity('"1e6 L/mol/s"')
    logarithm: bool = Field(False, description="true or false")


class ExperimentTable(CaseTable):
    """`[[estimation.experiments]]`"""

    name: TextKey = Field(description="a name")
    data: TextKey = Field(description="a CSV file with columns time,state,value,error")
    settings: dict[str, Any] = Field(
        {}, description='numbers that differ, such as { "charge.temperature" = "303 K" }'
    )
    held_out: bool = Field(False, description="true or false")


class EstimationTable(CaseTable):
    """`[estimation]`"""

    fit: list[dict] = tables("[[estimation.fit]]")
    experiments: list[dict] = tables("[[estimation.experiments]]")
    level: float = within(PROBABILITY, 0.95)
    errors: Literal["known", "relative"] = word("known", "relative", default="known")
    starts: int = whole(1, 1000, default=8, note=", of points from which the search begins")


TOLERANCE = Range(0.0, 0.1, "()", note=", such as 1e-10")


class NumericsTable(CaseTable):
    """`[numerics]`"""

    method: Literal["auto", "mesh", "stiff", "adaptive"] = word(
        "auto", "mesh", "stiff", "adaptive", default="auto"
    )
    steps: int = whole(8, 100_000, default=320)
    tolerance: float = within(TOLERANCE, 1e-10)
    max_steps: int = whole(1, default=20_000)
    refine: bool = Field(True, description="true or false")
    loop_tolerance: float = within(TOLERANCE, 1e-10)
    loop_rounds: int = whole(1, 1000, default=50)


class PharmaReportTable(ReportTable):
    """`[report]`: the parts of a run that are wanted, and texts of its page."""

    parts: PartNames = names_of_parts("capability")


class PharmaTable(CaseTable):
    """The whole file."""

    kind: Literal["pharma"] = word("pharma")
    title: Title = Field("Pharmaceutical process", description=TITLE)
    purpose: str = Field("", description="a sentence on the purpose of the model")
    assumptions: list[str] = Field([], description="sentences for the report")
    held: list[TextKey] = Field([], description="numbers of the case that get no sensitivity")
    fitted: TextKey | None = Field(
        None, description='the file "fitted.csv" of a run with [estimation]'
    )
    reference_temperature: Any = quantity('"313.15 K"', None)
    species: dict = Field(description='lines such as A = { molar_mass = "100 g/mol" }')
    reactions: list[dict] = Field([], description="tables [[reactions]]")
    feeds: dict = Field(description="tables [feeds.NAME]")
    units: dict = Field(description="tables [units.NAME]")
    connections: list[dict] = Field([], description="tables [[connections]]")
    parameters: list[dict] = tables("[[parameters]]")
    attributes: list[dict] = tables("[[attributes]]")
    uncertainty: list[dict] = Field([], description="tables [[uncertainty]]")
    correlations: list[dict] = Field([], description="tables [[correlations]]")
    pairs: list[Annotated[list[TextKey], pair("parameters")]] = Field(
        [], description='pairs of parameters, such as [["T_R", "W"]]'
    )
    control: dict | None = Field(None, description="the table [control]")
    goal: dict = Field({}, description="the table [goal]")
    design_space: dict | None = Field(None, description="the table [design_space]")
    estimation: dict | None = Field(None, description="the table [estimation]")
    optimise: dict | None = Field(None, description="the table [optimise]")
    report: dict = Field({}, description="the table [report]")
    numerics: dict = Field({}, description="the table [numerics]")
    training: dict = Field({}, description="the table [training]")
    evaluation: dict = Field({}, description="the table [evaluation]")
