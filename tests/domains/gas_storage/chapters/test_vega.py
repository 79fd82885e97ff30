"""Vega by delivery month: its sum, bumps of one month, and exact totals of desk cases.

The totals are central differences of the optimal value on a lattice, good to 0.2 %.
"""

import csv
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.domains.energy.energy_cases import swing
from tests.domains.gas_storage.storage_cases import read

from snapo.domains.energy.setup import make_setup as energy_setup
from snapo.domains.gas_storage.chapters.vega import VEGA, by_date
from snapo.domains.gas_storage.setup import bare_problem, fitted_value, make_setup
from snapo.problem.smooth import Exact
from snapo.solver.sensitivity import sensitivities

PATHS = 8192


@cache
def store(name: str):
    case = read(name)
    return make_setup(case, "native", fitted_value(bare_problem(case)))


def totals(setup, count: int, paths: int):
    """The held derivatives with respect to a volatility, and to that of each date."""
    engine, policy, problem = setup.engines.evaluate, setup.policy, setup.problem
    plain = sensitivities(problem, policy, paths=paths, engine=engine).held["volatility"]
    wide = by_date(problem, ["volatility"], count)
    return plain, sensitivities(wide, policy, paths=paths, engine=engine).held["volatility"]


@pytest.mark.prove
def test_a_month_against_a_bump_of_its_prices():
    """With the decisions replayed, in float64: a central difference of one month's volatility."""
    setup = store("quick")
    days = len(setup.case.days)
    plain, dated = totals(setup, days + 1, 512)
    assert_allclose(dated.value.sum(), plain.value.sum(), rtol=1e-9)
    problem, policy, engine = setup.problem, setup.policy, setup.engines.evaluate
    draws = problem.sources.evaluation.draws(np.arange(512), problem.simulator)
    recorded = engine.bind(problem).values(policy, draws, Exact(), record=("action",))
    actions, part = recorded.record["action"], np.arange(days + 1) < 10
    wide = by_date(problem, ["volatility"], days + 1)

    def value(bump: float) -> float:
        inputs = dict(wide.inputs)
        volatility = inputs["volatility"]
        inputs["volatility"] = replace(volatility, value=volatility.value + bump * part)
        moved = engine.bind(replace(wide, inputs=inputs))
        rollout = moved.values(None, draws, Exact(), actions=actions)
        return float(np.mean(rollout.totals["cash_flow"]))

    difference = (value(1e-4) - value(-1e-4)) / 2e-4
    assert_allclose(dated.along(part)[0], difference, rtol=1e-6)


@pytest.mark.prove
@pytest.mark.parametrize(("name", "exact"), [("D1", 269.0), ("D2", 24.469), ("D3", 476.4)])
def test_totals_of_the_desk(name, exact):
    """D1 with spikes, D2 with normal prices, the swing D3: within 1.5 %, and the sum to 1e-9."""
    setup = energy_setup(swing(), "native") if name == "D3" else store(name)
    plain, dated = totals(setup, len(setup.case.days) + 1, PATHS)
    total, error = dated.along(np.ones(dated.value.shape))
    print(name, total, error, exact)
    assert_allclose(total, plain.value.sum(), rtol=1e-9)
    assert_allclose(total, exact, rtol=0.015)
    assert error < 0.01 * exact


def test_several_numbers_for_each_date():
    """Three factors: each has its loading of every date; one number becomes one for each."""
    problem = bare_problem(read("G1"))
    names = [n for n, x in problem.inputs_by_name.items() if x.group == "volatility"]
    wide = by_date(problem, names, problem.simulator.horizon + 1)
    assert len(names) == 3
    for name in names:
        assert wide.inputs_by_name[name].value.shape == (problem.simulator.horizon + 1,)
    one, other = (x.schedule.steps.price for x in (problem, wide))
    assert_allclose(one.loading, other.loading, rtol=1e-15)
    assert_allclose(one.variance, other.variance, rtol=1e-15)


def test_a_run_has_its_vega(solved):
    """The file and the record of a run agree; the sum is the derivative in sensitivities.csv."""
    run = solved("gas-storage") / "run"
    rows = list(csv.DictReader((run / "vega.csv").read_text().splitlines()))
    lines = list(csv.DictReader((run / "sensitivities.csv").read_text().splitlines()))
    for name in dict.fromkeys(row["parameter"] for row in rows):
        own = [row for row in rows if row["parameter"] == name]
        total = sum(float(row["held"]) for row in lines if row["input"] == name)
        months = sum(float(row["vega"]) for row in own if row["month"])
        assert_allclose(months, float(own[-1]["vega"]), rtol=1e-9)
        assert_allclose(months, total, rtol=1e-9)
    assert rows and 'id="vega"' in (run / "report.html").read_text()
    assert VEGA.optional
