"""A training that goes on from a good policy takes nothing away from it."""

import pytest
from benchmarks.intervals.problems import PROBLEMS

import snapo
from snapo.engine import Xla
from snapo.problem.scenarios import EVALUATE, Pseudo, stream
from snapo.solver.evaluate import path_totals, shares_of
from snapo.solver.statistics import mean

TRUTH = 131072  # paths that chose nothing
QUICK = snapo.Evaluation(paths=16384, selection_paths=16384, sensitivity_paths=0, smooth_paths=0)


@pytest.mark.study
@pytest.mark.parametrize("name", ["put", "store", "lost sales"])
def test_no_reported_policy_is_worse_than_the_one_that_training_went_on_from(name):
    """By more than two paired errors, in ten trainings."""
    known = PROBLEMS[name]
    problem = snapo.Problem(known.simulator, known.inputs, known.objective)

    def solved(policy, seed: int) -> snapo.Solution:
        training = snapo.Training(seed=seed)
        return snapo.solve(problem, policy=policy, training=training, evaluation=QUICK)

    start, engine, below = solved(known.policy, 100).policy, Xla("float64"), []
    for seed in range(10):
        found = solved(start, seed)
        fresh = Pseudo(1000 + seed, stream=stream(EVALUATE, 9))
        kept, before = (
            shares_of(
                problem.objective,
                path_totals(problem, policy, TRUTH, source=fresh, engine=engine),
                fresh,
            )
            for policy in (found.policy, start)
        )
        change = mean(kept - before)
        print(f"{name} {seed}: {found.selected}, {change.value:.3g} ± {change.standard_error:.2g}")
        if change.value < -2 * change.standard_error:
            below.append((seed, found.selected, change))
    assert not below, below
