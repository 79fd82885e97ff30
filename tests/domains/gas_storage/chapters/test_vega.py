"""Vega by delivery month: its sum, and exact totals of desk cases; Black's of G4 in test_explain.py.

The totals are central differences of the optimal value on a lattice, good to 0.2 %.
"""

import csv
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.domains.energy.energy_cases import swing
from tests.domains.gas_storage.storage_cases import read

from snapo.domains.energy.setup import make_setup as energy_setup
from snapo.domains.gas_storage.chapters.vega import VEGA, by_date, volatilities
from snapo.domains.gas_storage.setup import bare_problem, fitted_value, make_setup
from snapo.solver.sensitivity import sensitivities

PATHS = 8192


@pytest.mark.study
@pytest.mark.parametrize(("name", "exact"), [("D1", 269.0), ("D2", 24.469), ("D3", 476.4)])
def test_totals_of_the_desk(name, exact):
    """D1 with spikes, D2 with normal prices, the swing D3 with a firm minimum: within 1.5 %."""
    if name == "D3":
        setup = energy_setup(swing(shortfall="firm"), "native")
    else:
        case = read(name)
        setup = make_setup(case, "native", fitted_value(bare_problem(case)))
    wide = by_date(setup.problem, ["volatility"], len(setup.case.days) + 1)
    engine = setup.engines.evaluate
    dated = sensitivities(wide, setup.policy, paths=PATHS, engine=engine).held["volatility"]
    total, error = dated.along(np.ones(dated.value.shape))
    print(name, total, error, exact)
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


@pytest.mark.prove
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


def test_supplied_paths_have_no_volatility():
    """A problem without such an input has no vega, and its run no part of that name."""
    problem = bare_problem(read("quick"))
    assert volatilities(problem) == ["volatility"]
    inputs = {name: x for name, x in problem.inputs_by_name.items() if x.group != "volatility"}
    assert volatilities(replace(problem, inputs=inputs)) == []
