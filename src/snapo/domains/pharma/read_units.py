"""Reads `[units.NAME]`: each unit of operation with its numbers in the domain's units."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...case import Given, Section, Table, parse
from . import tables_units as tables
from .read_network import check_name
from .read_numbers import (
    ANY,
    INSIDE,
    NOT_NEGATIVE,
    POSITIVE,
    SHARE,
    Bounds,
    absent,
    profile,
    quantity,
    several,
    single,
    suggest,
)
from .records_units import (
    Crystalliser,
    Dissolution,
    Dryer,
    Filter,
    Jacket,
    Kinetics,
    Profile,
    Reactor,
    Seed,
    Solubility,
    Splitter,
    Tank,
    Unit,
)
from .units_of_measure import UnitError, conversion

ZERO_CELSIUS = 273.15


class Reader(NamedTuple):
    """One table while it is read; its numbers are called "name.key"."""

    section: Section
    name: str
    table: Any

    def number(self, key: str, unit: str, bounds: Bounds = ANY) -> Given:
        raw = getattr(self.table, key)
        return single(self.section, f"{self.name}.{key}", key, raw, unit, bounds)

    def perhaps(self, key: str, unit: str, bounds: Bounds = ANY) -> Given | None:
        return None if getattr(self.table, key) is None else self.number(key, unit, bounds)

    def plain(self, key: str, unit: str, bounds: Bounds = ANY) -> float:
        return quantity(self.section, key, getattr(self.table, key), unit, bounds)

    def profile(self, key: str, unit: str, bounds: Bounds = POSITIVE) -> Profile:
        raw = getattr(self.table, key)
        return profile(self.section, f"{self.name}.{key}", key, raw, unit, bounds)

    def inner(self, key: str, table: type[Table]) -> "Reader":
        """The table under `key`."""
        where = f"{self.section.name}.{key}"
        found = parse(table, getattr(self.table, key), str(self.section.file), where)
        section = Section(self.section.file, where, self.section.notes)
        return Reader(section, f"{self.name}.{key}", found)

    def only(self, kinds: tuple[str, ...], keys: tuple[str, ...], needed: bool = False) -> None:
        """Refuses `keys` where `kind` is not one of `kinds`; where it is they may be `needed`."""
        kind = self.table.kind
        for key in keys:
            given = getattr(self.table, key)
            if kind not in kinds and given is not None:
                words = " or ".join(f'"{each}"' for each in kinds)
                what = f'kind "{kind}" has no such key; it belongs to {words}'
                raise self.section.error(key, given, what)
            if kind in kinds and needed and given is None:
                raise self.section.error(key, None, f'kind "{kind}" needs this key')


def read_units(file, units: dict, species: tuple[str, ...], notes: list[str]) -> tuple[Unit, ...]:
    """All units, in the order of the file."""
    return tuple(_unit(file, name, raw, species, notes) for name, raw in units.items())


def _unit(file, name: str, raw: Any, species, notes) -> Unit:
    check_name(Section(file, "units", notes), name, name)
    section = Section(file, f"units.{name}", notes)
    kind = raw.get("type") if isinstance(raw, dict) else None
    if kind not in READERS:
        words = ", ".join(f'"{each}"' for each in READERS)
        if kind is None:
            raise section.error("type", None, f"this key is missing; it is one of {words}")
        hint = suggest(str(kind), READERS, "type")
        raise section.error("type", kind, f"allowed is one of {words}; {hint}")
    table, read = READERS[kind]
    return read(Reader(section, name, parse(table, raw, str(file), section.name)), species)


def _reactor(read: Reader, species) -> Reactor:
    read.only(("stirred", "plug-flow"), ("volume",), needed=True)
    read.only(("semi-batch",), ("dosing",), needed=True)
    table = read.table
    if table.kind != "plug-flow" and "cells" in table.model_fields_set:
        what = f'kind "{table.kind}" has no such key; it belongs to "plug-flow"'
        raise read.section.error("cells", table.cells, what)
    jacket = None
    if table.jacket is not None:
        inner = read.inner("jacket", tables.JacketTable)
        jacket = Jacket(
            heat_capacity=inner.number("heat_capacity", "J/m3/K", POSITIVE),
            conductance=inner.number("conductance", "W/K", NOT_NEGATIVE),
            temperature=inner.profile("temperature", "K"),
        )
    return Reactor(
        name=read.name,
        kind=table.kind,
        duration=read.number("duration", "s", POSITIVE),
        temperature=read.profile("temperature", "K"),
        volume=read.perhaps("volume", "m3", POSITIVE),
        dosing=None if table.dosing is None else read.profile("dosing", "m3/s", NOT_NEGATIVE),
        jacket=jacket,
        cells=table.cells,
    )


def _crystalliser(read: Reader, species) -> Crystalliser:
    table = read.table
    if table.solute not in species:
        hint = suggest(table.solute, species, "species")
        raise read.section.error("solute", table.solute, f"there is no such species; {hint}")
    return Crystalliser(
        name=read.name,
        solute=table.solute,
        duration=read.number("duration", "s", POSITIVE),
        temperature=read.profile("temperature", "K"),
        initial_concentration=read.perhaps("initial_concentration", "kg/m3", POSITIVE),
        solubility=_solubility(read.inner("solubility", tables.SolubilityTable)),
        kinetics=_kinetics(read.inner("kinetics", tables.KineticsTable)),
        shape=read.number("shape", "1", POSITIVE),
        density=read.number("density", "kg/m3", POSITIVE),
        nuclei_size=read.number("nuclei_size", "m", NOT_NEGATIVE),
        seed=_seed(read.inner("seed", tables.SeedTable)),
        separate=table.separate,
        dosing=None if table.dosing is None else read.profile("dosing", "m3/s", NOT_NEGATIVE),
    )


def _solubility(read: Reader) -> Solubility:
    table = read.table
    try:
        scale = conversion(table.unit, "kg/m3").scale
    except UnitError as error:
        raise read.section.error("unit", table.unit, str(error)) from None
    values = np.array(table.coefficients)
    if table.kind == "polynomial":
        values = values * scale
    else:  # the unit is a factor of the whole, which the logarithm adds
        values[0] += np.log(scale)
    unit = "kg/m3/K^k" if table.kind == "polynomial" else "1/K^k"
    labels = tuple(f"t^{k}" for k in range(len(values)))
    extra = absent(f"{read.name}.antisolvent", "1")
    if table.antisolvent is not None:
        extra = several(
            read.section, extra.name, "antisolvent", table.antisolvent, "1", ("w", "w^2")
        )
    return Solubility(
        kind=table.kind,
        coefficients=Given(read.name, values, labels, unit, np.arange(len(values))),
        zero=0.0 if table.scale == "K" else ZERO_CELSIUS,
        antisolvent=extra,
    )


def _kinetics(read: Reader) -> Kinetics:
    rates = {"growth": "m/s", "dissolution": "m/s", "primary": "1/m3/s", "secondary": "1/m3/s"}
    orders = ("growth_order", "dissolution_order", "primary_order", "secondary_order",
              "crystal_order")  # fmt: skip
    found = {key: read.number(key, unit, NOT_NEGATIVE) for key, unit in rates.items()}
    found |= {key: read.number(key, "1", NOT_NEGATIVE) for key in orders}
    return Kinetics(**found, rounding=read.plain("rounding", "1", POSITIVE))


def _seed(read: Reader) -> Seed:
    table = read.table
    if (table.moments is None) == (table.loading is None):
        what = "a seed has a loading and a size, or else its six moments"
        raise read.section.error("moments", table.moments, what)
    if table.moments is None:
        if table.size is None:
            raise read.section.error("size", None, "a loading needs this key")
        loading = read.number("loading", "kg/m3", POSITIVE)
        return Seed(loading, read.number("size", "m", POSITIVE), None)
    if table.size is not None:
        raise read.section.error("size", table.size, "a seed with moments has no such key")
    if len(table.moments) != 6:
        raise read.section.error("moments", table.moments, "allowed are six moments, 0 to 5")
    values = [
        quantity(read.section, f"moments[{k}]", raw, f"m^{k}/m3" if k else "1/m3", POSITIVE)
        for k, raw in enumerate(table.moments)
    ]
    labels = tuple(f"mu{k}" for k in range(6))
    name = f"{read.name}.moments"
    return Seed(None, None, Given(name, np.array(values), labels, "m^k/m3", np.arange(6)))


def _filter(read: Reader, species) -> Filter:
    table = read.table
    for wash, key in (("exponential", "efficiency"), ("dispersion", "peclet")):
        given = getattr(table, key)
        if table.wash == wash and given is None:
            raise read.section.error(key, None, f'wash "{wash}" needs this key')
        if table.wash != wash and given is not None:
            what = f'wash "{table.wash}" has no such key; it belongs to "{wash}"'
            raise read.section.error(key, given, what)
    return Filter(
        name=read.name,
        area=read.number("area", "m2", POSITIVE),
        pressure=read.number("pressure", "Pa", POSITIVE),
        viscosity=read.number("viscosity", "Pa*s", POSITIVE),
        medium_resistance=read.number("medium_resistance", "1/m", NOT_NEGATIVE),
        porosity=read.number("porosity", "1", INSIDE),
        saturation=read.number("saturation", "1", SHARE),
        resistance=read.perhaps("resistance", "m/kg", POSITIVE),
        wash=table.wash,
        wash_ratio=read.number("wash_ratio", "1", NOT_NEGATIVE),
        efficiency=read.perhaps("efficiency", "1", NOT_NEGATIVE),
        peclet=read.perhaps("peclet", "1", POSITIVE),
    )


def _dryer(read: Reader, species) -> Dryer:
    return Dryer(
        name=read.name,
        duration=read.number("duration", "s", POSITIVE),
        temperature=read.profile("temperature", "K"),
        rate=read.number("rate", "1/s", NOT_NEGATIVE),
        activation=read.number("activation", "J/mol"),
        reference_temperature=read.plain("reference_temperature", "K", POSITIVE),
        reference_size=read.number("reference_size", "m", POSITIVE),
    )


def _dissolution(read: Reader, species) -> Dissolution:
    return Dissolution(
        name=read.name,
        diffusivity=read.number("diffusivity", "m2/s", POSITIVE),
        solubility=read.number("solubility", "kg/m3", POSITIVE),
        film=read.number("film", "m", POSITIVE),
        time=read.number("time", "s", POSITIVE),
    )


def _ports(read: Reader, key: str) -> tuple[str, ...]:
    names = getattr(read.table, key)
    for i, name in enumerate(names):
        check_name(read.section, key, name)
        if name in names[:i]:
            raise read.section.error(key, name, "this name stands there twice")
    return tuple(names)


def _tank(read: Reader, species) -> Tank:
    return Tank(name=read.name, inlets=_ports(read, "inlets"))


def _splitter(read: Reader, species) -> Splitter:
    outlets = _ports(read, "outlets")
    raw = read.table.share if isinstance(read.table.share, list) else [read.table.share]
    name = f"{read.name}.share"
    if len(raw) != len(outlets) - 1:
        what = f"allowed are {len(outlets) - 1} shares, of all outlets but the last"
        raise read.section.error("share", read.table.share, what)
    share = several(read.section, name, "share", raw, "1", outlets[:-1], SHARE)
    if share.values.sum() > 1:
        raise read.section.error("share", read.table.share, "the shares add up to more than 1")
    return Splitter(name=read.name, outlets=outlets, share=share)


READERS: dict[str, tuple[type[Table], Callable[[Reader, Any], Unit]]] = {
    "reactor": (tables.ReactorTable, _reactor),
    "crystalliser": (tables.CrystalliserTable, _crystalliser),
    "filter": (tables.FilterTable, _filter),
    "dryer": (tables.DryerTable, _dryer),
    "dissolution": (tables.DissolutionTable, _dissolution),
    "tank": (tables.TankTable, _tank),
    "splitter": (tables.SplitterTable, _splitter),
}
