"""Reads a pharma case: a TOML file and the CSVs next to it become a `PharmaCase`."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.case.parts import known_parts
from snapo.case.plausible import CaseFiles
from snapo.case.quantity import numbers_in
from snapo.case.settings import EvaluationTable, TrainingTable, read_evaluation, read_training
from snapo.case.table import TableContext, parse

from ..flowsheet.case import PharmaCase
from ..flowsheet.feed import Feed
from ..time.dynamics import Numerics
from ..units.crystals.kinetics import Kinetics
from ..units.crystals.seed import Seed
from ..units.crystals.sizes import SizesTable
from ..units.crystals.solubility import Mixture, Solubility
from ..units.operation import Unit, timed
from ..units.reactor import Jacket
from ..units.registry import TYPES, read_units
from ..units.tray_dryer import Liquid
from .entries import EntryNumbers
from .estimation import read_estimation
from .fitted import read_fitted
from .loops import InnerTable, LoopTable, RuleTable, read_control
from .network import ordered, read_connections, read_feeds, read_network
from .optimise import (
    DecisionTable,
    OptimiseTable,
    TermTable,
    read_design_space,
    read_goal,
    read_optimise,
)
from .plausible.checks import (
    check_amounts,
    check_decided,
    check_moved,
    check_moved_solubility,
    check_physics,
    check_spans,
    check_varied_once,
    unusual,
)
from .quality import every_measure, read_attributes, read_parameters, read_uncertainty
from .tables import (
    AttributeTable,
    ConnectionTable,
    ControlTable,
    CorrelationTable,
    DesignSpaceTable,
    DistributionTable,
    EstimationTable,
    ExperimentTable,
    FitTable,
    GoalTable,
    ManipulatedTable,
    MeasurementTable,
    NumericsTable,
    ParameterTable,
    PharmaReportTable,
    PharmaTable,
    ReactionTable,
    SpeciesTable,
    UncertaintyTable,
)

# Where a case does not say: limits as soft as their margins at first, so that all of them are felt.
PARTS = (
    "one batch", "integration", "balances", "convergence", "certificate", "sensitivity matrix",
    "all sensitivities", "attribution", "profile sensitivities", "second derivatives",
    "mesh of statistics", "capability", "criticality", "spread", "best recipe", "design space",
    "proven ranges", "pairs of ranges", "estimation", "best fixed recipe", "training",
    "closed loop",
)  # fmt: skip
TRAINING = {
    "steps": 150, "paths": 256, "learning_rate": 0.02, "warmup": 10, "temperature_start": 1.0,
    "temperature_end": 0.1, "validation_paths": 2048, "validation_every": 25,
}  # fmt: skip
EVALUATION = {"paths": 16384, "sensitivity_paths": 1024}
# Which units take the steps of stiff ones, by the case's method.
STIFF: dict[str, Literal["none", "measured", "all"]] = {
    "auto": "measured", "stiff": "all", "mesh": "none", "adaptive": "none"
}  # fmt: skip

FORMATS = {
    "": PharmaTable,
    "species.*": SpeciesTable,
    "reactions[]": ReactionTable,
    "feeds.*": Feed.table,
    "units.*": [unit.table for variants in TYPES.values() for unit in variants.values()],
    **{
        f"units.*.{key}": table
        for key, table in (
            ("sizes", SizesTable),
            ("solubility", Solubility.table),
            ("kinetics", Kinetics.table),
            ("seed", Seed.table),
            ("jacket", Jacket.table),
            ("liquid", Liquid.table),
            ("solubility.nrtl", Mixture.table),
        )
    },
    "connections[]": ConnectionTable,
    "parameters[]": ParameterTable,
    "parameters[].distribution": DistributionTable,
    "attributes[]": AttributeTable,
    "uncertainty[]": UncertaintyTable,
    "uncertainty[].distribution": DistributionTable,
    "correlations[]": CorrelationTable,
    "control": ControlTable,
    "control.manipulated[]": ManipulatedTable,
    "control.measurements[]": MeasurementTable,
    "control.rules[]": RuleTable,
    "control.rules[].loops[]": LoopTable,
    "control.rules[].loops[].inner": InnerTable,
    "estimation": EstimationTable,
    "estimation.fit[]": FitTable,
    "estimation.experiments[]": ExperimentTable,
    "goal": GoalTable,
    "design_space": DesignSpaceTable,
    "optimise": OptimiseTable,
    "optimise.terms[]": TermTable,
    "optimise.per[]": TermTable,
    "optimise.decisions[]": DecisionTable,
    "report": PharmaReportTable,
    "numerics": NumericsTable,
    "training": TrainingTable,
    "evaluation": EvaluationTable,
}


def read_case(path: str | Path) -> PharmaCase:
    """Reads and checks the case at `path`, a TOML file or a folder with `case.toml`.

    **Raises:** `CaseError` if a table, a quantity or the flowsheet is wrong; nothing is written.
    """
    file, data = load(Path(path))
    return resolve(file, data)


def without_checks(data: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of a case whose numbers are moved: with normal ranges as wide as the studied
    ranges, and without measured batches. No value depends on either."""
    data = {key: table for key, table in data.items() if key != "estimation"}
    parameters = data.get("parameters")
    if isinstance(parameters, list):
        data["parameters"] = [
            {**x, "normal": x["range"]} if isinstance(x, Mapping) and "range" in x else x
            for x in parameters
        ]
    return data


