"""The tables in the TOML file of a pharma case; every key has its meaning.

Here a quantity may have any value; `numbers` checks its number and its unit. Tables of units are
those of the unit operations.
"""

from typing import Annotated, Any, Literal

import pydantic

from snapo.case.parts import PartNames, names_of_parts
from snapo.case.quantity import Range
from snapo.case.report import ReportKey, ReportTable
from snapo.case.settings import EvaluationKey, TrainingKey
from snapo.case.table import CaseTable, Title, doc, subtable

from .reader import PROBABILITY, TextKey, pair, quantity, tables, whole, within


class SpeciesTable(CaseTable):
    """`[species]`, one line for each."""

    molar_mass: Any = quantity("molar mass", '"150 g/mol"')


class ReactionTable(CaseTable):
    """`[[reactions]]`"""

    name: TextKey = doc("name of the reaction", allowed="a name")
    equation: TextKey = doc("reaction equation", allowed='an equation such as "A + 2 B -> C"')
    prefactor: Any = quantity("prefactor of the rate", '"2.65e4 L/mol/s"')
    activation: Any = quantity("activation energy", '"40 kJ/mol"')
    heat: Any = quantity("heat of reaction", '"-50 kJ/mol"', "0 J/mol")
    order: dict[str, Any] = doc(
        "orders of the rate that differ from the numbers in the equation",
        {},
        "exponents such as { A = 2 }",
    )


# `from` is a word of Python, so this table is not written as a class.
ENDS: dict[str, Any] = {
    "from": (TextKey, doc("where material comes from", allowed='a feed, or "unit.outlet"')),
    "to": (TextKey, doc("where material goes", allowed='"unit.inlet"')),
}
ConnectionTable = pydantic.create_model("ConnectionTable", __base__=CaseTable, **ENDS)


class DistributionTable(CaseTable):
    """{ kind = "lognormal", spread = 0.1 }"""

    kind: Literal["normal", "lognormal", "uniform"] = doc("distribution around the value")
    spread: Any = doc(
        "standard deviation, or half of the width of a uniform distribution",
        allowed='a number, or a quantity such as "0.5 K"',
    )


class ParameterTable(CaseTable):
    """`[[parameters]]`"""

    name: TextKey = doc("name of the parameter", allowed="a name")
    of: TextKey = doc(
        "number of the case that it varies",
        allowed='a number of the case, such as "crystalliser.temperature[1]"',
    )
    range: list[Any] = pair("range that is studied", 'quantities such as ["303 K", "323 K"]')
    normal: list[Any] = pair("normal operating range", 'quantities such as ["312 K", "314 K"]')
    distribution: dict | None = doc(
        "variation from batch to batch, by default none",
        None,
        '{ kind = "normal", spread = "0.5 K" }',
    )
    control: bool = doc("whether the parameter is controlled; false for a material attribute", True)
    source: TextKey = doc("origin of the range", allowed="a sentence on the origin of the range")


class AttributeTable(CaseTable):
    """`[[attributes]]`"""

    name: TextKey = doc("name of the quality attribute", allowed="a name")
    measure: TextKey = doc("measure of the process", allowed='a measure such as "dryer.solvent"')
    unit: str = doc("unit of the attribute in all tables", allowed='a unit such as "um", or "1"')
    low: Any = quantity("lower limit", '"80 um"', None)
    high: Any = quantity("upper limit", '"100 um"', None)
    citation: str = doc("source of the limits", "", "the source of the limit, a sentence")
    margin: Any = quantity(
        "a difference that counts as small, by default 2 % of the distance between the limits",
        '"1 um"',
        None,
    )


class UncertaintyTable(CaseTable):
    """`[[uncertainty]]`"""

    of: TextKey = doc(
        "uncertain number of the case",
        allowed='a number of the case, such as "kinetics.prefactor[0]"',
    )
    distribution: dict = doc(
        "distribution around its value", allowed='{ kind = "lognormal", spread = 0.1 }'
    )
    when: Literal["batch", "step"] = doc(
        "whether it is drawn for a batch, or for every decision step", "batch"
    )
    between_batches: bool = doc("whether it differs between batches", False)


