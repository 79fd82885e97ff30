"""A second process of the same form is the same program: nothing is traced or compiled for it."""

import tomllib
from dataclasses import fields, is_dataclass
from typing import Any

import jax
import numpy as np
import pytest
from tests.compilations import compilations
from tests.domains.pharma.pharma_cases import CASE, LOOP, TEMPLATE, small
from tests.domains.same_form import PAIRS, same_programs

from snapo.case.given import CaseInput
from snapo.domains.pharma.control.closed_loop import ClosedLoop, closed_loop, objective
from snapo.domains.pharma.flowsheet.case import PharmaCase
from snapo.domains.pharma.read.case import resolve
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact

NUMBERS = (("units", "reactor", "duration"), ("feeds", "charge", "volume"),
           ("reactions", 0, "prefactor"), ("reactions", 1, "activation"))  # fmt: skip


def reactor(by: float = 1.0, **rules) -> PharmaCase:
    """A reactor in closed loop, whose numbers are `by` times as large; `rules`: see `drawn`."""
    data = tomllib.loads(small(CASE + LOOP))
    for *path, key in NUMBERS:
        table: Any = data
        for part in path:
            table = table[part]
        number, unit = table[key].split(" ", 1)
        table[key] = f"{by * float(number)!r} {unit}"
    control = data["control"]
    control |= {"substeps": 4, "steps": {"reactor": rules.get("steps", 2)}}
    control["manipulated"][0] |= rules.get("decision", {})
    control["measurements"][0] |= rules.get("sensor", {})
    data["uncertainty"][0]["distribution"] = rules.get(
        "spread", {"kind": "normal", "spread": "50 L/mol/s"}
    )
    data["held"] = rules.get("held", [])
    data["attributes"][0] |= rules.get("limits", {})
    return resolve(TEMPLATE, data)


def template(by: float) -> PharmaCase:
    """The template, in closed loop over two of its units and a number that is decided once."""
    data = tomllib.loads(TEMPLATE.read_text(encoding="utf-8"))
    data["feeds"]["charge"]["volume"] = f"{60 * by} L"
    data["control"] = {
        "steps": {"reactor": 2, "crystalliser": 2},
        "substeps": 4,
        "manipulated": [
            {"of": "reactor.temperature", "low": "303 K", "high": "323 K"},
            {"of": "crystalliser.temperature", "low": "273 K", "high": "314 K"},
            {"of": "filter.wash_ratio", "low": 1, "high": 4},
        ],
        "measurements": [
            {"state": "crystalliser.d43", "error": "1 um", "centre": "60 um", "width": "40 um"}
        ],
    }
    return resolve(TEMPLATE, data)


def problem(case: PharmaCase) -> Problem:
    loop = closed_loop(case)
    return Problem(loop.simulator, loop.inputs, objective(case))


def drawn(seed: int) -> Problem:
    """A reactor whose numbers are drawn, and its rules of a few."""
    draw = np.random.default_rng(seed)
    kind = str(draw.choice(["normal", "lognormal", "uniform"]))
    return problem(
        reactor(
            float(draw.uniform(0.95, 1.05)),
            steps=int(draw.integers(2, 4)),
            decision={"ramp": "1 K/min"} if draw.integers(2) else {},
            sensor={"delay": "1 min"} if draw.integers(2) else {},
            spread={"kind": kind, "spread": 0.1 if kind == "lognormal" else "50 L/mol/s"},
            held=["charge.temperature"] if draw.integers(2) else [],
            limits={"low": "0.1 mol/L"} if draw.integers(2) else {},
        )
    )


def test_equal_forms_are_equal_programs():
    assert same_programs(map(drawn, range(30)), enough=2) >= 2


@PAIRS
def test_equal_forms_are_equal_programs_in_many_pairs(enough):
    assert same_programs(map(drawn, range(600)), enough) >= enough


@pytest.mark.prove
def test_two_processes_of_many_units_are_one_program():
    assert same_programs(map(problem, map(template, (1.0, 1.05))), enough=1) == 1


def records(item):
    """All that is in a record of records."""
    yield item
    if isinstance(item, tuple | list):
        parts = item
    elif is_dataclass(item) and not isinstance(item, type):
        parts = [getattr(item, entry.name) for entry in fields(item)]
    else:
        parts = []
    for part in parts:
        yield from records(part)


def test_a_simulator_holds_no_case():
    simulator = problem(template(1.0)).simulator
    assert jax.tree.leaves(simulator) == []
    found = list(records(simulator))
    assert len(found) > 100
    assert not any(isinstance(item, PharmaCase | CaseInput) for item in found)


@pytest.mark.parametrize(
    "change",
    [
        {"steps": 3}, {"decision": {"ramp": "1 K/min"}}, {"sensor": {"delay": "1 min"}},
        {"sensor": {"width": "0.06 mol/L"}}, {"limits": {"low": "0.1 mol/L"}},
        {"held": ["charge.temperature"]}, {"spread": {"kind": "lognormal", "spread": 0.1}},
    ],
)  # fmt: skip
def test_what_is_compiled_in_is_part_of_the_form(change):
    made = [closed_loop(reactor(1.0, **rules)).simulator for rules in ({}, change)]
    assert made[0] != made[1] == closed_loop(reactor(1.05, **change)).simulator


@pytest.mark.prove
def test_a_second_process_compiles_nothing_and_has_its_own_bits():
    loop = ClosedLoop(reactor(), "xla")
    first, other = loop.setup(), reactor(1.05)

    def totals(setup):
        draws = Pseudo(0).draws(np.arange(16), setup.problem.simulator)
        return (
            setup.engines.evaluate.bind(setup.problem).values(setup.policy, draws, Exact()).totals
        )

    before = totals(first)
    with compilations() as compiled:
        moved = loop.setup_at(first, other)
        second = totals(moved)
    assert compiled == []
    assert moved.case is other
    jax.clear_caches()
    again = totals(ClosedLoop(other, "xla").setup())
    for name, values in again.items():
        assert np.array_equal(second[name], values)
    assert not np.array_equal(before["attribute.product"], second["attribute.product"])
