"""One order of policies under limits, for starts of a training and for seeds."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from tests.solver.limits.test_limits import FEW, INPUTS, Spend
from tests.solver.twelve import Regulator, policy, problem

import snapo
from snapo.solver.evaluate import path_totals
from snapo.solver.learning import starts
from snapo.solver.learning.progress import Interrupted
from snapo.solver.limits import Contender, Dual, LimitFound, best_first
from snapo.solver.seeds import Seeds
from snapo.solver.solution import Solution
from snapo.solver.train import initial_progress


@pytest.mark.parametrize(
    ("values", "within", "order"),
    [
        ([1.0, 3.0, 2.0], [True, True, True], [1, 2, 0]),
        ([np.nan, 3.0, -np.inf], [True, True, True], [1, 0, 2]),
        ([1.0, 3.0, 2.0], [True, False, True], [2, 0, 1]),
        ([1.0, 3.0, 2.0], [False, False, False], [1, 2, 0]),
        ([np.nan, np.nan, np.nan], [True, True, True], [0, 1, 2]),
    ],
)
def test_policies_within_limits_come_first(values, within, order):
    assert best_first([Contender(*item) for item in zip(values, within)]) == order


def test_outside_limits_the_priced_value_decides():
    """An upper limit with the price 0.5 and a lower one with -2; the third policy has no price in
    training, and pays those of the others: 3 - 1, 4 - 2 - 2, 2.5 - 0."""
    contenders = [
        Contender(3.0, False, (2.0, 0.0), (0.5, -1.0)),
        Contender(4.0, False, (4.0, -1.0), (0.1, -2.0)),
        Contender(2.5, False, (0.0, 0.0), (0.0, 0.0)),
    ]
    assert best_first(contenders) == [2, 0, 1]


def test_a_race_keeps_a_start_within_limits():
    one = initial_progress(policy(problem(Regulator)), snapo.Training())
    begun = [replace(one, best_value=float(value)) for value in (3, 5, 4, 1)]

    def run(progress, until):
        return replace(progress, step=until)

    def contender(progress):
        return Contender(progress.best_value, progress.best_value < 4.5)

    left, rounds = starts.race(begun, 200, run, contender)
    assert left.best_value == 4.0
    assert [number for number, _ in rounds[0].values] == [2, 0, 3, 1]

    def interrupted(progress, until):
        if progress.best_value == 1.0:
            raise Interrupted(progress)
        return run(progress, until)

    with pytest.raises(Interrupted) as stop:
        starts.race(begun, 200, interrupted, contender)
    assert stop.value.result.best_value == 4.0


class Spending(snapo.Policy):
    """Spends x on each day."""

    x: float

    def __call__(self, observation, smooth):
        return jnp.stack([jnp.asarray(self.x, observation.dtype)])


def valued(x: float, multiplier: float) -> Solution:
    """Four days of 2 x - x^2 / 2, with a limit of 6 on the 4 x that are spent."""
    of = snapo.Problem(
        Spend(), INPUTS, snapo.Mean("earned"), constraints=(snapo.AtMost("spent", 6.0),)
    )
    found = snapo.solve(of, policy=Spending(x), training=snapo.Training(steps=0), evaluation=FEW)
    limits = tuple(item._replace(multiplier=multiplier) for item in found.constraints)
    return replace(found, constraints=limits)


@pytest.mark.prove
def test_the_best_of_seeds_is_within_the_limits():
    """Earned: 8 - 2 (2 - x)^2. 2 a day earns 8 and spends 8; 1.5 a day earns 7.5 and spends 6. With
    the price 0.5 of the closed form, 3 a day is worth 6 - 3 and 2 a day 8 - 1."""
    all_three = Seeds({1: valued(2.0, 0.5), 2: valued(1.5, 0.5), 3: valued(3.0, 0.1)})
    assert all_three.best == 2
    assert "above the best, limits not met" in str(all_three)
    others = Seeds({3: all_three.solutions[3], 1: all_three.solutions[1]})
    assert others.best == 1


@pytest.mark.prove
def test_starts_are_compared_by_the_limits_on_validation_paths():
    limits = snapo.AtMost("spent", 6.0), snapo.AtLeast("earned", 7.0)
    of = snapo.Problem(Spend(), INPUTS, snapo.Mean("earned"), constraints=limits)
    source, dual = of.sources.validation, Dual(prices=(0.5, 0.25))
    totals = path_totals(of, Spending(2.0), 4096, source=source)
    found = Contender.on(of, totals, source, dual)
    assert not found.within and found.prices == (0.5, -0.25)
    assert found.value == pytest.approx(8.0, abs=0.1)
    assert found.excess == pytest.approx((2.0, 1.0), abs=0.1)
    assert Contender.on(
        of, path_totals(of, Spending(1.5), 4096, source=source), source, dual
    ).within
    training = snapo.Training(steps=20, starts=2, paths=64, validation_paths=256)
    few = snapo.Evaluation(256, 0, 0, 0)
    solution = snapo.solve(of, policy=snapo.MLP(hidden=(4,)), training=training, evaluation=few)
    assert any("Of 2 starts" in note for note in solution.notes)


def test_limits_of_a_measured_policy_make_a_contender():
    limit = LimitFound("spent", 6.0, 6.5, 0.1, 6.3, 6.7, 0.5, 0.01, 0.5, "not met")
    lower = limit._replace(level=7.0, multiplier=-0.2, met="met nearly")
    expected = Contender(1.0, False, (0.5, -0.5), (0.5, -0.2))
    assert Contender.of(1.0, (limit, lower)) == expected
    assert Contender.of(1.0, (lower,)).within