def resolve(file: Path, data: Mapping[str, Any]) -> PharmaCase:
    """The same for TOML data that was read already; other files are searched for next to `file`."""
    top = parse(PharmaTable, data, str(file), "")
    notes: list[str] = []
    network = read_network(file, top.species, top.reactions, top.reference_temperature, notes)
    feeds = read_feeds(file, top.feeds, network.species, notes)
    units = read_units(file, top.units, network.species, notes)
    connections = read_connections(file, top.connections, feeds, units)
    units = ordered(file, units, connections)
    numbers = EntryNumbers(
        {values.name: values for values in numbers_in((network, feeds, units))}, network
    )
    fit = read_fitted(file, top.fitted, numbers, notes)
    check_amounts(file, feeds, units, connections, notes)
    check_physics(file, feeds, units, network)
    notes += unusual(CaseFiles(file, data), feeds, units, network)
    parameters = read_parameters(file, top.parameters, numbers, notes)
    attributes = read_attributes(file, top.attributes, network, feeds, units, notes)
    report = parse(PharmaReportTable, top.report, str(file), "report")
    case = PharmaCase(
        file=file,
        title=top.title,
        purpose=top.purpose,
        network=network,
        feeds=feeds,
        units=units,
        connections=connections,
        parameters=parameters,
        attributes=attributes,
        uncertainty=read_uncertainty(file, top.uncertainty, top.correlations, numbers, notes, fit),
        control=read_control(file, top.control, numbers, network.species, units, notes),
        goal=read_goal(file, top.goal, attributes),
        design_space=read_design_space(file, top.design_space, parameters, attributes),
        estimation=read_estimation(file, top.estimation, numbers, network.species, units, notes),
        pairs=_read_pairs(file, top.pairs, [parameter.name for parameter in parameters]),
        held=_read_held(file, top.held, numbers, parameters),
        numerics=_read_numerics(file, top.numerics, units),
        training=read_training({**TRAINING, **top.training}, str(file)),
        evaluation=read_evaluation({**EVALUATION, **top.evaluation}, str(file)),
        assumptions=tuple(top.assumptions),
        notes=tuple(notes),
        parts=known_parts(file, report.parts, PARTS),
        optimise=read_optimise(file, top.optimise, numbers, every_measure(network, units), notes),
    )
    spans = [(item.input, item.low, item.high) for item in parameters]
    spans += [(m.input, m.low, m.high) for m in (case.control.manipulated if case.control else ())]
    spans += [(d.input, d.low, d.high) for d in (case.optimise.decisions if case.optimise else ())]
    more = dict.fromkeys(check_moved_solubility(units, spans, numbers))
    case = replace(case, notes=(*case.notes, *more))
    check_moved(case)
    check_spans(case, _highest(case))
    check_decided(case)
    check_varied_once(case)
    return case


def _highest(case: PharmaCase) -> list[tuple[str, str, float]]:
    """Rows (key where a number is studied, decided or uncertain; its name; its highest value)."""
    results = [
        (f"parameters.{parameter.name}", parameter.input, parameter.high)
        for parameter in case.parameters
    ]
    decisions = case.optimise.decisions if case.optimise else ()
    results += [
        (f"optimise.decisions.{decision.name}", decision.input, decision.high)
        for decision in decisions
    ]
    return results + [("uncertainty", name, 0.0) for name in case.uncertainty.inputs]


def _read_pairs(file, raw: list[list[str]], names: list[str]) -> tuple[tuple[str, str], ...]:
    for i, pair in enumerate(raw):
        for name in pair:
            if name not in names:
                message = f"there is no such parameter; there are {', '.join(names)}"
                raise CaseError(str(file), f"pairs[{i}]", name, message)
    return tuple((one, other) for one, other in raw)


def _read_held(file, raw: list[str], numbers: EntryNumbers, parameters) -> frozenset[str]:
    section = TableContext(file, "case", [])
    for name in raw:
        numbers.all(section, "held", name)
        for parameter in parameters:
            if parameter.input == name:
                message = (
                    f"parameter {parameter.name} is one of these numbers, and needs a sensitivity"
                )
                raise CaseError(str(file), "held", name, message)
    return frozenset(raw)


def _read_numerics(file, raw: dict, units: tuple[Unit, ...]) -> Numerics:
    """ "auto" is a mesh if that can hold the event or the steps that are chosen once, otherwise
    error control of every batch; on a mesh, units that are measured to be stiff have their own
    steps, and by default all others as many as the nominal batch needs."""
    table = parse(NumericsTable, raw, str(file), "numerics")
    controlled = any(unit.error_controlled and not unit.steps_transfer for unit in timed(units))
    adaptive = table.method == "adaptive" or (table.method == "auto" and controlled)
    numerics = Numerics(
        "adaptive" if adaptive else "mesh",
        table.steps,
        table.tolerance,
        table.max_steps,
        table.refine,
        stiff=STIFF[table.method],
        open=table.method in ("auto", "stiff") and "steps" not in table.model_fields_set,
        loop_tolerance=table.loop_tolerance,
        loop_rounds=table.loop_rounds,
    )
    if "tolerance" in table.model_fields_set:
        numerics = replace(numerics, stiff_tolerance=table.tolerance)
    return numerics
