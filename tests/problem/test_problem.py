"""What a problem takes in place of an objective and of a tuple of constraints."""

from dataclasses import replace

import pytest
from tests.problem.reservoir import Reservoir

import snapo
from snapo.problem.objective import Mean


def problem(**more) -> snapo.Problem:
    return snapo.Problem(Reservoir(), {"water": snapo.Input(1.0)}, **more)


def test_the_name_of_an_output_means_its_mean():
    named = problem(objective="cash")
    assert named.objective == Mean("cash") and named.on(named.sources).objective == Mean("cash")
    assert replace(named, objective="water").objective == Mean("water")
    assert replace(named, constraints=Mean("water") <= 1.0).objective == Mean("cash")


def test_constraints_are_one_or_several():
    limit = Mean("water") <= 1.0
    assert problem(objective="cash").constraints == ()
    for given in (limit, [limit], (limit,)):
        assert problem(objective="cash", constraints=given).constraints == (limit,)


def test_a_problem_needs_an_objective():
    with pytest.raises(TypeError, match="objective"):
        problem()
