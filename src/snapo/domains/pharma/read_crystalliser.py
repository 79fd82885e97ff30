"""Reads `[units.NAME]` of a crystalliser: solubility, kinetics, seed and grid of sizes."""

import math

import numpy as np

from snapo.case.given import Given
from snapo.case.table import Section

from . import tables_units as tables
from .read_numbers import NOT_NEGATIVE, POSITIVE, absent, quantity, several, suggest
from .read_table import Reader
from .records_units import Crystalliser, Kinetics, Seed, Solubility
from .units_of_measure import UnitError, conversion

ZERO_CELSIUS = 273.15
SEED_OUTSIDE = 0.01  # most of a seed's volume that may lie outside a grid


def read_crystalliser(read: Reader, species) -> Crystalliser:
    table = read.table
    if table.solute not in species:
        hint = suggest(table.solute, species, "species")
        raise read.section.error("solute", table.solute, f"there is no such species; {hint}")
    seed = _seed(read.inner("seed", tables.SeedTable))
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
        seed=seed,
        separate=table.separate,
        dosing=None if table.dosing is None else read.profile("dosing", "m3/s", NOT_NEGATIVE),
        edges=_edges(read, seed),
    )


def _edges(read: Reader, seed: Seed) -> np.ndarray | None:
    """Edges of the cells over size, in m, for finite volumes; else None."""
    table, method = read.table, read.table.method
    if method == "moments":
        if table.sizes is not None:
            what = 'method "moments" has no such key; it belongs to "finite-volumes"'
            raise read.section.error("sizes", table.sizes, what)
        return None
    if table.sizes is None:
        raise read.section.error("sizes", None, f'method "{method}" needs this key')
    for key, owned in (("separate", "keeps no moments apart"),
                       ("nuclei_size", "has nuclei of the smallest size")):  # fmt: skip
        if key in table.model_fields_set:
            what = f'method "{method}" {owned} and has no such key'
            raise read.section.error(key, getattr(table, key), what)
    if seed.spread is None:
        seeded = Section(read.section.file, f"{read.section.name}.seed", read.section.notes)
        what = f'method "{method}" needs a seed with loading, size and spread'
        raise seeded.error("spread", None, what)
    inner = read.inner("sizes", tables.SizesTable)
    low, high = inner.plain("smallest", "m", NOT_NEGATIVE), inner.plain("largest", "m", POSITIVE)
    if high <= low:
        raise inner.section.error("largest", inner.table.largest, "allowed is above `smallest`")
    if inner.table.spacing == "geometric":
        if low == 0:
            what = 'spacing "geometric" needs a smallest size above 0'
            raise inner.section.error("smallest", inner.table.smallest, what)
        edges = np.geomspace(low, high, inner.table.cells + 1)
    else:
        edges = np.linspace(low, high, inner.table.cells + 1)
    outside = _volume_outside(seed, low, high)
    if outside > SEED_OUTSIDE:
        what = f"{100 * outside:.3g} % of the seed's volume lies outside smallest to largest"
        raise inner.section.error("largest", inner.table.largest, what)
    return edges


def _volume_outside(seed: Seed, low: float, high: float) -> float:
    """Share of a lognormal seed's volume in crystals below `low` or above `high` m."""
    assert seed.size is not None and seed.spread is not None
    variance = math.log1p(float(seed.spread.values[0]) ** 2)
    # By volume the distribution of the logarithm lies three variances higher than by number.
    centre = math.log(float(seed.size.values[0])) + 2.5 * variance
    z = [(math.log(max(each, 1e-12)) - centre) / math.sqrt(2 * variance) for each in (low, high)]
    return (math.erfc(z[1]) + math.erfc(-z[0])) / 2


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
        size, spread = read.number("size", "m", POSITIVE), read.perhaps("spread", "1", POSITIVE)
        return Seed(loading, size, None, spread)
    for key in ("size", "spread"):
        if getattr(table, key) is not None:
            what = "a seed with moments has no such key"
            raise read.section.error(key, getattr(table, key), what)
    if len(table.moments) != 6:
        raise read.section.error("moments", table.moments, "allowed are six moments, 0 to 5")
    values = [
        quantity(read.section, f"moments[{k}]", raw, f"m^{k}/m3" if k else "1/m3", POSITIVE)
        for k, raw in enumerate(table.moments)
    ]
    labels = tuple(f"mu{k}" for k in range(6))
    name = f"{read.name}.moments"
    return Seed(None, None, Given(name, np.array(values), labels, "m^k/m3", np.arange(6)))
