"""Several seeds in one call: common paths, nothing compiled again, the same as one by one."""

from dataclasses import replace

import numpy as np
import pytest
from jax import monitoring
from tests.problem.reservoir import Reservoir, inputs

import snapo
from snapo.problem.scenarios import Pseudo, Sources, Supplied

SHORT = snapo.Training(steps=8, paths=64, validation_paths=128)
FEW = snapo.Evaluation(512, sensitivity_paths=0, smooth_paths=0, judge_paths=0)
CASH = snapo.Mean("cash")


@pytest.fixture(scope="module")
def found():
    return snapo.solve_seeds(
        Reservoir(), inputs, seeds=3, objective=CASH, training=replace(SHORT, seed=4),
        evaluation=FEW,
    )  # fmt: skip


@pytest.mark.prove
def test_every_seed_is_a_solution_of_its_own_on_common_paths(found):
    assert list(found.solutions) == [4, 5, 6]
    totals = [each.totals["cash"] for each in found.solutions.values()]
    assert not np.array_equal(totals[0], totals[1])
    # The policies are nearly the same still, and so is every path of them.
    assert np.corrcoef(totals[0], totals[1])[0, 1] > 0.95
    sources = [each.problem.sources for each in found.solutions.values()]
    assert len({each.training.seed for each in sources}) == 3
    assert len({each.validation.seed for each in sources}) == 3
    assert {each.evaluation.seed for each in sources} == {4}


@pytest.mark.prove
def test_it_is_the_same_as_solving_one_by_one(found):
    seed = 5
    sources = Sources.of(None, 4).reseeded(seed)
    alone = snapo.solve(Reservoir(), inputs, objective=CASH, scenarios=sources,
                        training=replace(SHORT, seed=seed), evaluation=FEW)  # fmt: skip
    assert alone.value == found.solutions[seed].value


@pytest.mark.prove
def test_the_table_tells_spread_and_distance_to_the_best(found):
    told = str(found)
    assert told.startswith("3 seeds: ") and told.count("seed ") == 3 and "the best" in told
    assert found.values[found.best] == max(found.values.values())
    for seed in found.solutions:
        behind = found.behind(seed)
        assert behind.value == pytest.approx(found.values[found.best] - found.values[seed])
        assert (behind.value > 0) == (seed != found.best)
        assert behind.standard_error < found.solutions[seed].standard_error or seed == found.best


@pytest.mark.prove
def test_a_second_seed_compiles_nothing(found):
    problem, compiled = found.solutions[4].problem, []

    def heard(event: str, *_: object, **__: object) -> None:
        if event.endswith(("backend_compile_duration", "snapo/compile")):
            compiled.append(event)

    monitoring.register_event_duration_secs_listener(heard)
    snapo.solve_seeds(problem, seeds=[7], training=SHORT, evaluation=FEW)
    assert not compiled


def test_seeds_without_sense_are_refused():
    for wrong in ((), (1, 1), 0):
        with pytest.raises(ValueError, match="there must be at least one seed, and no seed twice"):
            snapo.solve_seeds(Reservoir(), inputs, seeds=wrong, objective=CASH)
    problem = snapo.Problem(Reservoir(), inputs, CASH)
    with pytest.raises(ValueError, match="a Problem has its own inputs"):
        snapo.solve_seeds(problem, seeds=2, objective=CASH)
    with pytest.raises(
        ValueError, match=r"the problem comes first.*solve_seeds\(problem, seeds=5\)"
    ):
        snapo.solve_seeds(5, problem, seeds=2)  # pyright: ignore


def test_supplied_paths_stay_those_of_their_role():
    given = Sources.divided(Supplied(np.zeros((52, 200, 2))))
    other = given.reseeded(3)
    assert other.training.seed == 3 and other.evaluation is given.evaluation  # pyright: ignore
    assert other.validation.first == given.validation.first  # pyright: ignore
    plain = Sources.of(Pseudo(7), 1).reseeded(2)
    assert plain.evaluation == Pseudo(7) and plain.training.seed == 2  # pyright: ignore
