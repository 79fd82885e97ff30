"""Concentrations per volume of solution: mass balances by hand at many solids."""

from dataclasses import replace

import numpy as np
import pytest
from tests.domains.pharma.process_cases import (
    attribute,
    cake_filter,
    case,
    chain,
    constant,
    crystalliser,
    feed,
    number,
    series,
)

from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.units.crystals.seed import Seed

SOLUBLE, DENSITY, FED, SEED = 100.0, 1200.0, 375.0, 5.0  # kg/m3
IMPURITY = 25.0  # kg/m3 of the feed


def crystallised(**fields):
    """C from 375 kg/m3 down to a solubility of 100 kg/m3, on seed alone; then a filter."""
    name = "crystalliser"
    plain = crystalliser()
    kinetics = replace(
        plain.kinetics,
        growth_order=number(f"{name}.growth_order", 1.0),
        primary=number(f"{name}.primary", 0.0, "1/m3/s"),
        secondary=number(f"{name}.secondary", 0.0, "1/m3/s"),
        rounding=1e-12,
    )
    unit = crystalliser(
        duration=number(f"{name}.duration", 600.0, "s"),
        temperature=constant(f"{name}.temperature", 300.0),
        solubility=replace(
            plain.solubility, coefficients=series(f"{name}.solubility", [SOLUBLE], "kg/m3")
        ),
        kinetics=kinetics,
        seed=Seed(
            loading=number(f"{name}.seed_loading", SEED), size=number(f"{name}.seed_size", 1e-4)
        ),
        **fields,
    )
    measures = ("crystalliser.concentration", "crystalliser.crystals", "filter.impurity.D")
    measures += ("process.yield.C.C", "filter.time")
    found = [attribute(each, each) for each in measures]
    charge = feed((0.0, 0.1, FED / 150, IMPURITY / 250))
    ports = chain("charge", "crystalliser", "filter")
    return PharmaProcess(case((charge,), (unit, cake_filter()), ports, found))


@pytest.mark.prove
def test_a_crystalliser_and_its_filter():
    """x of new crystals leave the solution 1 - x / rho of its volume, so x = (c0 - c*)/(1 - c*/rho).

    300 kg/m3 of feed and not 275; the liquor holds 25 / 0.75 kg/m3 of an impurity and not 25.
    """
    process = crystallised(basis="solution")
    concentration, crystals, impurity, share, time = process.values()
    made = (FED - SOLUBLE) / (1 - SOLUBLE / DENSITY)
    liquor = 1 - made / DENSITY
    assert (made, liquor) == pytest.approx((300.0, 0.75))
    whole = 1 + SEED / DENSITY  # m3 of suspension per m3 of feed
    assert concentration == pytest.approx(SOLUBLE, rel=1e-8)
    assert share == pytest.approx(made / FED, rel=1e-8)
    assert crystals == pytest.approx((made + SEED) / whole, rel=1e-8)
    kept = 0.2 * 0.4 / (0.6 * DENSITY)
    expected = IMPURITY / liquor * kept * np.exp(-0.9 * 2)
    assert impurity == pytest.approx(expected, rel=1e-8)
    run = process.run()
    assert run.status == "ok"
    assert max(abs(row.relative) for row in balances(process)) < 1e-10
    # What is filtered is the liquor but for what the cake's voids hold.
    mass, volume = 0.06 * (made + SEED), 0.06 * liquor
    filtrate = volume - mass / DENSITY * 0.4 / 0.6
    cake = run.measures["filter.resistance"] * mass / filtrate / 2 * (filtrate / 0.02) ** 2
    assert time == pytest.approx(4.6e-4 / 1e5 * (cake + 1e10 * filtrate / 0.02), rel=1e-8)
    liquids = [run.streams[f"filter.{port}"].volume for port in ("cake", "filtrate")]
    assert sum(liquids) == pytest.approx(volume, rel=1e-8)


def test_a_dilute_model_leaves_the_crystals_out():
    """Per volume of suspension: what is published for a few per cent of crystals is computed so."""
    concentration, crystals, impurity, share, _ = crystallised(basis="suspension").values()
    assert concentration == pytest.approx(SOLUBLE, rel=1e-8)
    assert share == pytest.approx((FED - SOLUBLE) / FED, rel=1e-8)
    assert crystals == pytest.approx(FED - SOLUBLE + SEED, rel=1e-8)
    assert impurity == pytest.approx(
        IMPURITY * 0.2 * 0.4 / (0.6 * DENSITY) * np.exp(-1.8), rel=1e-8
    )