class CorrelationTable(CaseTable):
    """`[[correlations]]`"""

    between: list[TextKey] = pair(
        "uncertain numbers that are correlated", "of the numbers under [[uncertainty]]"
    )
    value: float = within("correlation of the two", Range(-1.0, 1.0, "()"))


class ManipulatedTable(CaseTable):
    """`[[control.manipulated]]`"""

    of: TextKey = doc(
        "control that the policy decides",
        allowed='a control of a unit, such as "crystalliser.temperature"',
    )
    low: Any = quantity("lower bound", '"273 K"')
    high: Any = quantity("upper bound", '"313 K"')
    ramp: Any = quantity("fastest change; by default that of the profile", '"0.5 K/min"', None)


class MeasurementTable(CaseTable):
    """`[[control.measurements]]`"""

    state: TextKey = doc(
        "state that is measured", allowed='a state of a unit, such as "crystalliser.concentration"'
    )
    error: Any = quantity("standard deviation of the error", '"0.1 kg/m^3"')
    centre: Any = quantity("reading that the policy sees as 0", '"10 kg/m^3"')
    width: Any = quantity("difference of readings that the policy sees as 1", '"5 kg/m^3"')
    delay: Any = quantity("dead time of the measurement", '"2 min"', "0 s")


class ControlTable(CaseTable):
    """`[control]`"""

    manipulated: list[dict] = tables("controls that the policy decides", "[[control.manipulated]]")
    measurements: list[dict] = tables("states that the policy observes", "[[control.measurements]]")
    steps: dict[str, Annotated[int, whole("", 1, 1000)]] = doc(
        "number of decisions in a unit; other units keep their recipe",
        allowed="decisions per unit, such as { crystalliser = 12 }",
    )
    substeps: int = whole("integration steps within one decision", 1, 64, default=32)
    solubility_margin: Any = doc("largest relative supersaturation", None, "a number above 0")
    rules: list[dict] = doc("controllers for comparison", [], "tables [[control.rules]]")


class GoalTable(CaseTable):
    """`[goal]`"""

    kind: Literal["mean", "cvar", "probability"] = doc("maximised statistic", "probability")
    attribute: str = doc("attribute whose mean or CVaR is the goal", "", "the name of an attribute")
    sense: Literal["maximise", "minimise"] = doc(
        "whether the attribute is maximised or minimised", "maximise"
    )
    level: float = within("level of the CVaR, the mean of the worst 1 - level", PROBABILITY, 0.95)
    penalty: float = within(
        "penalty for every margin by which a limit is violated", Range(0.0), 1.0
    )


class DesignSpaceTable(CaseTable):
    """`[design_space]`"""

    axes: list[TextKey] = doc(
        "parameters along the axes",
        allowed="the names of two or three parameters",
        min_length=2,
        max_length=3,
    )
    points: int = whole("points per axis", 3, 201, default=17, note=", of points along each axis")
    samples: int = whole(
        "draws of the uncertain numbers at every point",
        16,
        10**6,
        default=256,
        note=", of draws at each point",
    )
    levels: list[Annotated[float, within("", PROBABILITY)]] = doc(
        "probabilities of the contours",
        [0.85, 0.95, 0.99],
        f"a list, each {PROBABILITY}",
        min_length=1,
    )
    required: float = within("probability of all limits in the design space", PROBABILITY, 0.9)


class FitTable(CaseTable):
    """`[[estimation.fit]]`"""

    of: TextKey = doc(
        "number that is fitted", allowed='a number of the case, such as "kinetics.prefactor[0]"'
    )
    low: Any = quantity("lower bound", '"1e3 L/mol/s"')
    high: Any = quantity("upper bound", '"1e6 L/mol/s"')
    logarithm: bool = doc("whether its logarithm is fitted", False)


class ExperimentTable(CaseTable):
    """`[[estimation.experiments]]`"""

    name: TextKey = doc("name of the measured batch", allowed="a name")
    data: TextKey = doc("measurements", allowed="a CSV file with columns time,state,value,error")
    settings: dict[str, Any] = doc(
        "numbers that were different in the batch",
        {},
        'numbers that differ, such as { "charge.temperature" = "303 K" }',
    )
    held_out: bool = doc("whether the batch is predicted and not fitted", False)


