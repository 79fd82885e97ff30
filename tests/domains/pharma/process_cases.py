"""Small processes as records, built by hand: what the tests of the process chain run."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.settings import EvaluationTable, TrainingTable
from snapo.domains.pharma.control.records import Goal
from snapo.domains.pharma.flowsheet.case import Connection, PharmaCase
from snapo.domains.pharma.flowsheet.feed import Feed
from snapo.domains.pharma.flowsheet.network import FlowNetwork
from snapo.domains.pharma.quality.records import Attribute, Distribution, Parameter, Uncertainty
from snapo.domains.pharma.time.dynamics import Numerics
from snapo.domains.pharma.time.profile import Profile
from snapo.domains.pharma.units.crystalliser import Crystalliser
from snapo.domains.pharma.units.crystals.kinetics import Kinetics
from snapo.domains.pharma.units.crystals.seed import Seed
from snapo.domains.pharma.units.crystals.solubility import Solubility
from snapo.domains.pharma.units.dissolution import Dissolution
from snapo.domains.pharma.units.dryer import Dryer
from snapo.domains.pharma.units.filter import Filter
from snapo.domains.pharma.units.reactor import Reactor


def number(name, value, unit="1"):
    return CaseInput(name, np.array([float(value)]), ("",), unit, np.array(0))


def series(name, values, unit="1"):
    values = np.asarray(values, float)
    return CaseInput(
        name, values, tuple(map(str, range(len(values)))), unit, np.arange(len(values))
    )


def constant(name, value, unit="K"):
    return Profile("constant", np.array([0.0, 1.0]), series(name, [value], unit), None)


def linear(name, values, unit="K"):
    return Profile("linear", np.linspace(0, 1, len(values)), series(name, values, unit), None)


def steps(name, values, unit="K"):
    share = np.linspace(0, 1, len(values) + 1)
    return Profile("constant", share, series(name, values, unit), None)


def network(**fields):
    """A + B -> C, C + A -> D, kinetics as published with PharmaPy."""
    found = {
        "species": ("A", "B", "C", "D"),
        "molar_mass": np.array([100.0, 50.0, 150.0, 250.0]),
        "reactions": ("main", "side"),
        "stoichiometry": np.array([[-1.0, -1, 1, 0], [-1, 0, -1, 1]]),
        "order": np.array([[1.0, 1, 0, 0], [1, 0, 1, 0]]),
        "prefactor": series("kinetics.prefactor", [2.654e4, 5.3e2], "m3/kmol/s"),
        "activation": series("kinetics.activation", [4.0e4, 3.0e4], "J/mol"),
        "heat": series("kinetics.heat", [0.0, 0.0], "J/mol"),
        "reference": None,
    }
    return FlowNetwork(**(found | fields))


def feed(concentration=(0.33, 0.33, 0.0, 0.0), volume=0.06, duration=None, name="charge"):
    return Feed(
        name=name,
        volume=number(f"{name}.volume", volume, "m3"),
        temperature=number(f"{name}.temperature", 313.15, "K"),
        concentration=series(f"{name}.concentration", concentration, "kmol/m3"),
        solvent=number(f"{name}.solvent", 887.6, "kg/m3"),
        duration=duration,
    )


def batch_reactor(duration=3600.0, temperature=None, **fields):
    found = {
        "name": "reactor",
        "kind": "batch",
        "duration": number("reactor.duration", duration, "s"),
        "temperature": temperature or constant("reactor.temperature", 313.15),
        "volume": None,
        "dosing": None,
        "jacket": None,
        "cells": 1,
    }
    return Reactor(**(found | fields))


def crystalliser(name="crystalliser", **fields):
    """The seeded cooling crystalliser of the flagship chain."""

    def part(field, value, unit="1"):
        return number(f"{name}.{field}", value, unit)

    found = {
        "name": name,
        "solute": "C",
        "duration": part("duration", 7200, "s"),
        "temperature": linear(f"{name}.temperature", [313.15, 308, 295, 278.15]),
        "initial_concentration": None,
        "solubility": Solubility(
            "polynomial",
            series(f"{name}.solubility", [226.9, -1.88, 3.89e-3], "kg/m3"),
            0.0,
            series(f"{name}.antisolvent", []),
        ),
        "kinetics": Kinetics(
            growth=part("growth", 5e-6, "m/s"),
            growth_order=part("growth_order", 1.32),
            dissolution=part("dissolution", 0.0, "m/s"),
            dissolution_order=part("dissolution_order", 1.0),
            primary=part("primary", 3e8, "1/m3/s"),
            primary_order=part("primary_order", 3),
            secondary=part("secondary", 4.46e10, "1/m3/s"),
            secondary_order=part("secondary_order", 2),
            crystal_order=part("crystal_order", 1e-5),
            rounding=5e-6,
        ),
        "shape": part("shape", 0.5236),
        "density": part("density", 1200, "kg/m3"),
        "nuclei_size": part("nuclei_size", 0.0, "m"),
        "seed": Seed(
            loading=part("seed_loading", 0.02, "kg/m3"), size=part("seed_size", 20e-6, "m")
        ),
        "separate": False,
        "dosing": None,
        "basis": "suspension",  # as the published values have it
    }
    return Crystalliser(**(found | fields))


def cake_filter(name="filter", **fields):
    def part(field, value, unit="1"):
        return number(f"{name}.{field}", value, unit)

    found = {
        "name": name,
        "area": part("area", 0.02, "m2"),
        "pressure": part("pressure", 1e5, "Pa"),
        "viscosity": part("viscosity", 4.6e-4, "Pa s"),
        "medium_resistance": part("medium_resistance", 1e10, "1/m"),
        "porosity": part("porosity", 0.4),
        "saturation": part("saturation", 0.2),
        "resistance": None,
        "wash": "exponential",
        "wash_ratio": part("wash_ratio", 2.0),
        "efficiency": part("efficiency", 0.9),
        "peclet": None,
    }
    return Filter(**(found | fields))


def dryer(name="dryer"):
    return Dryer(
        name,
        number(f"{name}.duration", 10800, "s"),
        constant(f"{name}.temperature", 323.15),
        number(f"{name}.rate", 1e-3, "1/s"),
        number(f"{name}.activation", 4e4, "J/mol"),
        323.15,
        number(f"{name}.reference_size", 40e-6, "m"),
    )


def dissolution(name="dissolution"):
    return Dissolution(
        name,
        number(f"{name}.diffusivity", 7e-10, "m2/s"),
        number(f"{name}.solubility", 0.5, "kg/m3"),
        number(f"{name}.film", 30e-6, "m"),
        number(f"{name}.time", 1800, "s"),
    )


def chain(*names):
    """Connections of a feed and of single outlets, one after the other."""
    ports = {"reactor": ("feed", "product"), "crystalliser": ("feed", "slurry")}
    ports |= {"filter": ("slurry", "cake"), "dryer": ("cake", "product")}
    ports |= {"dissolution": ("product", ""), "charge": ("", ""), "tank": ("feed", "product")}
    return tuple(Connection(a, ports[a][1], b, ports[b][0]) for a, b in pairwise(names))


def attribute(name, measure, unit="1", scale=1.0, low=None, high=None, margin=1.0):
    return Attribute(name, measure, unit, scale, low, high, "own limit", margin)


def parameter(name, given, entry, low, high):
    middle, quarter = (low + high) / 2, (high - low) / 4
    normal = middle - quarter, middle + quarter
    return Parameter(name, given, entry, "K", 1.0, 0.0, low, high, *normal, None, True, "test")


def certain():
    return Uncertainty((), (), (), np.zeros((0, 0)), ())


def case(feeds, units, connections, attributes, parameters=(), **fields):
    found = {
        "file": Path("case.toml"),
        "title": "test",
        "purpose": "",
        "network": network(),
        "feeds": feeds,
        "units": units,
        "connections": connections,
        "parameters": tuple(parameters),
        "attributes": tuple(attributes),
        "uncertainty": certain(),
        "control": None,
        "goal": Goal("probability", "", 1, 0.95, 1.0),
        "design_space": None,
        "estimation": None,
        "pairs": (),
        "held": frozenset({"crystalliser.dissolution", "crystalliser.nuclei_size"}),
        "numerics": Numerics("mesh", 320, 1e-8, 100_000, True),
        "training": TrainingTable(),
        "evaluation": EvaluationTable(),
        "assumptions": (),
        "notes": (),
    }
    return PharmaCase(**(found | fields))


ATTRIBUTES = (
    attribute("yield", "process.yield.C.A", "%", 100.0, low=27.0, margin=0.2),
    attribute("mean size", "crystalliser.d43", "um", 1e6, low=80.0, high=100.0, margin=1.0),
    attribute("impurity", "filter.impurity.D", "% w/w", 100.0, high=0.15, margin=0.01),
    attribute("residual solvent", "dryer.solvent", "ppm", 1e6, high=720.0, margin=20.0),
    attribute("dissolved", "dissolution.dissolved", "%", 100.0, low=80.0, margin=0.5),
    attribute("filtration time", "filter.time", "s", 1.0, high=300.0, margin=5.0),
)

PARAMETERS = (
    parameter("T_R", "reactor.temperature", 0, 303.0, 323.0),
    parameter("T1", "crystalliser.temperature", 1, 304.0, 311.0),
    parameter("T2", "crystalliser.temperature", 2, 288.0, 302.0),
    parameter("T_f", "crystalliser.temperature", 3, 273.0, 283.0),
    parameter("W", "filter.wash_ratio", 0, 1.0, 4.0),
    parameter("T_d", "dryer.temperature", 0, 313.0, 333.0),
)


def flagship(**fields):
    """F1: reactor, seeded cooling crystalliser, filter and wash, dryer, dissolution test."""
    units = (batch_reactor(), crystalliser(), cake_filter(), dryer(), dissolution())
    order = chain("charge", "reactor", "crystalliser", "filter", "dryer", "dissolution")
    return case((feed(),), units, order, ATTRIBUTES, PARAMETERS, **fields)


def reactor_alone(**fields):
    """F2: the batch reactor of F1 alone."""
    found = [attribute(s, f"reactor.concentration.{s}", "mol/L") for s in "ABCD"]
    return case((feed(),), (batch_reactor(),), chain("charge", "reactor"), found, **fields)


def temperature_profile(pieces):
    """F3: x1' = -k1 x1^2, x2' = k1 x1^2 - k2 x2 over one time unit, piecewise constant T."""
    reactions = network(
        species=("x1", "x2", "x3"),
        molar_mass=np.full(3, 100.0),
        reactions=("first", "second"),
        stoichiometry=np.array([[-1.0, 1, 0], [0, -1, 1]]),
        order=np.array([[2.0, 0, 0], [0, 1, 0]]),
        prefactor=series("kinetics.prefactor", [4000.0, 6.2e5], "1/s"),
        activation=series("kinetics.activation", [2500 * 8.314, 5000 * 8.314], "J/mol"),
        heat=series("kinetics.heat", [0.0, 0.0], "J/mol"),
    )
    unit = batch_reactor(1.0, steps("reactor.temperature", np.full(pieces, 335.0)))
    found = (attribute("x2", "reactor.concentration.x2"),)
    charge = feed((1.0, 0.0, 0.0), volume=1.0)
    return case((charge,), (unit,), chain("charge", "reactor"), found, network=reactions)


def potassium_nitrate(**fields):
    """F4: seeded KNO3 crystalliser, separate moments of seed and nuclei; source in um, min, g/L."""
    name = "crystalliser"
    moments = np.array(
        [4.710811560e-13, 4.710811560e-11, 4.720213146e-9, 4.739221606e-7, 4.767261215e-5, 0.0]
    )
    unit = crystalliser(
        duration=number(f"{name}.duration", 4800, "s"),
        temperature=linear(f"{name}.temperature", [305.15, 301.15]),
        initial_concentration=number(
            f"{name}.initial_concentration", 128.6 + 5.88 * 32 + 0.1721 * 32**2, "kg/m3"
        ),
        solubility=Solubility(
            "polynomial",
            series(f"{name}.solubility", [128.6, 5.88, 0.1721], "kg/m3"),
            273.15,
            series(f"{name}.antisolvent", []),
        ),
        kinetics=replace(
            crystalliser().kinetics,
            growth=number(f"{name}.growth", 6967e-6 / 60, "m/s"),
            primary=number(f"{name}.primary", 0.0, "1/m3/s"),
            secondary=number(f"{name}.secondary", 2.78e-5 * 1e18 / 60, "1/m3/s"),
            secondary_order=number(f"{name}.secondary_order", 1.78),
            crystal_order=number(f"{name}.crystal_order", 1.0),
            rounding=1e-8,
        ),
        shape=number(f"{name}.shape", 1.0),
        density=number(f"{name}.density", 2110, "kg/m3"),
        seed=Seed(moments=series(f"{name}.seed", moments * 1e18 * 1e-6 ** np.arange(6))),
        separate=True,
    )
    measures = ("concentration", "seed_volume", "nuclei_volume")
    found = [attribute(each, f"{name}.{each}") for each in measures]
    return case((feed(),), (unit,), chain("charge", "crystalliser"), found, **fields)


def spread(prefactor=0.1, growth=0.1, nucleation=0.1):
    """Lognormal uncertainty of both rate constants, growth and both nucleation constants."""
    names = ["kinetics.prefactor"] * 2
    names += [f"crystalliser.{each}" for each in ("growth", "primary", "secondary")]
    sizes = (prefactor, prefactor, growth, nucleation, nucleation)
    return Uncertainty(
        tuple(names),
        (0, 1, 0, 0, 0),
        tuple(Distribution("lognormal", each) for each in sizes),
        np.eye(5),
        ("batch",) * 5,
    )
