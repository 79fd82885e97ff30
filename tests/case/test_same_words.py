"""A key of a case file and the argument in Python that it stands for have one name."""

from dataclasses import fields

import pytest

import snapo
from snapo.case.settings import OBJECTIVE_KEYS, EvaluationTable, FollowingTable
from snapo.problem.objective import Objective

KINDS = {
    "mean": (snapo.Mean,),
    "cvar": (snapo.CVaR,),
    "mean-variance": (snapo.MeanVariance,),
    "entropic": (snapo.Entropic,),
    "crra": (snapo.ExpectedUtility, snapo.CRRA),
    "target": (snapo.Target,),
}


def names(*kinds: type) -> set[str]:
    return {field.name for kind in kinds for field in fields(kind)}  # pyright: ignore[reportArgumentType]


def test_training_and_evaluation():
    assert FollowingTable.model_fields.keys() == names(snapo.Training)
    assert EvaluationTable.model_fields.keys() <= names(snapo.Evaluation)


@pytest.mark.parametrize("kind", OBJECTIVE_KEYS)
def test_an_objective(kind):
    assert set(OBJECTIVE_KEYS[kind]) <= names(*KINDS[kind])
    assert issubclass(KINDS[kind][0], Objective)
