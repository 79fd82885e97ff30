"""Imitation of a rule, and training on from a policy or a solution."""

from dataclasses import replace

import numpy as np
import pytest
from tests.problem.families.test_family import PROBLEM

import snapo
from snapo.solver.evaluate import evaluate

RULE = snapo.Linear(np.array([[-0.6, 0.05]], np.float32), np.zeros(1, np.float32))
FEW = snapo.Evaluation(1024, 0, 0, 0)


@pytest.mark.prove
def test_a_network_imitates_a_rule_and_is_trained_on():
    begun = snapo.imitate(PROBLEM, RULE, snapo.MLP(hidden=(16,)))
    # Decisions of the rule have a standard deviation of about 0.4.
    assert begun.distance < 0.02
    value, ruled = (evaluate(PROBLEM, p, paths=4096).value for p in (begun.policy, RULE))
    assert value == pytest.approx(ruled, rel=2e-3)
    none = snapo.Training(steps=0, validation_paths=64)
    same = snapo.solve(PROBLEM, policy=begun.policy, training=none, evaluation=FEW)
    assert same.value == pytest.approx(evaluate(PROBLEM, begun.policy, paths=1024).value, rel=1e-6)
    short = snapo.Training(steps=40, paths=128, learning_rate=3e-3, validation_paths=1024)
    better = snapo.solve(PROBLEM, policy=same, training=short, evaluation=FEW)
    assert better.value > same.value + 0.005


@pytest.mark.prove
def test_a_rule_is_imitated_for_a_problem_with_limits():
    """A limit is of an output that imitation does not have: it was a KeyError."""
    limited = replace(PROBLEM, constraints=(snapo.AtMost("cost", 5.0),))
    few = snapo.Training(steps=2, paths=16, validation_paths=16)
    begun = snapo.imitate(limited, RULE, snapo.Linear(), training=few, engine="xla")
    assert np.isfinite(begun.distance)


def test_a_rule_with_memory_is_refused():
    with pytest.raises(ValueError, match="memory"):
        snapo.imitate(PROBLEM, snapo.GRU())
