"""Reads `[units.NAME]`: each unit of operation with its numbers in the domain's units."""

from collections.abc import Callable
from typing import Any

import numpy as np

from snapo.case.given import Given
from snapo.case.table import Section, Table, parse

from . import tables_units as tables
from .read_crystalliser import read_crystalliser
from .read_network import check_name
from .read_numbers import INSIDE, NOT_NEGATIVE, POSITIVE, SHARE, several, suggest
from .read_table import Reader
from .records_units import (
    Dissolution,
    Dryer,
    Filter,
    Jacket,
    Liquid,
    Reactor,
    Splitter,
    Tank,
    TrayDryer,
    Unit,
)
from .units_of_measure import UnitError, conversion

ZERO_CELSIUS = 273.15


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
    if table.kind not in ("stirred", "plug-flow") and "filled" in table.model_fields_set:
        what = f'kind "{table.kind}" has no such key; it belongs to "stirred" or "plug-flow"'
        raise read.section.error("filled", table.filled, what)
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
        filled=table.filled,
    )


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


FALLING_RATE = ("rate", "activation", "reference_temperature", "reference_size")
TRAY = ("pressure", "area", "heat_transfer", "mass_transfer", "critical", "heat_capacity", "liquid")


def _dryer(read: Reader, species) -> Dryer | TrayDryer:
    read.only(("falling-rate",), FALLING_RATE, needed=True)
    read.only(("tray",), TRAY, needed=True)
    if read.table.kind == "tray":
        return TrayDryer(
            name=read.name,
            duration=read.number("duration", "s", POSITIVE),
            temperature=read.profile("temperature", "K"),
            pressure=read.profile("pressure", "Pa", NOT_NEGATIVE),
            area=read.number("area", "m2", POSITIVE),
            heat_transfer=read.number("heat_transfer", "W/m2/K", POSITIVE),
            mass_transfer=read.number("mass_transfer", "kg/m2/s/Pa", POSITIVE),
            critical=read.number("critical", "1", POSITIVE),
            heat_capacity=read.number("heat_capacity", "J/kg/K", POSITIVE),
            liquid=_liquid(read.inner("liquid", tables.LiquidTable)),
        )
    return Dryer(
        name=read.name,
        duration=read.number("duration", "s", POSITIVE),
        temperature=read.profile("temperature", "K"),
        rate=read.number("rate", "1/s", NOT_NEGATIVE),
        activation=read.number("activation", "J/mol"),
        reference_temperature=read.plain("reference_temperature", "K", POSITIVE),
        reference_size=read.number("reference_size", "m", POSITIVE),
    )


def _liquid(read: Reader) -> Liquid:
    """Antoine's numbers for Pa and K, whatever the case gives them for."""
    table = read.table
    try:
        scale = conversion(table.unit, "Pa").scale
    except UnitError as error:
        raise read.section.error("unit", table.unit, str(error)) from None
    a, b, c = table.antoine
    if b <= 0:
        what = "allowed is B above 0: vapour pressure rises with temperature"
        raise read.section.error("antoine", table.antoine, what)
    values = np.array([a + np.log10(scale), b, c - (ZERO_CELSIUS if table.scale == "degC" else 0)])
    name = f"{read.name}.antoine"
    return Liquid(
        antoine=Given(name, values, ("A", "B", "C"), "1, K, K", np.arange(3)),
        latent_heat=read.number("latent_heat", "J/kg", POSITIVE),
        heat_capacity=read.number("heat_capacity", "J/kg/K", POSITIVE),
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
    "crystalliser": (tables.CrystalliserTable, read_crystalliser),
    "filter": (tables.FilterTable, _filter),
    "dryer": (tables.DryerTable, _dryer),
    "dissolution": (tables.DissolutionTable, _dissolution),
    "tank": (tables.TankTable, _tank),
    "splitter": (tables.SplitterTable, _splitter),
}