class EstimationTable(CaseTable):
    """`[estimation]`"""

    fit: list[dict] = tables("numbers that are fitted", "[[estimation.fit]]")
    experiments: list[dict] = tables("measured batches", "[[estimation.experiments]]")
    level: float = within("confidence level of the intervals", PROBABILITY, 0.95)
    errors: Literal["known", "relative"] = doc(
        "whether measurement errors are known, or only their ratios", "known"
    )
    starts: int = whole(
        "number of points from which the search begins",
        1,
        1000,
        default=8,
        note=", of points from which the search begins",
    )


TOLERANCE = Range(0.0, 0.1, "()", note=", such as 1e-10")


class NumericsTable(CaseTable):
    """`[numerics]`"""

    method: Literal["auto", "mesh", "stiff", "adaptive"] = doc("method of integration", "auto")
    steps: int = whole("integration steps for every piece of a profile", 8, 100_000, default=320)
    tolerance: float = within("relative tolerance of adaptive steps", TOLERANCE, 1e-10)
    max_steps: int = whole("largest number of adaptive steps", 1, default=20_000)
    refine: bool = doc("whether a finer batch is computed too, and the changes reported", True)
    loop_tolerance: float = within("relative tolerance of recycles", TOLERANCE, 1e-10)
    loop_rounds: int = whole("largest number of rounds of a recycle", 1, 1000, default=50)


class PharmaReportTable(ReportTable):
    """`[report]`: the requested parts of a run, and texts of its page."""

    parts: PartNames = names_of_parts("capability")


class PharmaTable(CaseTable):
    """The whole file."""

    kind: Literal["pharma"] = doc("kind of the case")
    title: Title = "Pharmaceutical process"
    purpose: str = doc("purpose of the model", "", "a sentence on the purpose of the model")
    assumptions: list[str] = doc("additional assumptions", [], "sentences for the report")
    held: list[TextKey] = doc(
        "numbers without a sensitivity",
        [],
        "numbers of the case for which no sensitivity is computed",
    )
    fitted: TextKey | None = doc(
        "fitted numbers, with their covariance, instead of those of the case",
        None,
        'the file "fitted.csv" of a run with [estimation]',
    )
    reference_temperature: Any = quantity(
        "temperature at which prefactors are the rate constants, by default infinite",
        '"313.15 K"',
        None,
    )
    species: dict = doc(
        "species, and their molar masses", allowed='lines such as A = { molar_mass = "100 g/mol" }'
    )
    reactions: list[dict] = doc("reactions between the species", [], "tables [[reactions]]")
    feeds: dict = doc("material that enters", allowed="tables [feeds.NAME]")
    units: dict = doc("unit operations", allowed="tables [units.NAME]")
    connections: list[dict] = doc("connections of feeds and units", [], "tables [[connections]]")
    parameters: list[dict] = tables("process parameters and their ranges", "[[parameters]]")
    attributes: list[dict] = tables("quality attributes, with their limits", "[[attributes]]")
    uncertainty: list[dict] = doc("uncertain numbers", [], "tables [[uncertainty]]")
    correlations: list[dict] = doc(
        "correlations of uncertain numbers", [], "tables [[correlations]]"
    )
    pairs: list[Annotated[list[TextKey], pair("", "parameters")]] = doc(
        "pairs of parameters for second derivatives",
        [],
        'pairs of parameters, such as [["T_R", "W"]]',
    )
    control: dict | None = subtable("control by a policy within a batch", "control", None)
    goal: dict = subtable("goal of the policy", "goal", {})
    design_space: dict | None = subtable(
        "ranges in which all limits are met with the required probability", "design_space", None
    )
    estimation: dict | None = subtable("fit of numbers to measured batches", "estimation", None)
    optimise: dict | None = subtable("recipe that is optimised", "optimise", None)
    report: ReportKey
    numerics: dict = subtable("methods and tolerances", "numerics", {})
    training: TrainingKey
    evaluation: EvaluationKey
