"""Programs follow what a user's code reads, in every way of reading, and are kept where it reads
the same."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.problem.code import reading

import snapo
from snapo.engine import Native, Xla
from snapo.solver.evaluate import path_totals
from snapo.solver.provenance import Clock

ACTIONS = np.zeros((reading.HORIZON, 2, 1))
SMALL = {
    "training": snapo.Training(steps=1, paths=8),
    "evaluation": snapo.Evaluation(paths=8, sensitivity_paths=0, smooth_paths=0, judge_paths=0),
}


@pytest.fixture
def expected(tmp_path, monkeypatch):
    """What every output of a step is; all are 1 at first."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.syspath_prepend(str(tmp_path))
    reading.written(tmp_path, 1.0)
    sys.modules.pop("read_by_step", None)
    reading.OTHER = importlib.import_module("read_by_step")
    for way in reading.WAYS:
        reading.change(way, 1.0, tmp_path)
    names = [*reading.WAYS, *reading.ALSO["global"]]
    return dict.fromkeys(names, 1.0)


def changed(expected: dict[str, float], folder: Path) -> None:
    """Changes all that is read, each to a number of its own."""
    for number, way in enumerate(reading.WAYS, 2):
        reading.change(way, float(number), folder)
        expected |= dict.fromkeys((way, *reading.ALSO.get(way, ())), float(number))


def problem_of(simulator: snapo.Simulator) -> snapo.Problem:
    return snapo.Problem(simulator, reading.INPUTS, snapo.Mean("global"))


def means(problem: snapo.Problem, engine) -> dict[str, float]:
    draws = problem.sources.evaluation.draws(np.arange(2), problem.simulator)
    bound = engine.bind(problem)
    totals = bound.values(None, draws, snapo.Exact(), actions=ACTIONS).totals
    return {name: float(np.mean(total)) / reading.HORIZON for name, total in totals.items()}


def test_every_way_of_reading_is_followed(expected, tmp_path):
    """One after the other, for an object that was used before and for a new one."""
    same, engine = problem_of(reading.Reading()), Native("float64")
    assert means(same, engine) == expected
    for number, way in enumerate(reading.WAYS, 2):
        reading.change(way, float(number), tmp_path)
        expected |= dict.fromkeys((way, *reading.ALSO.get(way, ())), float(number))
        assert means(same, engine) == expected, way
        assert means(problem_of(reading.Reading()), engine) == expected, way


def test_all_ways_together_are_followed_by_xla(expected, tmp_path):
    same, engine = problem_of(reading.Reading()), Xla("float64")
    assert means(same, engine) == expected
    changed(expected, tmp_path)
    assert means(same, engine) == expected
    assert means(problem_of(reading.Reading()), engine) == expected


def test_what_was_read_before_is_known_again(expected, tmp_path):
    """Back at the first numbers nothing is compiled, nor where nothing changed."""
    problem, engine = problem_of(reading.Reading()), Xla("float64")
    means(problem, engine)
    reading.change("global", 2.0, tmp_path)
    means(problem, engine)
    reading.change("global", 1.0, tmp_path)
    with Clock() as clock:
        assert means(problem, engine) == expected
        assert means(problem_of(reading.Reading()), engine) == expected
        clock.stage("evaluate")
    assert clock.seconds["compile"] == 0.0


@pytest.mark.prove
@pytest.mark.parametrize("engine", ["native", "xla"])
def test_every_way_of_reading_is_followed_by_solve_and_evaluate(engine, expected, tmp_path):
    simulator = reading.Reading()

    def solved(simulator):
        return snapo.solve(
            simulator, reading.INPUTS, objective=snapo.Mean("global"), engine=engine, **SMALL
        )

    def shown(totals):
        return {name: float(np.mean(total)) / reading.HORIZON for name, total in totals.items()}

    first = solved(simulator)
    assert shown(first.totals) == expected
    changed(expected, tmp_path)
    assert shown(solved(simulator).totals) == expected
    assert shown(solved(reading.Reading()).totals) == expected
    assert first.problem is not None and first.policy is not None
    assert shown(path_totals(first.problem, first.policy, 8)) == expected
    found = snapo.evaluate(first.problem, first.policy, paths=8)
    assert found.value == pytest.approx(reading.HORIZON * expected["global"], rel=1e-12)
