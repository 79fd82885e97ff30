"""Reads a pharma case: a TOML file and the CSVs beside it become a `PharmaCase`."""

from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.settings import read_evaluation, read_training
from snapo.case.table import Section, load, parse

from .draws import process_entries
from .flowsheet import ancestors, in_order, read_connections
from .inputs import every_given
from .profile import profiles_of
from .read_control import read_control, read_design_space, read_goal
from .read_estimation import read_estimation
from .read_network import read_feeds, read_network
from .read_optimise import read_optimise
from .read_quality import (
    Numbers,
    every_measure,
    read_attributes,
    read_parameters,
    read_uncertainty,
)
from .read_units import read_units
from .records import Numerics, PharmaCase
from .records_units import Crystalliser, Dryer, Feed, Profile, Reactor, Timed, TrayDryer, Unit
from .stages import staged
from .tables import NumericsTable, PharmaTable

# Where a case does not say: limits as soft as their margins at first, so that all of them are felt.
TRAINING = {
    "steps": 150, "paths": 256, "learning_rate": 0.02, "warmup": 10, "temperature_start": 1.0,
    "temperature_end": 0.1, "validation_paths": 2048, "validation_every": 25,
}  # fmt: skip
EVALUATION = {"paths": 16384, "sensitivity_paths": 1024}


def read_case(path: str | Path) -> PharmaCase:
    """Reads and checks the case at `path`, a TOML file or a folder with `case.toml`.

    **Raises:** `CaseError` where a table, a quantity or the flowsheet is wrong; nothing is written.
    """
    file, data = load(Path(path))
    return resolve(file, data)


def resolve(file: Path, data: dict[str, Any]) -> PharmaCase:
    """The same for TOML data that was read already; other files are looked for beside `file`."""
    top = parse(PharmaTable, data, str(file), "")
    notes: list[str] = []
    network = read_network(file, top.species, top.reactions, top.reference_temperature, notes)
    feeds = read_feeds(file, top.feeds, network.species, notes)
    units = read_units(file, top.units, network.species, notes)
    connections = read_connections(file, top.connections, feeds, units)
    units = in_order(file, units, connections)
    numbers = Numbers(
        {given.name: given for given in every_given((network, feeds, units))}, network
    )
    _check_amounts(file, feeds, units, connections, notes)
    parameters = read_parameters(file, top.parameters, numbers, notes)
    attributes = read_attributes(file, top.attributes, network, feeds, units, notes)
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
        uncertainty=read_uncertainty(file, top.uncertainty, top.correlations, numbers, notes),
        control=read_control(file, top.control, numbers, network.species, units, notes),
        goal=read_goal(file, top.goal, attributes),
        design_space=read_design_space(file, top.design_space, parameters, attributes),
        estimation=read_estimation(file, top.estimation, numbers, network.species, units, notes),
        pairs=_read_pairs(file, top.pairs, [each.name for each in parameters]),
        held=_read_held(file, top.held, numbers, parameters),
        numerics=_read_numerics(file, top.numerics, units),
        training=read_training({**TRAINING, **top.training}, str(file)),
        evaluation=read_evaluation({**EVALUATION, **top.evaluation}, str(file)),
        assumptions=tuple(top.assumptions),
        notes=tuple(notes),
        optimise=read_optimise(file, top.optimise, numbers, every_measure(network, units), notes),
    )
    _check_moved(case)
    _check_decided(case)
    _check_varied_once(case)
    return case


def _read_pairs(file, raw: list[list[str]], names: list[str]) -> tuple[tuple[str, str], ...]:
    for i, pair in enumerate(raw):
        for name in pair:
            if name not in names:
                what = f"there is no such parameter; there are {', '.join(names)}"
                raise CaseError(str(file), f"pairs[{i}]", name, what)
    return tuple((one, other) for one, other in raw)


def _read_held(file, raw: list[str], numbers: Numbers, parameters) -> frozenset[str]:
    section = Section(file, "case", [])
    for name in raw:
        numbers.all(section, "held", name)
        for each in parameters:
            if each.input == name:
                what = f"parameter {each.name} is one of these numbers, and needs a sensitivity"
                raise CaseError(str(file), "held", name, what)
    return frozenset(raw)


