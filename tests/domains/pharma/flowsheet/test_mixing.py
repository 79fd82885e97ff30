"""Several feeds into one reactor, by a tank; and what a balance counts as made."""

import tomllib

import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import (
    CASE,
    TEMPLATE,
    attribute,
    connections,
    feed,
    parameter,
)

from snapo.case.error import CaseError
from snapo.domains.pharma.chapters.verification import balances
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.read.case import resolve

TWO_FEEDS = (
    """kind = "pharma"
[species]
A = { molar_mass = "100 g/mol" }
B = { molar_mass = "50 g/mol" }
C = { molar_mass = "150 g/mol" }
[[reactions]]
name = "r"
equation = "A + B -> C"
prefactor = "2e-3 L/mol/s"
activation = "0 J/mol"
[units.mix]
type = "tank"
inlets = ["a", "b"]
[units.reactor]
type = "reactor"
kind = "stirred"
volume = "9 L"
duration = "10 h"
temperature = "313.15 K"
[numerics]
refine = false
"""
    + feed("one", "60 L", 'A = "1 mol/L"', 'duration = "10 h"')
    + feed("two", "30 L", 'B = "2 mol/L"', 'duration = "10 h"')
    + connections(("one", "mix.a"), ("two", "mix.b"), ("mix.product", "reactor.feed"))
    + parameter("V", "reactor.volume", ["5 L", "30 L"], ["8 L", "10 L"])
    + attribute("product", "reactor.concentration.C", "mol/L", 'low = "0.01 mol/L"')
)


def two_feeds(**durations):
    data = tomllib.loads(TWO_FEEDS)
    for name, value in durations.items():
        data["feeds"][name]["duration"] = value
        if value is None:
            del data["feeds"][name]["duration"]
    return resolve(TEMPLATE, data)


@pytest.mark.prove
def test_two_feeds_and_a_tank_feed_a_stirred_reactor():
    """2/3 mol/L of A and of B, one hour of residence: c = (sqrt(1 + 4 k tau c0) - 1) / (2 k tau)."""
    process = PharmaProcess(two_feeds())
    run = process.run()
    assert run.status == "ok" and float(run.streams["mix.product"].duration) == 36_000
    k, first = 2e-3 * 3600, 2 / 3
    left = (np.sqrt(1 + 4 * k * first) - 1) / (2 * k)
    assert run.measures["reactor.concentration.A"] == pytest.approx(left, rel=1e-3)
    assert max(abs(row.relative) for row in balances(process)) < 1e-10


def test_a_batch_does_not_feed_what_runs_continuously():
    with pytest.raises(CaseError, match="a batch reaches its inlet feed: every feed that"):
        two_feeds(two=None)


def test_flows_of_unlike_durations_are_noted():
    assert two_feeds().notes == ()
    assert two_feeds(two="5 h").notes == (
        "mix takes in flows that last 18000 to 36000 s; all are spread evenly over 36000 s.",
    )


@pytest.mark.prove
def test_what_reactions_make_does_not_enter():
    """Nothing but A and B enters the batch reactor; molar masses of few digits are made visible."""
    data = {k: v for k, v in tomllib.loads(CASE).items() if k not in ("estimation", "design_space")}
    data["species"]["C"]["molar_mass"] = "150.007 g/mol"
    data["species"]["D"]["molar_mass"] = "250.007 g/mol"
    case = resolve(TEMPLATE, data)
    assert "conserves mass only to 4.7e-05" in case.notes[0]
    process = PharmaProcess(case)
    rows = {row.quantity: row for row in balances(process) if row.unit == "reactor"}
    assert rows["C"].inflow == 0 and rows["C"].made == pytest.approx(rows["C"].outflow)
    assert rows["A"].made < 0 < rows["A"].inflow
    made = 0.007 * (rows["C"].made + rows["D"].made)
    assert rows["mass"].made == pytest.approx(made, rel=1e-6)
    assert max(abs(row.relative) for row in rows.values()) < 1e-10


def test_molar_masses_that_are_wrong_are_refused():
    data = tomllib.loads(CASE)
    data["species"]["C"]["molar_mass"] = "150.1 g/mol"
    with pytest.raises(CaseError, match="mass is not conserved"):
        resolve(TEMPLATE, {k: v for k, v in data.items() if k != "estimation"})
