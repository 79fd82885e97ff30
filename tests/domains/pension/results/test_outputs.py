"""Sensitivities of several outputs: each against central differences of its own value."""

import csv
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.domains.pension.results.test_frontier import fund

from snapo.domains.pension.chapters import outputs
from snapo.domains.pension.chapters.sensitivities import standard_move
from snapo.domains.pension.policies.classical import ConstantMix
from snapo.domains.pension.results.setup import FUNDING, make_setup
from snapo.solver.evaluate import path_totals
from snapo.solver.sensitivity import sensitivities


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A constant mix, whose decisions are held fixed of themselves."""
    setup = make_setup(fund(), "native")
    small = replace(setup.evaluation, paths=256, sensitivity_paths=256)
    setup = setup._replace(evaluation=small, policy=ConstantMix(fund()))
    engine, folder = setup.engines.evaluate, tmp_path_factory.mktemp("run")
    table = sensitivities(setup.problem, setup.policy, paths=256, engine=engine)
    totals = path_totals(setup.problem, setup.policy, 256, engine=engine)
    solution = SimpleNamespace(
        policy=setup.policy, sensitivities=table, totals=totals, value=-0.2, standard_error=0.01
    )

    def write_csv(name, header, rows):
        with (folder / name).open("w", newline="") as stream:
            csv.writer(stream).writerows([header, *rows])

    return SimpleNamespace(
        setup=setup,
        solution=solution,
        progress=lambda text: None,
        get={"reconciliation": {}, "liability": 95.0}.get,
        write_csv=write_csv,
        folder=folder,
    )


def smoothed(totals):
    """The probability of underfunding with its step rounded by a logistic of the width told."""
    return np.mean(1 / (1 + np.exp((totals["funding_ratio"] - 1) / outputs.WIDTH)))


@pytest.mark.prove
def test_each_output_moves_as_its_own_differences_say(run):
    found = outputs.measure(run)
    values = {each.key: each.value for each in found.outputs}
    totals = run.solution.totals
    assert values["funding"] == pytest.approx(totals["funding_ratio"].mean())
    assert values["underfunded"] == pytest.approx((totals["funding_ratio"] <= 1).mean())
    tail = np.sort(totals["funding_ratio"])[:12].sum() + 0.8 * np.sort(totals["funding_ratio"])[12]
    assert values["tail"] == pytest.approx(tail / 12.8)
    goals = {key: goal.value for key, _, _, goal in outputs.requested(FUNDING)} | {
        "underfunded": smoothed
    }
    problem, engine = run.setup.problem, run.setup.engines.evaluate
    for name in ("asset_mean", "zero_rate"):
        (row,) = [each for each in found.families if each.input == name]
        given = problem.inputs[name]
        size, step = standard_move(given).size.reshape(given.value.shape), 0.01
        for key, value in goals.items():
            either = []
            for sign in (1, -1):
                moved = replace(given, value=given.value + sign * step * size)
                bumped = replace(problem, inputs=problem.inputs | {name: moved})
                totals = path_totals(bumped, run.solution.policy, 256, engine=engine)
                either.append(value(totals))
            slope = (either[0] - either[1]) / (2 * step)
            assert row.effects[key][0] == pytest.approx(slope, rel=1e-5, abs=1e-12)


@pytest.mark.prove
def test_the_table_has_points_basis_points_and_money(run):
    outputs.measure(run)
    with (run.folder / outputs.CSV).open() as stream:
        rows = list(csv.DictReader(stream))
    numbers = sum(each.value.size for each in run.setup.problem.inputs.values())
    assert len(rows) == 5 * numbers
    for row in rows:
        assert float(row["basis_points"]) == pytest.approx(100 * float(row["points"]))
        if row["output"] != "Objective":
            assert float(row["money"]) == pytest.approx(float(row["points"]) * 0.95)