def _check_decided(case: PharmaCase) -> None:
    """A policy decides profiles of units that take time, and numbers of units after these."""
    control = case.control
    if control is None:
        return
    by_name, before = (
        {unit.name: unit for unit in case.units},
        ancestors(case.units, case.connections),
    )
    needed = set().union(*(before[unit.name] for unit in staged(case)))
    for i, each in enumerate(control.manipulated):
        name = each.input.partition(".")[0]
        unit = by_name.get(name)
        if unit is None:
            what = "a policy decides on units, and this number is none of a unit"
        elif isinstance(unit, Timed):
            profiles = [profile.value.name for profile in profiles_of(unit)]
            if each.input in profiles:
                continue
            what = f"of {name} a policy decides what may change over time: {', '.join(profiles)}"
        elif name in needed:
            what = f"{name} runs before a unit over whose time a policy decides or measures"
        else:
            continue
        raise CaseError(str(case.file), f"control.manipulated[{i}].of", each.input, what)


def _check_moved(case: PharmaCase) -> None:
    """What is decided or uncertain cannot be held."""
    tables = {
        "optimise.decisions": case.optimise.decisions if case.optimise else (),
        "control.manipulated": case.control.manipulated if case.control else (),
    }
    moved = [(f"{key}[{i}]", x.input) for key, xs in tables.items() for i, x in enumerate(xs)]
    moved += [("uncertainty", name) for name in case.uncertainty.inputs]
    for where, name in moved:
        if name in case.held:
            what = "this number is among those `held`, which do not move"
            raise CaseError(str(case.file), f"{where}.of", name, what)


def _read_numerics(file, raw: dict, units: tuple[Unit, ...]) -> Numerics:
    """ "auto" is a mesh where it may hold the event, and else error control."""
    table = parse(NumericsTable, raw, str(file), "numerics")
    method = table.method
    if method == "auto":
        method = "adaptive" if any(_moves_before_event(unit) for unit in units) else "mesh"
    return Numerics(method, table.steps, table.tolerance, table.max_steps, table.refine)


def _moves_before_event(unit: Unit) -> bool:
    """Whether the concentration changes while nothing grows, the unit is stiff, or its cells set
    how long a step may be."""
    if isinstance(unit, Crystalliser):
        dissolves = bool(unit.kinetics.dissolution.values.any())
        return dissolves or unit.dosing is not None or unit.edges is not None
    return isinstance(unit, TrayDryer) or (isinstance(unit, Reactor) and unit.jacket is not None)


def _check_varied_once(case: PharmaCase) -> None:
    """A number varies as a process parameter or as an uncertain one, not both."""
    uncertain = set(zip(case.uncertainty.inputs, case.uncertainty.entries))
    for name, entry in process_entries(case):
        if (name, entry) in uncertain:
            what = "this number has a distribution under [[parameters]] as well"
            raise CaseError(str(case.file), "uncertainty", f"{name}[{entry}]", what)


def _check_amounts(file, feeds, units, connections, notes: list[str]) -> None:
    """Continuous units need a feed with a duration; what is dosed is what the feed holds."""
    by_name = {feed.name: feed for feed in feeds}
    for unit in units:
        fed = {c.inlet: by_name.get(c.source) for c in connections if c.target == unit.name}
        for inlet in ("dose", "antisolvent"):
            feed = fed.get(inlet)
            dosing = getattr(unit, "dosing", None)
            if feed is not None and dosing is not None:
                _check_dose(file, unit, feed, dosing)
        main = fed.get("feed")
        continuous = isinstance(unit, Reactor) and unit.kind in ("stirred", "plug-flow")
        if continuous and main is not None and main.duration is None:
            what = f"unit {unit.name} runs continuously and needs to know over which time"
            raise CaseError(str(file), f"feeds.{main.name}.duration", None, what)
        if isinstance(unit, Timed | Dryer):
            notes += _steep(unit.name, unit.temperature, float(unit.duration.values[0]))


def _check_dose(file, unit, feed: Feed, dosing: Profile) -> None:
    duration = float(unit.duration.values[0])
    value, share = dosing.value.values, dosing.share
    mean = (value[1:] + value[:-1]) / 2 if dosing.kind == "linear" else value
    dosed = duration * float(np.sum(mean * np.diff(share)))
    held = float(feed.volume.values[0])
    if abs(dosed - held) > 1e-9 * held:
        what = (
            f"over {duration:g} s it doses {dosed:.10g} m3, and feed {feed.name} holds "
            f"{held:.10g} m3"
        )
        raise CaseError(str(file), f"units.{unit.name}.dosing", None, what)


def _steep(name: str, profile: Profile, duration: float) -> list[str]:
    """A remark where an open-loop profile moves faster than its ramp allows."""
    if profile.ramp is None or profile.kind == "constant":
        return []
    slope = np.abs(np.diff(profile.value.values) / np.diff(profile.share)) / duration
    if slope.max() <= profile.ramp * (1 + 1e-9):
        return []
    return [
        f"{name}.temperature moves by {60 * slope.max():.3g} K/min at most, and its ramp allows "
        f"{60 * profile.ramp:.3g} K/min."
    ]
